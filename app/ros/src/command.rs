//! The command `ros`.

use std::net::IpAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use anyhow::{Result, bail};
use clap::{Args, Subcommand, value_parser};
use mvt_gaits::gait::AUTO;
use mvt_run::io::print_line;
use mvt_run::supervisor::Goal;

use crate::listing::{TopicRate, list_topics};
use crate::setup::domain_of_environment;

/// Arguments of a run on the topics of a robot.
#[derive(Debug, Args)]
pub struct LiveArguments {
    /// Read the topics of ROS 2 that this file names (docs/live.md), and publish the results. SIGINT ends the run
    #[arg(long, value_name = "FILE", conflicts_with_all = ["log", "rig", "side", "explore", "cameras"])]
    pub ros: Option<PathBuf>,
    /// Record what arrives over --ros as this log, without loss: `run --log LOG` repeats the estimate. A hand gives a FeelSight log, a camera
    /// alone an RGB-D sequence. (`generate` writes logs of simulated episodes)
    #[arg(long, value_name = "LOG", requires = "ros")]
    pub record: Option<PathBuf>,
    /// With --ros, send joint targets of --controller to the hand, within the limits of the file; without it nothing is sent
    #[arg(long, requires = "ros")]
    pub drive: bool,
}

impl LiveArguments {
    /// Checks that goal and controller, which move a hand, are given only where one is driven.
    ///
    /// # Errors
    /// If they are given without `--drive`.
    pub fn check(&self, goal: Goal, controller: &str) -> Result<()> {
        if self.ros.is_some() && !self.drive && (goal != Goal::Time || controller != AUTO) {
            bail!("--goal and --controller move a hand: give --drive, too");
        }
        Ok(())
    }
}

/// Look at the network of ROS 2, without a ROS installation
#[derive(Debug, Subcommand)]
pub enum RosCommand {
    /// List topics with types, publishers and rates
    Topics(RosTopicsArguments),
}

/// List topics with types, publishers and rates
///
/// A topic is listed if it has a publisher. `reliable` says that lost messages are sent again.
#[derive(Debug, Args)]
pub struct RosTopicsArguments {
    /// Domain [default: that of the variable ROS_DOMAIN_ID, or 0]
    #[arg(long, value_name = "N", value_parser = value_parser!(u16).range(0..=232))]
    domain: Option<u16>,
    /// Addresses of the network cards of this computer that are used, separated by commas [default: all]
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    addresses: Vec<IpAddr>,
    /// Time to listen, seconds
    #[arg(long, value_name = "SECONDS", default_value_t = 3.0, value_parser = mvt_run::arguments::duration)]
    duration: f64,
}

/// Runs the command. `stop` returns a flag that ends it early.
///
/// # Errors
/// If the network or the output cannot be used.
pub fn run(command: &RosCommand, stop: fn() -> Result<Arc<AtomicBool>>) -> Result<()> {
    let RosCommand::Topics(arguments) = command;
    let domain = arguments.domain.unwrap_or_else(domain_of_environment);
    let duration = Duration::from_secs_f64(arguments.duration);
    let topics = list_topics(domain, &arguments.addresses, duration, &*stop()?)?;
    if topics.is_empty() {
        tracing::warn!(
            "no topic is seen in domain {domain}: compare ROS_DOMAIN_ID, addresses and firewall with those of the publishers"
        );
    }
    topics.iter().try_for_each(|topic| print_line(&in_words(topic)))
}

fn in_words(TopicRate { topic, hz, bytes }: &TopicRate) -> String {
    let rate = hz.map_or_else(|| "silent".to_owned(), |hz| format!("{hz:.1} Hz, {bytes} bytes"));
    let publishers = if topic.publishers == 1 { String::new() } else { format!(", {} publishers", topic.publishers) };
    let reliability = if topic.is_reliable { "reliable" } else { "best effort" };
    format!("{}  {}  {rate}  {reliability}{publishers}", topic.name, topic.types.join(" or "))
}
