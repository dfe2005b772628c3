//! `completions` and `man`: what shells and `man` know of the program.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use clap::{Args, Command};
use clap_complete::Shell;
use clap_mangen::Man;
use mvt_run::io::{print_line, write_file};

/// Print the completions of a shell
///
/// For bash: mambavitact completions bash > ~/.local/share/bash-completion/completions/mambavitact
#[derive(Debug, Args)]
pub struct CompletionsArguments {
    /// The shell
    #[arg(value_enum)]
    shell: Shell,
}

/// Write the manual pages of all commands
///
/// To read one: man DIR/mambavitact-run.1
#[derive(Debug, Args)]
pub struct ManArguments {
    /// Folder for the pages, such as ~/.local/share/man/man1; earlier pages in it are replaced
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// Prints completions.
pub fn completions(arguments: &CompletionsArguments, mut command: Command) -> Result<()> {
    let mut text = Vec::new();
    clap_complete::generate(arguments.shell, &mut command, env!("CARGO_PKG_NAME"), &mut text);
    print_line(String::from_utf8(text)?.trim_end())
}

/// Writes a page for each command that `--help` shows.
pub fn man(arguments: &ManArguments, command: Command) -> Result<()> {
    let out = &arguments.out;
    fs::create_dir_all(out).with_context(|| format!("cannot make {}", out.display()))?;
    let mut command = command.disable_help_subcommand(true);
    command.build();
    write_pages(&command, out)?;
    print_line(&format!("next: man {}", out.join(concat!(env!("CARGO_PKG_NAME"), ".1")).display()))
}

/// Writes the page of a command and those of its commands.
fn write_pages(command: &Command, out: &Path) -> Result<()> {
    let page = Man::new(command.clone());
    let mut text = Vec::new();
    page.render(&mut text)?;
    write_file(out, &page.get_filename(), &text)?;
    let mut shown = command.get_subcommands().filter(|command| !command.is_hide_set());
    shown.try_for_each(|command| write_pages(command, out))
}
