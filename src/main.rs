//! MambaViTact: an Allegro hand turns objects in MuJoCo; from what its DIGIT fingertips and cameras record, live or from FeelSight
//! logs, shape and pose of the object are estimated, and the estimate directs the hand.

mod assets;
mod bench;
mod contacts;
mod eval_touch;
mod generate;
mod inspect;
mod mesh;
mod network;
mod render_touch;
mod run;
mod score;
mod simulate;
#[cfg(feature = "train")]
mod train;
mod view;

use std::io::IsTerminal as _;
use std::process::ExitCode;

use clap::{Parser, Subcommand};
use tracing_subscriber::EnvFilter;

/// Visuotactile SLAM in the hand: an Allegro hand with DIGIT fingertips turns YCB objects, touch and RGB-D images are rendered, shape
/// and pose are estimated from them, and the estimate directs the hand.
///
/// Without a command: `run`, a closed-loop episode of 30 s with the Rubik's cube, whose results go to out/.
#[derive(Debug, Parser)]
#[command(version, max_term_width = 110, after_help = "MAMBAVITACT_LOG=debug shows more of what happens.")]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
}

#[derive(Debug, Subcommand)]
enum Command {
    Run(Box<run::Arguments>),
    Evaluate(mvt_evaluation::Arguments),
    Generate(generate::Arguments),
    Simulate(simulate::Arguments),
    RenderTouch(render_touch::Arguments),
    Contacts(contacts::Arguments),
    #[command(subcommand)]
    Assets(assets::Command),
    Inspect(inspect::Arguments),
    Score(score::Arguments),
    Mesh(mesh::Arguments),
    #[command(subcommand)]
    Network(network::Command),
    #[command(subcommand)]
    Bench(bench::Command),
    EvalTouch(eval_touch::Arguments),
    View(view::Arguments),
    #[cfg(feature = "train")]
    Train(train::Arguments),
}

/// What people are told of. The window's ways to draw are tried one after the other; only if all fail is that worth a word, and ours.
const QUIET: &str = "warn,eframe=off,egui_wgpu=off,wgpu_core=off,wgpu_hal=off,winit=off";

fn main() -> ExitCode {
    // Warnings are for people and go to standard error; results go to standard output.
    let filter = EnvFilter::try_from_env("MAMBAVITACT_LOG").unwrap_or_else(|_| EnvFilter::new(QUIET));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        .with_target(false)
        .without_time()
        // They would go to standard error as well, and panic where nobody reads it.
        .log_internal_errors(false)
        .init();
    let result = match Cli::parse().command {
        None => run::main_job(),
        Some(Command::Run(arguments)) => run::run(&arguments),
        Some(Command::Evaluate(arguments)) => mvt_evaluation::run(&arguments),
        Some(Command::Generate(arguments)) => generate::run(&arguments),
        Some(Command::Simulate(arguments)) => simulate::run(&arguments),
        Some(Command::RenderTouch(arguments)) => render_touch::run(&arguments),
        Some(Command::Contacts(arguments)) => contacts::run(&arguments),
        Some(Command::Assets(command)) => assets::run(&command),
        Some(Command::Inspect(arguments)) => inspect::run(&arguments),
        Some(Command::Score(arguments)) => score::run(&arguments),
        Some(Command::Mesh(arguments)) => mesh::run(&arguments),
        Some(Command::Network(command)) => network::run(&command),
        Some(Command::Bench(command)) => bench::run(&command),
        Some(Command::EvalTouch(arguments)) => eval_touch::run(&arguments),
        Some(Command::View(arguments)) => view::run(&arguments),
        #[cfg(feature = "train")]
        Some(Command::Train(arguments)) => train::run(&arguments),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        // The reader of our output, `head` say, has seen enough.
        Err(error)
            if error.downcast_ref::<std::io::Error>().is_some_and(|e| e.kind() == std::io::ErrorKind::BrokenPipe) =>
        {
            ExitCode::SUCCESS
        }
        Err(error) => {
            // The whole chain on one line: what failed, and why.
            tracing::error!("{error:#}{}", assets::remedy(&error));
            ExitCode::FAILURE
        }
    }
}
