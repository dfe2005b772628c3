//! Exports: a picture of the window, and the mesh. They go to the working directory, because the folders of runs and
//! logs hold only the files of the run or log.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, Receiver};
use std::thread;

use anyhow::{Context as _, Result, bail};
use eframe::egui::{ColorImage, Context};

use mvt_recording::RecordedShape;
use mvt_run::report::{Coordinates, mesh_file};

/// Files that are being written.
#[derive(Default)]
pub struct Exports {
    messages: Vec<Receiver<String>>,
}

impl Exports {
    /// Writes a picture of the window. The file name begins with `name`.
    pub fn screenshot(&mut self, ctx: &Context, name: &str) {
        let (sender, receiver) = mpsc::channel();
        self.messages.push(receiver);
        let name = name.to_owned();
        let woken = ctx.clone();
        ctx.request_screenshot(move |image| {
            // Encoding takes longer than a frame.
            thread::spawn(move || {
                let _ = sender.send(outcome(write_screenshot(&name, &image)));
                woken.request_repaint();
            });
        });
    }

    /// Writes a mesh as PLY and OBJ. The file names begin with `name`.
    pub fn mesh(&mut self, name: &str, shape: &RecordedShape) {
        let (sender, receiver) = mpsc::channel();
        self.messages.push(receiver);
        let _ = sender.send(outcome(write_mesh(name, shape)));
    }

    /// Returns the outcomes since the last call.
    pub fn news(&mut self) -> Vec<String> {
        let mut news = Vec::new();
        self.messages.retain(|message| match message.try_recv() {
            Ok(text) => {
                news.push(text);
                false
            }
            Err(mpsc::TryRecvError::Empty) => true,
            Err(mpsc::TryRecvError::Disconnected) => {
                news.push("the window has returned no picture".to_owned());
                false
            }
        });
        news
    }
}

fn outcome(result: Result<PathBuf>) -> String {
    match result {
        Ok(path) => format!("wrote {}", path.display()),
        Err(error) => format!("{error:#}"),
    }
}

/// Returns a path that does not exist yet, with a number between stem and extension.
fn unused(stem: &str, extension: &str) -> Result<PathBuf> {
    let folder = std::env::current_dir().context("the working directory does not exist any more")?;
    let named = |number: u32| folder.join(format!("{stem}-{number:03}.{extension}"));
    match (1..1000).map(named).find(|path| !path.exists()) {
        Some(path) => Ok(path),
        None => bail!("{} already holds a thousand such files; delete some", folder.display()),
    }
}

fn write_screenshot(name: &str, image: &ColorImage) -> Result<PathBuf> {
    let path = unused(name, "png")?;
    let [width, height] = image.size.map(|side| side as u32);
    let bytes = image.pixels.iter().flat_map(|pixel| [pixel.r(), pixel.g(), pixel.b()]).collect();
    let picture =
        image::RgbImage::from_raw(width, height, bytes).context("the window has returned an empty picture")?;
    picture.save(&path).with_context(|| format!("cannot write {}", path.display()))?;
    Ok(path)
}

fn write_mesh(name: &str, shape: &RecordedShape) -> Result<PathBuf> {
    let path = unused(&format!("{name}-frame-{}", shape.frame), "ply")?;
    let write = |path: &Path, bytes: &[u8]| {
        std::fs::write(path, bytes).with_context(|| format!("cannot write {}", path.display()))
    };
    write(&path, &mesh_file::ply(&shape.mesh, Coordinates::Object, None))?;
    write(&path.with_extension("obj"), mesh_file::obj(&shape.mesh, Coordinates::Object).as_bytes())?;
    Ok(path)
}
