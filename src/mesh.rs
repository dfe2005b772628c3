//! `mesh`: a mesh of the shape that a run has estimated, at any resolution.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail, ensure};
use clap::Args;
use glam::{Vec3, Vec3A};
use mvt_field::field::NeuralField;
use mvt_field::surface::outer_surface;
use mvt_files::input;
use mvt_frames::{Field, Isometry, Object};
use mvt_run::io::{check_named, print_line, write_named};
use mvt_run::report::{Coordinates, file, mesh_file};
use mvt_slam::map::Map;
use serde::Deserialize;

/// Largest summary.json that is read, bytes.
const LARGEST_SUMMARY: u64 = 64 << 20;

/// Write a mesh of the shape that a run has estimated, at any resolution
///
/// The mesh is in metres and in the coordinates of the run's mesh.ply, from which the poses in trajectory.csv lead; the
/// file says so, and `score` reads it. Given only a field.safetensors, the mesh is in the coordinates of the field.
///
/// A PLY says of each vertex whether a sensor has seen the surface there (property `seen`), and how far the points that were measured around it lie
/// from it, as a standard deviation in metres (`deviation`). What was not seen is a guess that closes the shape.
#[derive(Debug, Args)]
pub struct MeshArguments {
    /// Folder of the run, or the path of its field.safetensors
    #[arg(long, value_name = "DIR")]
    run: PathBuf,
    /// Edge of the grid cells in millimetres, 0.2 to 20; smaller cells give more triangles
    #[arg(long, value_name = "MM", default_value_t = 1.0)]
    cell_mm: f32,
    /// Leave out the guesses: faces where no sensor has seen a surface
    #[arg(long)]
    seen_only: bool,
    /// File to write, .ply or .obj
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Replace an existing file
    #[arg(long)]
    overwrite: bool,
}

/// The part of a run's summary that places its field.
#[derive(Deserialize)]
struct FieldPlace {
    #[serde(default)]
    object_from_field: Option<[f64; 7]>,
}

/// Reads what takes the coordinates of the field to those of the run's mesh; `None` without the folder of a run, and for runs of version
/// 0.1.0.
fn object_from_field(run: &Path) -> Result<Option<Isometry<Field, Object>>> {
    let path = run.join(file::SUMMARY);
    let text = match input::read_text(&path, LARGEST_SUMMARY) {
        Ok(text) => text,
        Err(error) if matches!(error.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => return Ok(None),
        Err(error) => return Err(error).with_context(|| format!("cannot read {}", path.display())),
    };
    let place: FieldPlace = serde_json::from_str(&text).with_context(|| format!("cannot read {}", path.display()))?;
    let Some([x, y, z, q @ ..]) = place.object_from_field else { return Ok(None) };
    let length = q.iter().map(|c| c * c).sum::<f64>();
    ensure!(
        [x, y, z].iter().all(|c| c.abs() < 100.0) && (0.25..4.0).contains(&length),
        "{}: object_from_field is not a pose",
        path.display()
    );
    Ok(Some(Isometry::from_parts([x, y, z], q)))
}

/// Runs the command.
pub fn run(arguments: &MeshArguments) -> Result<()> {
    let MeshArguments { run, cell_mm, seen_only, out, overwrite } = arguments;
    // With smaller cells a mesh of the whole box no longer fits into memory.
    if !(0.2..=20.0).contains(cell_mm) {
        bail!("--cell-mm {cell_mm}: it must be from 0.2 to 20");
    }
    let is_ply = match out.extension().and_then(|extension| extension.to_str()) {
        Some("ply") => true,
        Some("obj") => false,
        _ => bail!("--out {}: give a name that ends in .ply or .obj", out.display()),
    };
    check_named(out, *overwrite)?;
    let path = if run.is_dir() { run.join(Map::FILES[0]) } else { run.clone() };
    // A field that was copied alone has no measurements beside it.
    let map = run.join(Map::FILES[1]).is_file().then(|| Map::load_shape(run)).transpose()?;
    ensure!(
        map.is_some() || !seen_only,
        "--seen-only: {} has no {}, which says what was seen; give the folder of a run",
        run.display(),
        Map::FILES[1]
    );
    let alone;
    let field = match &map {
        Some(map) => map.field(),
        None => {
            alone = NeuralField::load(&path)?;
            &alone
        }
    };
    let mut mesh = outer_surface(field, field.config().half_extent_m, cell_mm * 1e-3);
    if let Some(map) = map.as_ref().filter(|_| *seen_only) {
        mesh = mesh.part(|vertex| map.space().is_near_surface(vertex));
    }
    if mesh.faces.is_empty() {
        bail!(
            "{} contains no surface, because its run never saw the object; run again longer or with cameras",
            path.display()
        );
    }
    let deviations_m = map.as_ref().map(|map| map.vertex_deviations_m(&mesh.vertices));
    let coordinates = match object_from_field(run)? {
        Some(pose) => {
            let (rotation, translation) = pose.to_f32();
            for vertex in &mut mesh.vertices {
                *vertex = Vec3::from(rotation * Vec3A::from(*vertex) + translation);
            }
            Coordinates::Object
        }
        None => {
            tracing::warn!(
                "the mesh is in the coordinates of the field, because no summary.json says where the object is"
            );
            Coordinates::Field
        }
    };
    let bytes = match is_ply {
        true => match &deviations_m {
            Some(deviations_m) => mesh_file::ply_with_deviations(&mesh, coordinates, deviations_m),
            None => mesh_file::ply(&mesh, coordinates, None),
        },
        false => mesh_file::obj(&mesh, coordinates).into_bytes(),
    };
    write_named(out, &bytes, *overwrite)?;
    let guessed = deviations_m.as_ref().map(|all| all.iter().filter(|deviation_m| deviation_m.is_none()).count());
    let guessed = guessed.map(|count| 100.0 * count as f64 / mesh.vertices.len().max(1) as f64);
    let guessed = guessed.map_or_else(String::new, |percent| format!(", {percent:.0} % of it a guess"));
    let area_cm2 = mesh.area_m2() * 1e4;
    print_line(&format!("{} triangles, {area_cm2:.1} cm2{guessed}, in {}", mesh.faces.len(), out.display()))
}
