//! Pictures and films of recorded runs, and the way to their window.
//!
//! [`paint::ScenePainter`] paints the scene of a moment in three dimensions, [`dashboard::Dashboard`] puts it beside
//! the sensors' images and the curves. [`window_program`] finds the program that shows both in a window while a run goes
//! on. The viewer knows a run by its recording alone: it estimates nothing, and neither waits for the other.
//!
//! ```no_run
//! use mvt_viewer::mvt_picture::palette::Theme;
//! use mvt_viewer::{Dashboard, DashboardLayout, Eye, Layers, Preset, mvt_recording::Recording};
//!
//! let recording = Recording::open("out".as_ref())?;
//! let mut dashboard = Dashboard::new(DashboardLayout::All, [1280, 720], Layers::default(), Theme::LIGHT);
//! let last = recording.moments().len().saturating_sub(1);
//! dashboard.paint(&recording, last, &Eye::new(Preset::Oblique)).save("out.png")?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod captions;
pub mod dashboard;
pub mod eye;
pub mod layers;
pub mod legend;
pub mod live;
pub mod paint;
mod run_charts;
pub mod run_choices;
mod seen_points;
pub mod sensor_pictures;
pub mod source;
mod tiling;
pub mod window_program;

pub use dashboard::{Dashboard, DashboardLayout};
pub use eye::{Eye, Preset};
pub use layers::{Clouds, Colouring, Keyframes, Layers};
pub use paint::ScenePainter;
pub use source::{RecordingSource, WindowContents};
pub use {image, mvt_frames, mvt_picture, mvt_recording, mvt_render, nalgebra};
