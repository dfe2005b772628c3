//! docs/commands.md is what `--help` prints, and commands on the other pages are understood.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

/// Columns of the help texts.
const WIDTH: usize = 100;

/// Appends the help of a command and of all below it.
fn describe(command: &mut clap::Command, page: &mut String) {
    let help = command.render_long_help().to_string();
    let lines: Vec<&str> = help.lines().map(str::trim_end).collect();
    let _ = write!(
        page,
        "\n## {}\n\n```text\n{}\n```\n",
        command.get_bin_name().unwrap_or(command.get_name()),
        lines.join("\n")
    );
    for below in command.get_subcommands_mut().filter(|below| !below.is_hide_set() && below.get_name() != "help") {
        describe(below, page);
    }
}

#[test]
fn the_page_of_commands_is_the_help() {
    let mut command = mambavitact::command().term_width(WIDTH).disable_help_subcommand(true);
    command.build();
    let mut page =
        "# Commands\n\n<!-- Made from the help texts by `UPDATE_PAGES=1 cargo test --features cuda,foxglove,onnx,ros --test library commands_page`. -->\n".to_owned();
    describe(&mut command, &mut page);
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/commands.md");
    if std::env::var_os("UPDATE_PAGES").is_some() {
        fs::write(&path, &page).unwrap();
    }
    let found = fs::read_to_string(&path).unwrap_or_default();
    let differs = found.lines().zip(page.lines()).find(|(found, due)| found != due);
    assert!(found == page, "docs/commands.md is old: make it anew with UPDATE_PAGES=1; first difference: {differs:?}");
}

/// The words of a shell command up to a comment, a pipe or another command.
fn words(line: &str) -> Vec<String> {
    let mut words = vec![String::new()];
    let mut quote = None;
    for c in line.chars() {
        match (quote, c) {
            (None, '#' | '|' | '&' | ';' | '>') if words.last().is_some_and(String::is_empty) => break,
            (None, '\'' | '"') => quote = Some(c),
            (Some(open), _) if c == open => quote = None,
            (None, ' ') => words.push(String::new()),
            _ => words.iter_mut().last().into_iter().for_each(|word| word.push(c)),
        }
    }
    words.retain(|word| !word.is_empty());
    words
}

#[test]
fn commands_on_pages_are_understood() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let pages = fs::read_dir(root.join("docs")).unwrap().map(|entry| entry.unwrap().path());
    let pages = pages.chain([root.join("README.md")]).filter(|page| page.extension().is_some_and(|end| end == "md"));
    let mut offenders = Vec::new();
    let mut count = 0;
    for page in pages.filter(|page| !page.ends_with("commands.md")) {
        let text = fs::read_to_string(&page).unwrap().replace("\\\n", " ");
        for line in text.lines().filter(|line| line.starts_with("mambavitact ")) {
            count += 1;
            let Err(error) = mambavitact::command().try_get_matches_from(words(line)) else { continue };
            offenders.push(format!(
                "{}: {line}\n    {}",
                page.display(),
                error.to_string().lines().next().unwrap_or("")
            ));
        }
    }
    assert!(count > 40, "only {count} commands were found");
    assert!(offenders.is_empty(), "these commands are not understood:\n{}", offenders.join("\n"));
}
