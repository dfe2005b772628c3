//! `touch describe`: parameters, multiplications and activations of a touch network.

use std::path::Path;

use anyhow::Result;
use clap::Args;
use mvt_run::io::print_line;
use mvt_run::settings;
use mvt_touch::network::{Architecture, Cost, NetworkLayer};
use serde::{Deserialize, Serialize};

use mvt_run::image_size::ImageSize;

/// Count the parameters, multiplications and activations of a touch network
///
/// MACs are the multiply-adds of matrix products, convolutions, attention and scans for one image. Activations are the
/// outputs of all layers for one image, as 32-bit floats.
#[derive(Debug, Args)]
pub struct TouchDescribeArguments {
    /// Network: vit, mamba, robust_mamba, swin, convnext or default; or a training configuration (.toml) whose table
    /// `network` describes one
    name: String,
    /// Size of the image in pixels, as WIDTHxHEIGHT or one side of a square; it is rounded up to a size that the
    /// network accepts
    #[arg(long, value_name = "SIZE", default_value = "240x320")]
    input: ImageSize,
    /// Print one JSON object instead of a table
    #[arg(long)]
    json: bool,
}

/// The printed result.
#[derive(Debug, Serialize)]
struct Description {
    architecture: Architecture,
    input: String,
    parameters: u64,
    macs: u64,
    activation_bytes: u64,
    parts: Vec<Part>,
}

/// Layers whose names have the same first part.
#[derive(Debug, Serialize)]
struct Part {
    name: String,
    parameters: u64,
    macs: u64,
    activation_bytes: u64,
}

/// Returns the preset of a name, or the network of a training configuration.
pub fn architecture(name: &str) -> Result<Architecture> {
    /// The table of a training configuration that describes the network.
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
pub fn run(arguments: &TouchDescribeArguments) -> Result<()> {
    let TouchDescribeArguments { name, input, json } = arguments;
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
