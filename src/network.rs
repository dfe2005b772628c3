//! `network`: what touch networks are made of.

use std::fmt;
use std::path::Path;
use std::str::FromStr;

use anyhow::Result;
use clap::{Args, Subcommand};
use mvt_touch::network::{Architecture, Cost, NetworkLayer};
use serde::{Deserialize, Serialize};

use mvt_run::io::print_line;
use mvt_run::settings;

/// Look at the networks that turn touch images into depth
#[derive(Debug, Subcommand)]
pub enum Command {
    Describe(DescribeArguments),
}

/// Count a network's parameters, multiplications and activations
///
/// MACs are multiplications with addition in matrix products, convolutions, attention and scans. Activations are the results of all layers
/// for one image in 32-bit floats.
#[derive(Debug, Args)]
pub struct DescribeArguments {
    /// vit, mamba, robust_mamba or default, or a training configuration (.toml) with hyper-parameters of its own
    name: String,
    /// Size of the image, pixels: WIDTHxHEIGHT, or the side of a square
    #[arg(long, default_value = "240x320")]
    input: ImageSize,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Width and height of an image, pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ImageSize {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

impl FromStr for ImageSize {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let side = |text: &str| text.parse::<u32>().ok().filter(|side| (1..=2048).contains(side));
        let (width, height) = text.split_once('x').unwrap_or((text, text));
        side(width)
            .zip(side(height))
            .map(|(width, height)| Self { width, height })
            .ok_or_else(|| "give WIDTHxHEIGHT or one side, 1 to 2048 pixels, as 240x320 or 224".to_owned())
    }
}

impl fmt::Display for ImageSize {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}x{}", self.width, self.height)
    }
}

impl ImageSize {
    /// Rows and columns.
    pub fn rows_and_columns(self) -> [usize; 2] {
        [self.height as usize, self.width as usize]
    }
}

/// What is printed.
#[derive(Debug, Serialize)]
struct Description {
    architecture: Architecture,
    input: String,
    parameters: u64,
    macs: u64,
    activation_bytes: u64,
    parts: Vec<Part>,
}

/// Layers whose names begin alike.
#[derive(Debug, Serialize)]
struct Part {
    name: String,
    parameters: u64,
    macs: u64,
    activation_bytes: u64,
}

/// The preset of a name, or what the table `network` of a training configuration says.
pub fn architecture(name: &str) -> Result<Architecture> {
    /// What is read of a training configuration; the rest is for the training.
    #[derive(Deserialize)]
    struct Configured {
        network: Architecture,
    }
    if !name.ends_with(".toml") {
        return Ok(Architecture::preset(name)?);
    }
    let Configured { network } = settings::read(Path::new(name))?;
    network.check()?;
    Ok(network)
}

/// Runs the command.
pub fn run(command: &Command) -> Result<()> {
    let Command::Describe(DescribeArguments { name, input, json }) = command;
    let architecture = architecture(name)?;
    let size = architecture.fit(input.rows_and_columns());
    let layers = architecture.layers();
    let parts = layers.chunk_by(|a, b| part(a) == part(b)).map(|layers| {
        let Cost { parameters, macs, activation_bytes } = layers.iter().map(|layer| layer.cost(size)).sum();
        let name = layers.first().map_or("", part).to_owned();
        Part { name, parameters, macs, activation_bytes }
    });
    let Cost { parameters, macs, activation_bytes } = architecture.cost(size);
    let parts = parts.collect();
    let input = ImageSize { width: size[1] as u32, height: size[0] as u32 }.to_string();
    let description = Description { architecture, input, parameters, macs, activation_bytes, parts };
    print_line(&if *json { serde_json::to_string_pretty(&description)? } else { in_words(&description)? })
}

fn part(layer: &NetworkLayer) -> &str {
    layer.name.split('.').next().unwrap_or_default()
}

fn in_words(description: &Description) -> Result<String> {
    let Description { architecture, input, parameters, macs, activation_bytes, parts } = description;
    let row = |name: &str, parameters: u64, macs: u64, bytes: u64| {
        let [parameters, macs, bytes] = [parameters, macs, bytes].map(|count| count as f64 / 1e6);
        format!("{name:<12} {parameters:>12.3} {macs:>12.1} {bytes:>16.2}\n")
    };
    let mut text = format!("{}\ninput {input}\n\n", serde_json::to_string(architecture)?);
    text += &format!("{:<12} {:>12} {:>12} {:>16}\n", "part", "parameters/M", "MMAC", "activations/MB");
    for part in parts {
        text += &row(&part.name, part.parameters, part.macs, part.activation_bytes);
    }
    text += row("all", *parameters, *macs, *activation_bytes).trim_end();
    Ok(text)
}
