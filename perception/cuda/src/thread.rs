//! Threads that own a GPU and compute for others: memory and libraries of a GPU belong to one thread.

use std::fmt;
use std::rc::Rc;
use std::sync::{Mutex, PoisonError, mpsc};

use mvt_training::backend::{OptimiserState, ResidentTraining, Update};
use mvt_training::mvt_touch::device::Accelerator;
use mvt_training::mvt_touch::network::{Architecture, Weights};
use mvt_training::{LossConfig, TrainError, TrainingBatch};

use crate::gpu::Gpu;
use crate::inference::GpuNetwork;
use crate::machine::{GpuError, Machine};
use crate::training::GpuTraining;

/// Steps that may wait for the thread.
const QUEUED: usize = 2;

/// A piece of work for a thread that owns `T`.
type Work<T> = Box<dyn FnOnce(&mut T) + Send>;

/// A thread that owns `T`.
struct Owner<T> {
    work: Mutex<mpsc::SyncSender<Work<T>>>,
}

impl<T> fmt::Debug for Owner<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Owner").finish_non_exhaustive()
    }
}

fn ended<E>(_: E) -> GpuError {
    GpuError::Unsuitable("its thread ended".to_owned())
}

impl<T: 'static> Owner<T> {
    /// Starts a thread with what `make` returns there.
    fn new(make: impl FnOnce() -> Result<T, GpuError> + Send + 'static) -> Result<Self, GpuError> {
        let (work, received) = mpsc::sync_channel::<Work<T>>(QUEUED);
        let (report, ready) = mpsc::channel();
        let run = move || match make() {
            Ok(mut owned) => {
                drop(report.send(Ok(())));
                received.iter().for_each(|work| work(&mut owned));
            }
            Err(error) => drop(report.send(Err(error))),
        };
        let thread = std::thread::Builder::new().name("gpu".to_owned()).spawn(run);
        thread.map_err(|error| GpuError::Unsuitable(error.to_string()))?;
        ready.recv().map_err(ended)??;
        Ok(Self { work: Mutex::new(work) })
    }

    /// Queues work.
    fn send(&self, work: impl FnOnce(&mut T) + Send + 'static) -> Result<(), GpuError> {
        let sender = self.work.lock().unwrap_or_else(PoisonError::into_inner).clone();
        sender.send(Box::new(work)).map_err(ended)
    }

    /// Waits for the result of work.
    fn ask<R: Send + 'static>(&self, work: impl FnOnce(&mut T) -> R + Send + 'static) -> Result<R, GpuError> {
        let (reply, answer) = mpsc::channel();
        self.send(move |owned| drop(reply.send(work(owned))))?;
        answer.recv().map_err(ended)
    }
}

/// A network on a GPU, for any thread.
#[derive(Debug)]
pub struct NetworkThread(Owner<GpuNetwork>);

impl NetworkThread {
    /// Opens a machine on a thread of its own and copies weights to it.
    ///
    /// # Errors
    /// If the machine cannot be opened or has no memory for the weights.
    pub fn new(
        weights: &Weights,
        open: impl FnOnce() -> Result<Rc<dyn Machine>, GpuError> + Send + 'static,
    ) -> Result<Self, GpuError> {
        let weights = weights.clone();
        Owner::new(move || GpuNetwork::new(Gpu::new(open()?), &weights)).map(Self)
    }
}

impl Accelerator for NetworkThread {
    fn predict(&self, levels: Vec<u8>, shape: [usize; 3]) -> Result<Vec<[f32; 2]>, String> {
        let predicted = self.0.ask(move |network| network.predict(&levels, shape));
        predicted.and_then(|predicted| predicted).map_err(|error| error.to_string())
    }
}

/// A training with the first error of its steps.
struct Steps {
    training: GpuTraining,
    error: Option<GpuError>,
}

/// A training on a GPU, for any thread.
#[derive(Debug)]
pub struct TrainingThread(Owner<Steps>);

impl TrainingThread {
    /// Opens a machine on a thread of its own and copies the state of a training to it.
    ///
    /// # Errors
    /// If the machine cannot be opened or has no memory for the state.
    pub fn new(
        architecture: &Architecture,
        loss: LossConfig,
        state: &OptimiserState,
        open: impl FnOnce() -> Result<Rc<dyn Machine>, GpuError> + Send + 'static,
    ) -> Result<Self, GpuError> {
        let (architecture, state) = (architecture.clone(), state.clone());
        let make = move || {
            let training = GpuTraining::new(Gpu::new(open()?), &architecture, loss, &state)?;
            Ok(Steps { training, error: None })
        };
        Owner::new(make).map(Self)
    }
}

impl From<GpuError> for TrainError {
    fn from(error: GpuError) -> Self {
        Self::Gpu(error.to_string())
    }
}

impl ResidentTraining for TrainingThread {
    fn advance(&mut self, batch: &TrainingBatch, update: &Update) -> Result<(), TrainError> {
        let (batch, update) = (batch.clone(), *update);
        let step = move |steps: &mut Steps| {
            if steps.error.is_none() {
                steps.error = steps.training.advance(&batch, &update).err();
            }
        };
        Ok(self.0.send(step)?)
    }

    fn results(&mut self) -> Result<Vec<[f32; 2]>, TrainError> {
        let take = |steps: &mut Steps| steps.error.take().map_or_else(|| steps.training.results(), Err);
        Ok(self.0.ask(take)??)
    }

    fn read(&self, state: &mut OptimiserState) -> Result<(), TrainError> {
        let read = |steps: &mut Steps| steps.training.read();
        let [weights, average, mean, square] = self.0.ask(read)??;
        *state = OptimiserState { step: state.step, weights, average, mean, square };
        Ok(())
    }
}
