//! A run of the estimator: where frames come from, the one loop that every run takes, and the files that it leaves.
//!
//! [`source`] delivers frames, [`pipeline::Pipeline`] drives any number of estimators on them and tells listeners, [`supervisor`] directs the
//! hand by the first estimate, and [`report`] writes the results. Simulated episodes are a source of another crate, mvt-simulated, so
//! that nothing here needs libmujoco.
//!
//! ```no_run
//! use std::sync::atomic::AtomicBool;
//!
//! use mvt_run::estimator::{Init, Mode};
//! use mvt_run::pipeline::{EstimatorSetup, Meshing, Pipeline, Progress};
//! use mvt_run::source::{LogSource, Modality, TouchArguments, TouchOrigin};
//! use mvt_slam::SlamConfig;
//!
//! // Tracks and maps the object of a FeelSight log with its first camera.
//! let log = "data/077_rubiks_cube/00".as_ref();
//! let touch = TouchArguments::new(TouchOrigin::Truth, None);
//! let mut source = LogSource::open(log, None, Modality::Vi, 5.0, &touch, Default::default())?;
//! let config = SlamConfig::default();
//! let setup = EstimatorSetup { config: &config, mode: Mode::Slam, modality: Modality::Vi, init: Init::Near, seed: 0, map: None };
//! let pipeline = Pipeline {
//!     estimators: vec![setup],
//!     meshing: Meshing { cell_m: 0.0015, every: None },
//!     object: None,
//!     truth: None,
//!     supervisor: None,
//!     single_threaded: false,
//! };
//! let finished = pipeline.run(&mut source, &AtomicBool::new(false), &mut |progress| {
//!     if let Progress::Frame { results, .. } = progress {
//!         results.iter().flatten().for_each(|result| println!("{:?}", result.estimate.pose));
//!     }
//! })?;
//! println!("{} estimator(s), {:.1} s", finished.estimators.len(), finished.wall_s);
//! # Ok::<(), anyhow::Error>(())
//! ```

pub mod arguments;
pub mod belief;
pub mod carrier;
pub mod config;
pub mod controller;
pub mod device;
pub mod estimator;
pub mod explorer;
pub mod exploring;
pub mod image_size;
pub mod input;
pub mod io;
pub mod live;
pub mod object;
pub mod observed;
pub mod pipeline;
pub mod program;
pub mod progress;
pub mod progress_recorder;
pub mod report;
pub mod sdf_grid;
pub mod settings;
pub mod source;
pub mod supervisor;
pub mod truth;

pub use {mvt_slam, ndarray};
