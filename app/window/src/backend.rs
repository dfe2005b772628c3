//! Opens the window with OpenGL (glow), on a graphics card or on the CPU.
//!
//! Our own rasteriser paints the scene, so that the window shows only pictures and widgets. One backend is enough, and
//! wgpu would double the build time.

// Why: notes/decisions/viewing.md, "The window uses OpenGL alone".

use std::cell::Cell;
use std::panic::{self, AssertUnwindSafe};

use eframe::{App, NativeOptions, egui};
use mvt_viewer::window_program::has_display;

/// Why the window cannot be shown.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WindowError {
    /// There is no display server.
    #[error("there is no display (neither DISPLAY nor WAYLAND_DISPLAY is set)")]
    NoDisplay,
    /// The window system or its libraries refuse a window.
    #[error("cannot open a window with OpenGL: {0}")]
    NoWindow(String),
    /// The window system has failed while the window was open.
    #[error("the window was lost ({0})")]
    Lost(String),
}

/// Opens a window and returns when it is closed. `app` is called once the window has opened.
pub fn open(viewport: &egui::ViewportBuilder, app: &dyn Fn(&egui::Context) -> Box<dyn App>) -> Result<(), WindowError> {
    if !has_display() {
        return Err(WindowError::NoDisplay);
    }
    let has_opened = Cell::new(false);
    let options = NativeOptions { viewport: viewport.clone(), ..NativeOptions::default() };
    let app = |creation: &eframe::CreationContext<'_>| {
        has_opened.set(true);
        Ok(app(&creation.egui_ctx))
    };
    let run = || eframe::run_native("mambavitact", options, Box::new(app));
    // winit loads the libraries of X11 and Wayland at run time, and panics if one is missing.
    match panic::catch_unwind(AssertUnwindSafe(run)) {
        Ok(Ok(())) => Ok(()),
        Ok(Err(error)) if has_opened.get() => Err(WindowError::Lost(error.to_string())),
        Ok(Err(error)) => Err(WindowError::NoWindow(error.to_string())),
        Err(cause) if has_opened.get() => panic::resume_unwind(cause),
        Err(cause) => Err(WindowError::NoWindow(panic_text(cause.as_ref()))),
    }
}

fn panic_text(cause: &(dyn std::any::Any + Send)) -> String {
    let text = cause.downcast_ref::<&str>().map(|text| (*text).to_owned());
    let text = text.or_else(|| cause.downcast_ref::<String>().cloned());
    text.unwrap_or_else(|| "it panicked".to_owned())
}
