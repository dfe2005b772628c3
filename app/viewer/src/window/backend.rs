//! Opens the window with OpenGL (glow), on a graphics card or on the CPU.
//!
//! Our own rasteriser paints the scene, so that the window only shows pictures and widgets: one backend is enough, and wgpu would
//! double the time that the program takes to build.

use std::cell::Cell;
use std::panic::{self, AssertUnwindSafe};

use anyhow::{Result, bail};
use eframe::{App, NativeOptions, egui};

/// Opens a window and returns when it is closed. `app` is called once the window has opened.
///
/// # Errors
/// If no window can be opened; the message names `without_window`, the command that needs none.
pub fn open(
    viewport: &egui::ViewportBuilder,
    without_window: &str,
    app: &dyn Fn(&egui::Context) -> Box<dyn App>,
) -> Result<()> {
    if !has_display() {
        bail!(
            "there is no display (neither DISPLAY nor WAYLAND_DISPLAY is set); without one there is {without_window}"
        );
    }
    let has_opened = Cell::new(false);
    let options = NativeOptions { viewport: viewport.clone(), ..NativeOptions::default() };
    let app = |creation: &eframe::CreationContext<'_>| {
        has_opened.set(true);
        Ok(app(&creation.egui_ctx))
    };
    let run = || eframe::run_native("mambavitact", options, Box::new(app));
    // winit opens the libraries of X11 and Wayland at run time, and panics if one is missing.
    let failure = match panic::catch_unwind(AssertUnwindSafe(run)) {
        Ok(Ok(())) => return Ok(()),
        Ok(Err(error)) if has_opened.get() => bail!("the window was lost ({error})"),
        Ok(Err(error)) => error.to_string(),
        Err(cause) if has_opened.get() => panic::resume_unwind(cause),
        Err(cause) => panic_text(cause.as_ref()),
    };
    bail!("cannot open a window with OpenGL: {failure}; without a window there is {without_window}");
}

/// Whether a window has somewhere to appear: on Linux and its likes a display server has to be named.
fn has_display() -> bool {
    let is_set = |name: &str| std::env::var_os(name).is_some_and(|value| !value.is_empty());
    !cfg!(all(unix, not(target_os = "macos")))
        || ["DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"].into_iter().any(is_set)
}

fn panic_text(cause: &(dyn std::any::Any + Send)) -> String {
    let text = cause.downcast_ref::<&str>().map(|text| (*text).to_owned());
    let text = text.or_else(|| cause.downcast_ref::<String>().cloned());
    text.unwrap_or_else(|| "it panicked".to_owned())
}
