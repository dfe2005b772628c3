//! Episodes of the simulator.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use mvt_frames::camera::PosedCamera;
use mvt_gaits::clock::PHYSICS_HZ;
use mvt_gaits::controller::Controller;
use mvt_gaits::controller_file::is_policy;
use mvt_gaits::gait::{self, AUTO};
use mvt_objects::object::Object;
use mvt_physics::air::PlaceErrors;
use mvt_physics::episode::{End, Episode as Simulated, EpisodeConfig, EpisodeSnapshot, Randomisation};
use mvt_render::observer::{Observer, ObserverOptions, ObserverScratch};
use mvt_render::touch::{TouchConfig, TouchOptions};
use mvt_run::controller::choose_any;
use mvt_run::object::load_object;
use numpy::{PyArray1, PyArrayDyn};
use pyo3::prelude::*;

use crate::arrays::{line, matrix, stacked};
use crate::camera::{Camera, around, read_rig};
use crate::errors::{Failure, Kind, argument, check_camera_noise, check_duration, detached, general};
use crate::frame::{Frame, read_joints};

/// State of an episode, which `Episode.restore` takes.
#[pyclass(frozen, module = "mambavitact")]
pub struct EpisodeState {
    snapshot: EpisodeSnapshot,
    frame: u32,
}

/// Episode of a hand that turns an object in MuJoCo.
///
/// `object` is a name that `mambavitact assets list` shows, `random:SEED`, or the path of a mesh in metres. The seed decides the start and
/// all noise; it plays the episode of `mambavitact simulate --seed`. `gait` is a name that `mambavitact controllers` lists, the path of a learnt
/// policy, or auto. `cameras` are places as in `Camera.placed`, or an empty text.
/// `camera_noise` is a multiple of Redwood's depth noise, 0 for true depth.
#[pyclass(frozen, module = "mambavitact")]
pub struct Episode {
    object: Object,
    config: EpisodeConfig,
    gait_name: String,
    /// Moves the hand in place of the gait: a learnt policy.
    mover: Option<Box<dyn Controller>>,
    cameras: Vec<PosedCamera>,
    touch_noise: bool,
    camera_noise: f64,
    running: Mutex<Running>,
}

/// The part that changes.
struct Running {
    episode: Simulated,
    seed: u64,
    /// Number of the next observation, which decides its noise.
    frame: u32,
    /// Made on first use.
    observer: Option<Observer>,
    scratch: ObserverScratch,
}

impl Running {
    fn new(object: &Object, config: &EpisodeConfig, mover: Option<Box<dyn Controller>>) -> Result<Self, Failure> {
        let episode = match mover {
            Some(mover) => Simulated::moved_by(object, config, mover),
            None => Simulated::new(object, config),
        };
        let mut episode = episode.map_err(general)?;
        episode.rehearse(PlaceErrors::default(), config.seed);
        Ok(Self { episode, seed: config.seed, frame: 0, observer: None, scratch: ObserverScratch::default() })
    }
}

impl Episode {
    fn running(&self) -> MutexGuard<'_, Running> {
        self.running.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn observer(&self, seed: u64) -> Result<Observer, Failure> {
        let options = ObserverOptions {
            hand: Arc::clone(&self.config.hand),
            cameras: self.cameras.clone(),
            touch: TouchOptions::of_hand(&self.config.hand, TouchConfig::Fork, None),
            touch_noise: self.touch_noise,
            camera_depth_noise: (self.camera_noise > 0.0).then_some(self.camera_noise),
            seed,
        };
        Observer::new(&self.object, options).map_err(general)
    }
}

#[pymethods]
impl Episode {
    #[new]
    #[pyo3(signature = (object, *, seed = 0, rig = "allegro_digit", side = None, gait = "auto", duration_s = 30.0, cameras = "front-left", randomise = true, touch_noise = true, camera_noise = 5.0))]
    fn new(
        py: Python<'_>,
        object: &str,
        seed: u64,
        rig: &str,
        side: Option<&str>,
        gait: &str,
        duration_s: f64,
        cameras: &str,
        randomise: bool,
        touch_noise: bool,
        camera_noise: f64,
    ) -> PyResult<Self> {
        let rig = read_rig(py, rig, side)?;
        let cameras = around(cameras, &rig)?;
        let hand = rig.hand;
        check_duration(duration_s)?;
        check_camera_noise(camera_noise)?;
        detached(py, || {
            let object = load_object(object).map_err(argument)?;
            let (gait_name, gait, mover) = if is_policy(gait) || gait == AUTO {
                let chosen = choose_any(gait, &object, &hand).map_err(Kind::Argument.of())?;
                if chosen.mover.as_ref().is_some_and(|mover| mover.needs_touch()) {
                    return Err(Kind::Argument
                        .error(format!("gait: {gait} observes touch_depth, which an episode does not feel")));
                }
                (chosen.name, chosen.gait, chosen.mover)
            } else {
                let (name, gait) = gait::choose(gait, &object, &hand).map_err(argument)?;
                (name.to_owned(), gait.clone(), None)
            };
            let randomisation = if randomise { Randomisation::default() } else { Randomisation::none() };
            let config = EpisodeConfig { hand, gait, seed, duration_s, randomisation };
            let running = Mutex::new(Running::new(&object, &config, mover.clone())?);
            Ok(Self { object, config, gait_name, mover, cameras, touch_noise, camera_noise, running })
        })
    }

    /// Starts again, with another seed if one is given.
    #[pyo3(signature = (seed = None))]
    fn reset(&self, py: Python<'_>, seed: Option<u64>) -> PyResult<()> {
        detached(py, || {
            let mut running = self.running();
            let config = EpisodeConfig { seed: seed.unwrap_or(running.seed), ..self.config.clone() };
            *running = Running::new(&self.object, &config, self.mover.clone())?;
            Ok(())
        })
    }

    /// Simulates `steps` steps of 1/300 s, fewer if the episode ends, and returns whether it goes on. The joints aim at `targets`,
    /// one angle in radians per joint; without them the gait plays, with a command every 12 steps, or the policy at its own rate.
    #[pyo3(signature = (targets = None, steps = 12))]
    fn step(&self, py: Python<'_>, targets: Option<&Bound<'_, PyAny>>, steps: u32) -> PyResult<bool> {
        let targets = targets.map(|targets| read_joints(targets, "targets")).transpose()?;
        let expected = self.config.hand.joints().len();
        if let Some(found) = targets.as_ref().map(Vec::len).filter(|found| *found != expected) {
            return Err(Kind::Argument.error(format!("targets: the hand has {expected} joints, got {found}")).into());
        }
        /// Steps between two looks for Ctrl-C: about a tenth of a second.
        const AT_ONCE: u32 = 3000;
        let mut left = steps;
        loop {
            let now = left.min(AT_ONCE);
            left -= now;
            let goes_on = detached(py, || {
                let mut running = self.running();
                running.episode.advance(now, targets.as_deref());
                Ok(running.episode.end().is_none())
            })?;
            if left == 0 || !goes_on {
                return Ok(goes_on);
            }
        }
    }

    /// Renders all sensors now. The noise differs from call to call.
    fn observe(&self, py: Python<'_>) -> PyResult<Frame> {
        detached(py, || {
            let mut running = self.running();
            let Running { episode, seed, frame, observer, scratch } = &mut *running;
            let observer = match observer {
                Some(observer) => observer,
                None => observer.insert(self.observer(*seed)?),
            };
            let (observation, truth) = observer.observe(*frame, &episode.state().scene, scratch);
            *frame += 1;
            Ok(Frame::observed(&self.config.hand, observation, Some(truth)))
        })
    }

    /// Returns the image of each touch sensor that touches nothing, without noise: uint8 (P, height, width, 3).
    fn untouched<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<u8>>> {
        let images = detached(py, || {
            let mut running = self.running();
            let seed = running.seed;
            let observer = match &mut running.observer {
                Some(observer) => observer,
                none => none.insert(self.observer(seed)?),
            };
            Ok(observer.untouched_images())
        })?;
        stacked(py, &images)
    }

    /// Returns the state.
    fn save(&self) -> EpisodeState {
        let running = self.running();
        EpisodeState { snapshot: running.episode.save(), frame: running.frame }
    }

    /// Sets a saved state of an episode with the same object, settings and seed. It continues bit for bit.
    fn restore(&self, py: Python<'_>, state: &EpisodeState) -> PyResult<()> {
        detached(py, || {
            let mut running = self.running();
            running.episode.restore(&state.snapshot).map_err(argument)?;
            running.frame = state.frame;
            Ok(())
        })
    }

    /// Name of the object.
    #[getter]
    fn object(&self) -> &str {
        &self.object.name
    }

    /// Hand: left or right.
    #[getter]
    fn side(&self) -> &'static str {
        self.config.hand.side().name()
    }

    /// Name of the gait, or path of the policy.
    #[getter]
    fn gait(&self) -> &str {
        &self.gait_name
    }

    /// Seed of the start.
    #[getter]
    fn seed(&self) -> u64 {
        self.running().seed
    }

    /// The cameras of observations.
    #[getter]
    fn cameras(&self) -> Vec<Camera> {
        self.cameras.iter().cloned().map(Camera).collect()
    }

    /// True surface in the frame of the object: vertices, metres, float32 (N, 3), and faces, uint32 (M, 3).
    #[getter]
    fn mesh<'py>(&self, py: Python<'py>) -> crate::mesh::MeshArrays<'py> {
        crate::mesh::arrays(py, self.object.mesh.clone())
    }

    /// Seconds since the start.
    #[getter]
    fn time_s(&self) -> f64 {
        self.running().episode.time_s()
    }

    /// Angle turned about the palm's normal in the gait's direction, radians.
    #[getter]
    fn turned_rad(&self) -> f64 {
        self.running().episode.turned_rad()
    }

    /// Reason for the end: completed, dropped, or a sentence; None while the episode runs.
    #[getter]
    fn end(&self) -> Option<String> {
        Some(match self.running().episode.end()? {
            End::Completed => "completed".to_owned(),
            End::Dropped => "dropped".to_owned(),
            End::Stopped => "stopped".to_owned(),
            End::Uncontrolled(reason) | End::Unstable(reason) => reason.clone(),
        })
    }

    /// Joint angles, radians: float64, one per joint.
    #[getter]
    fn joints<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        joints(py, &self.running().episode.simulation().joints())
    }

    /// Joint velocities, rad/s: float64, one per joint.
    #[getter]
    fn joint_velocities<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        joints(py, &self.running().episode.simulation().joint_velocities())
    }

    /// Angles at which the joints aim, radians: float64, one per joint.
    #[getter]
    fn joint_targets<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        joints(py, self.running().episode.target())
    }

    /// True pose of the object in the world: float64 (4, 4).
    #[getter]
    fn object_pose<'py>(&self, py: Python<'py>) -> Bound<'py, PyArrayDyn<f64>> {
        matrix(py, self.running().episode.simulation().object_pose())
    }

    /// Velocity (m/s) and angular velocity (rad/s) of the object in the world: float64 (6,).
    #[getter]
    fn object_velocity<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        let running = self.running();
        let simulation = running.episode.simulation();
        let (linear, angular) = (simulation.object_velocity(), simulation.object_angular_velocity());
        line(py, linear.iter().chain(angular.iter()).copied().collect())
    }

    /// Normal force between object and each gel, newtons: float64, one per pad.
    #[getter]
    fn pad_forces<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        line(py, self.running().episode.simulation().contacts().iter().map(|pad| pad.force_n).collect())
    }

    /// Steps of the physics per second.
    #[classattr]
    fn physics_hz() -> u32 {
        PHYSICS_HZ
    }
}

fn joints<'py>(py: Python<'py>, angles: &[f64]) -> Bound<'py, PyArray1<f64>> {
    line(py, angles.to_vec())
}
