//! `mesh`: the shape that a run has learnt, at any resolution.

use std::path::PathBuf;

use anyhow::{Context as _, Result, bail};
use clap::Args;
use mvt_field::field::NeuralField;
use mvt_field::surface::outer_surface;
use mvt_slam::map::Map;

use mvt_run::io::print_line;
use mvt_run::report::mesh_file;

/// Mesh the shape that a run has learnt, at any resolution
///
/// The mesh is in metres, in the frame of the field, whose origin lies in the middle of what was seen first.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Folder of the run, or its field.safetensors
    #[arg(long, value_name = "DIR")]
    run: PathBuf,
    /// Edge of the cells, millimetres
    #[arg(long, default_value_t = 1.0)]
    cell_mm: f32,
    /// The mesh, a .ply or .obj file
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<()> {
    let Arguments { run, cell_mm, out } = arguments;
    // Below, a mesh of the whole box no longer fits into memory.
    if !(0.2..=20.0).contains(cell_mm) {
        bail!("--cell-mm {cell_mm}: it must be from 0.2 to 20");
    }
    let is_ply = match out.extension().and_then(|extension| extension.to_str()) {
        Some("ply") => true,
        Some("obj") => false,
        _ => bail!("--out {}: give a name that ends in .ply or .obj", out.display()),
    };
    let path = if run.is_dir() { run.join(Map::FILES[0]) } else { run.clone() };
    let field = NeuralField::load(&path)?;
    let mesh = outer_surface(&field, field.config().half_extent_m, cell_mm * 1e-3);
    if mesh.faces.is_empty() {
        bail!("{} holds no surface: its run saw nothing of the object", path.display());
    }
    let bytes = if is_ply { mesh_file::ply(&mesh, None) } else { mesh_file::obj(&mesh).into_bytes() };
    std::fs::write(out, bytes).with_context(|| format!("cannot write {}", out.display()))?;
    print_line(&format!("{} triangles, {:.1} cm2, in {}", mesh.faces.len(), mesh.area_m2() * 1e4, out.display()))
}
