//! Files that are made on demand: a picture of the window, the mesh. They go to the working directory: the folder of a run holds what
//! the run has made, and a log is data.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, Receiver};
use std::thread;

use anyhow::{Context as _, Result, bail};
use eframe::egui::{ColorImage, Context};

use mvt_recording::KnownShape;
use mvt_run::report::mesh_file;

/// Files under way, which tell how they have fared.
#[derive(Default)]
pub struct Exports {
    coming: Vec<Receiver<String>>,
}

impl Exports {
    /// Writes a picture of the window. `name` is what it shows.
    pub fn screenshot(&mut self, ctx: &Context, name: &str) {
        let (sender, receiver) = mpsc::channel();
        self.coming.push(receiver);
        let name = name.to_owned();
        let woken = ctx.clone();
        ctx.request_screenshot(move |image| {
            // Encoding takes longer than a frame may.
            thread::spawn(move || {
                let _ = sender.send(told(write_screenshot(&name, &image)));
                woken.request_repaint();
            });
        });
    }

    /// Writes a mesh as PLY and OBJ. `name` is whose shape it is.
    pub fn mesh(&mut self, name: &str, shape: &KnownShape) {
        let (sender, receiver) = mpsc::channel();
        self.coming.push(receiver);
        let _ = sender.send(told(write_mesh(name, shape)));
    }

    /// What has become of files since this was last asked.
    pub fn news(&mut self) -> Vec<String> {
        let mut news = Vec::new();
        self.coming.retain(|coming| match coming.try_recv() {
            Ok(text) => {
                news.push(text);
                false
            }
            Err(mpsc::TryRecvError::Empty) => true,
            Err(mpsc::TryRecvError::Disconnected) => {
                news.push("the window gave no picture".to_owned());
                false
            }
        });
        news
    }
}

fn told(result: Result<PathBuf>) -> String {
    match result {
        Ok(path) => format!("wrote {}", path.display()),
        Err(error) => format!("{error:#}"),
    }
}

/// A path that is not there yet: a number between stem and extension.
fn unused(stem: &str, extension: &str) -> Result<PathBuf> {
    let folder = std::env::current_dir().context("the working directory is gone")?;
    let named = |number: u32| folder.join(format!("{stem}-{number:03}.{extension}"));
    match (1..1000).map(named).find(|path| !path.exists()) {
        Some(path) => Ok(path),
        None => bail!("{} holds a thousand of them already", folder.display()),
    }
}

fn write_screenshot(name: &str, image: &ColorImage) -> Result<PathBuf> {
    let path = unused(name, "png")?;
    let [width, height] = image.size.map(|side| side as u32);
    let bytes = image.pixels.iter().flat_map(|pixel| [pixel.r(), pixel.g(), pixel.b()]).collect();
    let picture = image::RgbImage::from_raw(width, height, bytes).context("the window gave an empty picture")?;
    picture.save(&path).with_context(|| format!("cannot write {}", path.display()))?;
    Ok(path)
}

fn write_mesh(name: &str, shape: &KnownShape) -> Result<PathBuf> {
    let path = unused(&format!("{name}-frame-{}", shape.frame), "ply")?;
    let write = |path: &Path, bytes: &[u8]| {
        std::fs::write(path, bytes).with_context(|| format!("cannot write {}", path.display()))
    };
    write(&path, &mesh_file::ply(&shape.mesh, None))?;
    write(&path.with_extension("obj"), mesh_file::obj(&shape.mesh).as_bytes())?;
    Ok(path)
}
