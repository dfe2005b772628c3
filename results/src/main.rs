//! `cargo results`: measures the figures of RESULTS.md and writes the page.
//!
//! `results/claims.toml` lists the claims in groups, with the commands that measure them and the place of each figure in the files that
//! the commands write. `results/values.jsonl` holds the measured values. RESULTS.md is rendered from both.

mod check;
mod claims;
mod extract;
mod list;
mod measure;
mod place;
mod records;
mod render;
mod tables;
mod values;

use std::io::Write as _;
use std::process::ExitCode;

use anyhow::Result;
use clap::{Parser, Subcommand};

use claims::Claims;
use place::Repository;
use values::Values;

/// Measure the figures of RESULTS.md and write the page
#[derive(Debug, Parser)]
#[command(name = "cargo results", version, max_term_width = 110)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// List the groups, or the commands and rows of one group
    List {
        /// Name of a group
        group: Option<String>,
    },
    /// Run the commands of groups, store their values and rewrite RESULTS.md
    Measure {
        /// Names of groups, which `cargo results list` shows; `all` for those without values of the present commit
        #[arg(required = true)]
        groups: Vec<String>,
        /// Keep the files of an interrupted measurement; commands that can resume then do so
        #[arg(long)]
        keep: bool,
        /// Do not run the commands; read the values from the files of the last measurement
        #[arg(long, conflicts_with = "keep")]
        reread: bool,
    },
    /// Rewrite RESULTS.md from the claims and the stored values
    Render,
    /// Fail if RESULTS.md is stale or too long, or if claims and values disagree
    Check {
        /// Also run the commands of this group and fail if a row yields no value; nothing is stored
        #[arg(long, value_name = "GROUP")]
        measure: Option<String>,
    },
}

fn main() -> ExitCode {
    match run(&Cli::parse().command) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // A failure to write to standard error cannot be reported anywhere.
            let _ = writeln!(std::io::stderr(), "error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

/// Runs a command in the repository of the current folder.
fn run(command: &Command) -> Result<()> {
    let repository = Repository::find()?;
    let claims = Claims::load(&repository.claims())?;
    let mut values = Values::load(&repository.values())?;
    match command {
        Command::List { group: None } => print(&list::groups(&claims, &values)),
        Command::List { group: Some(name) } => print(&list::group(claims.group(name)?, &values)),
        Command::Measure { groups, keep, reread } => {
            let start = match (keep, reread) {
                (_, true) => measure::Start::Reread,
                (true, false) => measure::Start::Keep,
                (false, false) => measure::Start::Clean,
            };
            measure::measure(&repository, &claims, &mut values, groups, start)
        }
        Command::Render => render::write(&repository, &claims, &values),
        Command::Check { measure } => {
            check::check(&repository, &claims, &values)?;
            match measure {
                Some(name) => measure::rehearse(&repository, claims.group(name)?),
                None => print("RESULTS.md agrees with the claims and the values"),
            }
        }
    }
}

/// Prints a text and a line break.
fn print(text: &str) -> Result<()> {
    Ok(writeln!(std::io::stdout(), "{text}")?)
}
