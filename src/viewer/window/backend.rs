//! Opens a window with whatever draws on this machine: wgpu on a GPU; where there is none glow, which costs a CPU half as much; and if
//! that fails too, wgpu on the CPU.

use std::cell::Cell;
use std::panic::{self, AssertUnwindSafe};
use std::sync::Arc;

use anyhow::{Result, bail};
use clap::ValueEnum;
use eframe::egui_wgpu::{WgpuSetup, WgpuSetupCreateNew};
use eframe::wgpu::{Adapter, DeviceType};
use eframe::{App, NativeOptions, egui};

/// What draws the window.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
pub enum Renderer {
    /// The first that works: wgpu on a GPU, glow, wgpu on the CPU
    #[default]
    Auto,
    /// Vulkan, Metal or Direct3D through wgpu
    Wgpu,
    /// OpenGL through glow
    Glow,
}

/// One way to draw.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Attempt {
    Gpu,
    Glow,
    AnyWgpu,
}

impl Renderer {
    fn attempts(self) -> &'static [Attempt] {
        match self {
            Self::Auto => &[Attempt::Gpu, Attempt::Glow, Attempt::AnyWgpu],
            Self::Wgpu => &[Attempt::AnyWgpu],
            Self::Glow => &[Attempt::Glow],
        }
    }
}

impl Attempt {
    fn name(self) -> &'static str {
        match self {
            Self::Gpu => "wgpu on a GPU",
            Self::Glow => "glow",
            Self::AnyWgpu => "wgpu",
        }
    }

    fn options(self, viewport: egui::ViewportBuilder) -> NativeOptions {
        let renderer = match self {
            Self::Gpu | Self::AnyWgpu => eframe::Renderer::Wgpu,
            Self::Glow => eframe::Renderer::Glow,
        };
        let mut options = NativeOptions { viewport, renderer, ..NativeOptions::default() };
        if self == Self::Gpu {
            let mut setup = WgpuSetupCreateNew::without_display_handle();
            setup.native_adapter_selector = Some(Arc::new(|adapters, surface| {
                let fits = |adapter: &&Adapter| {
                    let is_gpu = matches!(
                        adapter.get_info().device_type,
                        DeviceType::DiscreteGpu | DeviceType::IntegratedGpu | DeviceType::VirtualGpu
                    );
                    is_gpu && surface.is_none_or(|surface| adapter.is_surface_supported(surface))
                };
                adapters.iter().find(fits).cloned().ok_or_else(|| "there is no GPU".to_owned())
            }));
            options.wgpu_options.wgpu_setup = WgpuSetup::CreateNew(setup);
        }
        options
    }
}

/// Opens a window and returns when it is closed. `app` is asked for once a way to draw has been found.
///
/// # Errors
/// If no window can be opened: each attempt with what it failed of, and the command that needs none.
pub fn open(
    renderer: Renderer,
    viewport: &egui::ViewportBuilder,
    without_window: &str,
    app: &dyn Fn(&egui::Context) -> Box<dyn App>,
) -> Result<()> {
    if !has_display() {
        bail!(
            "there is no display (neither DISPLAY nor WAYLAND_DISPLAY is set); without one there is {without_window}"
        );
    }
    let mut failures = Vec::new();
    let has_opened = Cell::new(false);
    for &attempt in renderer.attempts() {
        let options = attempt.options(viewport.clone());
        let app = |creation: &eframe::CreationContext<'_>| {
            has_opened.set(true);
            Ok(app(&creation.egui_ctx))
        };
        let run = || eframe::run_native("mambavitact", options, Box::new(app));
        // winit opens the libraries of X11 and Wayland at run time, and answers with a panic if one is missing.
        let failure = match panic::catch_unwind(AssertUnwindSafe(run)) {
            Ok(Ok(())) => return Ok(()),
            Ok(Err(error)) if has_opened.get() => bail!("the window was lost ({error})"),
            Ok(Err(error)) => error.to_string(),
            Err(cause) if has_opened.get() => panic::resume_unwind(cause),
            Err(cause) => panic_text(cause.as_ref()),
        };
        tracing::debug!("{}: {failure}", attempt.name());
        failures.push(format!("{}: {failure}", attempt.name()));
    }
    bail!("no window can be opened ({}); without one there is {without_window}", failures.join("; "));
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
