//! `touch train`, on procedural objects.

use std::path::Path;
use std::process::Stdio;

use crate::workplace::Workplace;

/// Writes the configuration of a tiny network and of one sensor. With this seed and rate the overlap grows steadily; with others so short a
/// training swings, and differently on each instruction set.
fn write_config(workplace: &Workplace, steps: u32, validate_every: u32) {
    let config = format!(
        "[network]\nname = \"default\"\nwidths = [8, 8, 12, 16]\ndepth = 2\nstate = 4\n\n\
         [data]\nsensors = 1\nuntouched = 0.0\nprotocol = 1.0\ndeep = 0.0\ndisturbed_lights = 0.0\nbackground = 1.0\n\
         objects = {{ train = [\"mug\", \"large_dice\", \"ball\"], validate = [\"pear\"] }}\n\n\
         [training]\nseed = 4\nvalidate_every = {validate_every}\nvalidation_images = 4\n\
         stages = [{{ size = [80, 64], batch = 4, steps = {steps} }}]\n\n\
         [training.optimiser]\nlearning_rate = 3e-3\nwarm_up = 20\naverage = 0.9\n"
    );
    workplace.write("config.toml", config);
}

/// Returns the rows of a curve without the column of the speed.
fn curve(workplace: &Workplace, folder: &str) -> Vec<Vec<f64>> {
    let Ok(text) = std::fs::read_to_string(workplace.path(folder).join("curve.csv")) else { return vec![] };
    let cells = |line: &str| line.split(',').map(|cell| cell.parse().unwrap()).collect::<Vec<f64>>();
    text.lines().skip(1).map(cells).map(|row| [&row[..1], &row[2..]].concat()).collect()
}

fn line(folder: &str) -> String {
    format!("touch train --network default --config config.toml --out {folder}")
}

/// Runs until the curve has this many rows, kills the training, and returns whether it was still running.
fn killed_after(workplace: &Workplace, line: &str, rows: usize) -> bool {
    let mut child = workplace.command(line).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    while curve(workplace, "killed").len() < rows && child.try_wait().unwrap().is_none() {
        std::thread::yield_now();
    }
    child.kill().unwrap();
    !child.wait().unwrap().success()
}

/// The files of a training do not depend on kills, neither at its first checkpoint, which may be half written, nor
/// later.
#[test]
fn a_killed_training_is_resumed_to_the_bit() {
    let workplace = Workplace::new();
    write_config(&workplace, 24, 4);
    let mut kills = usize::from(killed_after(&workplace, &line("killed"), 1));
    let resume = format!("{} --resume", line("killed"));
    // The curve is written before the checkpoint; without a checkpoint the training starts again.
    let again = |line: &str| {
        if workplace.path("killed/checkpoint.safetensors").exists() { resume.clone() } else { line.to_owned() }
    };
    kills += usize::from(killed_after(&workplace, &again(&line("killed")), 3));
    assert!(kills >= 1, "the machine finished a training before it could be killed");
    workplace.run(&again(&line("killed"))).good();
    workplace.run(&line("whole")).good();
    assert_eq!(curve(&workplace, "killed"), curve(&workplace, "whole"));
    assert_eq!(curve(&workplace, "whole").len(), 6);
    for name in ["last.safetensors", "best.safetensors", "checkpoint.safetensors", "panels.png"] {
        let bytes = |folder: &str| std::fs::read(workplace.path(folder).join(name)).unwrap();
        assert!(bytes("killed") == bytes("whole"), "{name} differs");
    }
    let said = workplace.run(&line("whole")).error();
    assert!(said.contains("--resume"), "{said}");
}

/// A tiny network learns from rendered images in two hundred steps, also for an object that the training does not use.
#[test]
fn two_hundred_steps_bring_the_loss_down() {
    let workplace = Workplace::new();
    write_config(&workplace, 200, 20);
    workplace.run(&line("out")).good();
    let rows = curve(&workplace, "out");
    let last = rows[6..].iter().map(|row| row[1]).sum::<f64>() / 4.0;
    assert!(last < 0.26 && last < 0.7 * rows[0][1], "loss: {rows:?}");
    let overlap = rows.iter().map(|row| row[6]).fold(0.0, f64::max);
    assert!(overlap > 0.2, "overlap of contact: {rows:?}");
    // The written weights can be used.
    workplace.run("bench networks --weights out/best.safetensors --input 64x48 --batch 1 --seconds 0").good();
}

/// Images of 72 x 60 pixels: neither windows nor squares tile their maps.
#[test]
fn swin_and_convnext_are_trained_and_timed() {
    let workplace = Workplace::new();
    write_config(&workplace, 2, 2);
    let config = workplace.text("config.toml");
    let (_, rest) = config.split_once("\n\n").unwrap();
    for (name, heads) in [("swin", "heads = [1, 2, 2, 4]\n"), ("convnext", "")] {
        let network = format!("[network]\nname = \"{name}\"\nwidths = [8, 12, 16, 20]\n{heads}channels = 8");
        workplace.write("config.toml", format!("{network}\n\n{}", rest.replace("[80, 64]", "[72, 60]")));
        workplace.run(&format!("touch train --network {name} --config config.toml --out {name}")).good();
        let line = format!("bench networks --weights {name}/last.safetensors --input 60x72 --batch 1 --seconds 0");
        assert!(workplace.run(&line).good().contains(name));
    }
}

#[test]
fn wrong_configurations_are_refused() {
    let workplace = Workplace::new();
    write_config(&workplace, 1, 1);
    let config = workplace.text("config.toml");
    for (from, to, part) in [
        ("\"mug\"", "\"duck\"", "duck is kept for tests"),
        ("batch = 4", "batch = 0", "batch"),
        ("[80, 64]", "[80, 60]", "stride"),
        ("[80, 64]", "[336, 64]", "320"),
        ("widths = [8", "widths = [0", "widths"),
    ] {
        workplace.write("config.toml", config.replace(from, to));
        let said = workplace.run(&line("out")).error();
        assert!(said.contains(part), "{to}: {said}");
    }
    workplace.write("config.toml", &config);
    assert!(workplace.run(&line("out").replace("default", "vit")).error().contains("configures network default"));
    assert!(workplace.run(&format!("{} --resume", line("nothing"))).error().contains("checkpoint.safetensors"));
    // What is missing for a GPU is named; where nothing is missing, it would be used.
    if !Path::new("/proc/driver/nvidia").exists() {
        for command in [line("out"), "bench networks --networks default".to_owned()] {
            let said = workplace.run(&format!("{command} --device cuda")).error();
            assert!(said.contains("--device cuda") && said.contains("or use the CPU"), "{said}");
        }
    }
    assert!(workplace.run(&format!("{} --device tpu", line("out"))).usage().contains("auto, cpu, cuda"));
}
