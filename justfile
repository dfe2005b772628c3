# `just` shows this menu.
_menu:
    @just --list --unsorted

# Format, then lint the workspace without its tests: for every save
check:
    cargo fmt --all
    cargo clippy --workspace --locked -- -D warnings

# Tests of one crate, such as `just test slam`; further arguments go to cargo test
test crate *arguments:
    cargo test --package {{ if crate == "mambavitact" { crate } else { "mvt-" + trim_start_match(crate, "mvt-") } }} --locked {{ arguments }}

# The rules of the house: imports, names, circles, sizes, panics
structure:
    cargo test --package mambavitact --test structure --locked

# Everything that CI checks; about half an hour on two cores from nothing
full:
    .ci/run

# Measure a group of RESULTS.md again and rewrite its rows; without a group, list them
results *groups:
    cargo results {{ if groups == "" { "list" } else { "measure " + groups } }}

# The documentation of all crates, in the browser
doc:
    cargo doc --workspace --no-deps --locked --open
