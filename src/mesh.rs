//! `mesh`: a mesh of the shape that a run has estimated, at any resolution.

use std::path::PathBuf;

use anyhow::{Context as _, Result, bail};
use clap::Args;
use mvt_field::field::NeuralField;
use mvt_field::surface::outer_surface;
use mvt_run::io::print_line;
use mvt_run::report::mesh_file;
use mvt_slam::map::Map;

/// Write a mesh of the shape that a run has estimated, at any resolution
///
/// The mesh is in metres and in the coordinates of the field, whose origin lies near the middle of the object as the
/// first frame shows it.
#[derive(Debug, Args)]
pub struct MeshArguments {
    /// Folder of the run, or the path of its field.safetensors
    #[arg(long, value_name = "DIR")]
    run: PathBuf,
    /// Edge of the grid cells in millimetres, 0.2 to 20; smaller cells give more triangles
    #[arg(long, value_name = "MM", default_value_t = 1.0)]
    cell_mm: f32,
    /// File to write, .ply or .obj
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

/// Runs the command.
pub fn run(arguments: &MeshArguments) -> Result<()> {
    let MeshArguments { run, cell_mm, out } = arguments;
    // With smaller cells a mesh of the whole box no longer fits into memory.
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
        bail!(
            "{} contains no surface, because its run never saw the object; run again longer or with cameras",
            path.display()
        );
    }
    let bytes = if is_ply { mesh_file::ply(&mesh, None) } else { mesh_file::obj(&mesh).into_bytes() };
    std::fs::write(out, bytes).with_context(|| format!("cannot write {}", out.display()))?;
    print_line(&format!("{} triangles, {:.1} cm2, in {}", mesh.faces.len(), mesh.area_m2() * 1e4, out.display()))
}
