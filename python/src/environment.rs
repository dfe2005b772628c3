//! Environments for reinforcement learning. Gymnasium's classes stand in `mambavitact/gym.py`.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use mvt_environment::{Environments as Many, Readings, Reward, Scene, Sense, TurnSettings};
use mvt_physics::episode::Randomisation;
use mvt_run::object::load_object;
use numpy::{PyArray1, PyArrayDyn};
use pyo3::prelude::*;

use crate::arrays::{line, pixels, shaped, singles};
use crate::camera::{around, read_rig};
use crate::errors::{Kind, argument, detached, general, warn};

/// Environments that step together on all cores: the base of the classes of `mambavitact.gym`.
#[pyclass(frozen, module = "mambavitact")]
pub struct Environments {
    senses: Vec<(Sense, Vec<usize>)>,
    count: usize,
    /// Joints of the hand.
    joints: usize,
    environments: Mutex<Many>,
}

/// Observations, rewards, whether each was terminated and truncated, parts of the rewards, times (s) and angles (rad).
type StepOutcome<'py> = (
    Vec<Bound<'py, PyAny>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<bool>>,
    Bound<'py, PyArray1<bool>>,
    Bound<'py, PyArrayDyn<f64>>,
    Bound<'py, PyArrayDyn<f64>>,
);

impl Environments {
    /// Raises the warnings of perception as Python's.
    fn warn(&self, py: Python<'_>) -> PyResult<()> {
        warn(py, self.environments().take_warnings())
    }

    fn environments(&self) -> MutexGuard<'_, Many> {
        self.environments.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns observations as arrays, without a copy.
    fn arrays<'py>(&self, py: Python<'py>, observations: Vec<Readings>) -> Vec<Bound<'py, PyAny>> {
        let arrays = observations.into_iter().zip(&self.senses).map(|(readings, (_, shape))| {
            let shape = [&[self.count], shape.as_slice()].concat();
            match readings {
                Readings::Numbers(values) => shaped(py, values, &shape).into_any(),
                Readings::Bytes(values) => shaped(py, values, &shape).into_any(),
            }
        });
        arrays.collect()
    }
}

#[pymethods]
impl Environments {
    #[new]
    #[pyo3(signature = (object, count, senses, *, rig, side, control_hz, physics_hz, duration_s, cameras, randomise, autoreset))]
    fn new(
        py: Python<'_>,
        object: &str,
        count: usize,
        senses: Vec<String>,
        rig: &str,
        side: Option<&str>,
        control_hz: u32,
        physics_hz: u32,
        duration_s: f64,
        cameras: &str,
        randomise: bool,
        autoreset: bool,
    ) -> PyResult<Self> {
        let rig = read_rig(py, rig, side)?;
        let cameras = around(cameras, &rig)?;
        let hand = rig.hand;
        let senses =
            senses.iter().map(|name| name.parse::<Sense>().map_err(argument)).collect::<Result<Vec<_>, _>>()?;
        let randomisation = if randomise { Randomisation::default() } else { Randomisation::none() };
        let settings = TurnSettings {
            hand,
            control_hz,
            physics_hz,
            duration_s,
            randomisation,
            senses: senses.clone(),
            cameras,
            ..TurnSettings::default()
        };
        let joints = settings.hand.joints().len();
        detached(py, || {
            let object = load_object(object).map_err(argument)?;
            let scene = Arc::new(Scene::new(object, settings).map_err(argument)?);
            let senses = senses.iter().map(|&sense| (sense, scene.shape(sense))).collect();
            let environments = Many::new(scene, count, autoreset).map_err(argument)?;
            Ok(Self { senses, count, joints, environments: Mutex::new(environments) })
        })
    }

    /// Names of the parts of a reward.
    #[classattr]
    fn reward_names() -> Vec<&'static str> {
        Reward::NAMES.to_vec()
    }

    /// Number of joints of the hand.
    #[getter]
    fn joints(&self) -> usize {
        self.joints
    }

    /// Name, shape, dtype, least and greatest value of each observation.
    #[getter]
    fn spaces(&self) -> Vec<(&'static str, Vec<usize>, &'static str, f32, f32)> {
        let space = |(sense, shape): &(Sense, Vec<usize>)| {
            let [low, high] = sense.bounds();
            (sense.name(), shape.clone(), if sense.is_bytes() { "uint8" } else { "float32" }, low, high)
        };
        self.senses.iter().map(space).collect()
    }

    /// Starts new episodes with these seeds and returns the first observations.
    fn reset<'py>(&self, py: Python<'py>, seeds: Vec<u64>) -> PyResult<Vec<Bound<'py, PyAny>>> {
        let observations = detached(py, || self.environments().reset(&seeds).map_err(argument))?;
        self.warn(py)?;
        Ok(self.arrays(py, observations))
    }

    /// Steps all environments with actions (count, J), one for each joint. Returns observations, rewards, terminated, truncated, parts of the rewards, and time (s)
    /// with angle turned (rad).
    fn step<'py>(&self, py: Python<'py>, actions: &Bound<'_, PyAny>) -> PyResult<StepOutcome<'py>> {
        let actions = singles(actions, "actions", &[Some(self.count), Some(self.joints)])?;
        let actions: Vec<f32> = actions.into_iter().collect();
        let outcome = detached(py, || self.environments().step(&actions).map_err(general))?;
        self.warn(py)?;
        let rewards = outcome.rewards.iter().map(Reward::total).collect();
        let parts = outcome.rewards.iter().flat_map(Reward::parts).collect();
        Ok((
            self.arrays(py, outcome.observations),
            line(py, rewards),
            line(py, outcome.terminated),
            line(py, outcome.truncated),
            shaped(py, parts, &[self.count, Reward::NAMES.len()]),
            shaped(py, outcome.progress.concat(), &[self.count, 2]),
        ))
    }

    /// Returns a picture of an environment: uint8 (480, 640, 3).
    fn picture<'py>(&self, py: Python<'py>, index: usize) -> PyResult<Bound<'py, PyArrayDyn<u8>>> {
        let picture = detached(py, || Ok(self.environments().picture(index)))?;
        let picture = picture.ok_or_else(|| {
            Kind::Argument
                .error(format!("index: expected less than {}, the number of environments, got {index}", self.count))
        })?;
        Ok(pixels(py, picture))
    }

    /// Steps with actions (steps, count, J) without Python between the steps, and returns the seconds that it took: a measure of what Python
    /// costs.
    fn time_steps(&self, py: Python<'_>, actions: &Bound<'_, PyAny>) -> PyResult<f64> {
        let actions = singles(actions, "actions", &[None, Some(self.count), Some(self.joints)])?;
        let (steps, actions): (usize, Vec<f32>) = (actions.shape()[0], actions.into_iter().collect());
        detached(py, || {
            let begun = std::time::Instant::now();
            let mut environments = self.environments();
            for actions in actions.chunks(actions.len() / steps.max(1)) {
                environments.step(actions).map_err(general)?;
            }
            Ok(begun.elapsed().as_secs_f64())
        })
    }
}
