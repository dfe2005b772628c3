//! `touch render`: one touch image of a mesh at a pose.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use clap::Args;
use mvt_feelsight::array::Array;
use mvt_feelsight::npy;
use mvt_files::input;
use mvt_render::touch::{Background, TouchConfig, render_contact};
use mvt_run::io::{check_named, read_image, write_named};
use ndarray::{Array2, Array3};

/// Largest file of a pose that is read, bytes.
const LARGEST_POSE: u64 = 1 << 20;

/// Render one touch image of a mesh that a DIGIT touches at a given pose, without noise
///
/// Writes three NumPy files: PREFIX_rgb_raw.npy (uint8, 320 x 240 x 3, the shaded gel), PREFIX_rgb_cal.npy (uint8, the
/// same over the background) and PREFIX_depth.npy (float32, 320 x 240, metres along the camera's axis). The images are
/// formed as in TACTO.
#[derive(Debug, Args)]
pub struct TouchRenderArguments {
    /// Mesh in metres (OBJ, STL or PLY), in its own coordinates; its vertex normals are smoothed
    #[arg(long)]
    mesh: PathBuf,
    /// JSON file with a 4 x 4 row-major matrix that takes coordinates of the mesh to those of the sensor
    #[arg(long)]
    pose: PathBuf,
    /// Lights of the DIGIT: `fork` as in YCB-Slide and FeelSight, or `tacto` as in TACTO 0.0.3
    #[arg(long, default_value = "fork")]
    config: TouchConfig,
    /// Untouched image of a real DIGIT, 240 x 320 pixels, as background [default: the rendered untouched gel]
    #[arg(long)]
    background: Option<PathBuf>,
    /// Start of the paths of the written files
    #[arg(long, value_name = "PREFIX")]
    out: PathBuf,
    /// Replace existing files
    #[arg(long)]
    overwrite: bool,
}

/// Runs the command.
pub fn run(arguments: &TouchRenderArguments) -> Result<()> {
    let TouchRenderArguments { mesh: mesh_path, pose: pose_path, .. } = arguments;
    // Repairs move no vertex, so the pose still fits; a file in millimetres is scaled to the pose's metres.
    let (raw, read_warnings) = mvt_mesh::read(mesh_path)?;
    let (mesh, warnings) = mvt_mesh::repair(&raw, &mesh_path.display().to_string())?;
    for warning in read_warnings.iter().chain(&warnings) {
        tracing::warn!("{warning}");
    }
    let text =
        input::read_text(pose_path, LARGEST_POSE).with_context(|| format!("cannot read {}", pose_path.display()))?;
    let pose: [[f64; 4]; 4] = serde_json::from_str(&text)
        .with_context(|| format!("--pose {} does not contain a 4 x 4 matrix of numbers", pose_path.display()))?;
    let background = match &arguments.background {
        Some(path) => Background::Image(read_image(path)?),
        None => Background::Rendered,
    };
    let arrays = render_contact(&mesh, &pose, arguments.config, background)
        .with_context(|| format!("cannot render the pose in {}", pose_path.display()))?;
    let image = |image: &Array3<u8>| Array::from_u8(image.shape().to_vec(), image.iter().copied().collect());
    let depth = |depth: &Array2<f32>| Array::from_f32(depth.shape().to_vec(), depth.iter().copied());
    let arrays =
        [("rgb_raw", image(&arrays.raw)), ("rgb_cal", image(&arrays.calibrated)), ("depth", depth(&arrays.depth_m))];
    for (name, _) in &arrays {
        check_named(&path(&arguments.out, name), arguments.overwrite)?;
    }
    for (name, array) in &arrays {
        write(&path(&arguments.out, name), array, arguments.overwrite)?;
    }
    Ok(())
}

fn path(prefix: &Path, name: &str) -> PathBuf {
    let mut path = prefix.as_os_str().to_owned();
    path.push(format!("_{name}.npy"));
    PathBuf::from(path)
}

fn write(path: &Path, array: &Array, overwrite: bool) -> Result<()> {
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    }
    write_named(path, &npy::to_bytes(array), overwrite)
}
