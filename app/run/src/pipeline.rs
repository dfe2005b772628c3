//! One loop for live episodes and logs: sense, estimate, score, direct.
//!
//! The source runs one frame ahead on a thread of its own. What is directed after frame k reaches the episode before it senses frame
//! k + 2, whatever the machine's speed and its number of threads, so that the result is always the same.

mod estimator;
mod scorer;

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, Sender, SyncSender};
use std::thread;
use std::time::Instant;

use anyhow::{Context as _, Result};
use mvt_frames::{Isometry, Model};
use mvt_gaits::directive::Directive;
use mvt_mesh::Mesh;
use mvt_metrics::{POINTS, TrueSurface};
use mvt_objects::object::Object as TrueObject;
use mvt_robot::hand::Side;
use mvt_slam::Estimate;
use mvt_slam::map::Map;
use mvt_touch::contact::ContactConfig;
use serde::{Deserialize, Serialize};

pub use estimator::{Estimator, Given, Init, Mode, random_motion};
pub use scorer::{Scorer, Shape, Snapshot};

use crate::report::{Event, FrameRow, TrackState};
use crate::source::{Sensed, Source};
use crate::supervisor::{Rules, Supervisor};

/// Everything that can be set.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RunConfig {
    /// Noise of camera depth as a multiple of Redwood's model, NeuralFeels' level being 5. Logs that hold true depth are given it when
    /// they are read. 0 for none.
    pub camera_noise: f64,
    /// Edge of the cells of the mesh, millimetres.
    pub mesh_cell_mm: f64,
    /// The shape is meshed and scored at every how many-th frame.
    pub score_every: u64,
    /// What becomes of a touch network's predictions.
    pub touch: ContactConfig,
    /// Estimation.
    pub slam: mvt_slam::Config,
    /// What the hand does on its own accord.
    pub supervisor: Rules,
}

impl Default for RunConfig {
    fn default() -> Self {
        Self {
            camera_noise: 5.0,
            mesh_cell_mm: 1.5,
            score_every: 30,
            touch: ContactConfig::default(),
            slam: mvt_slam::Config::default(),
            supervisor: Rules::default(),
        }
    }
}

impl RunConfig {
    /// Says what cannot be.
    ///
    /// # Errors
    /// A sentence that names the setting.
    pub fn check(&self) -> Result<(), String> {
        let checks = [
            ((0.0..=100.0).contains(&self.camera_noise), "camera_noise must be from 0 to 100"),
            ((0.2..=20.0).contains(&self.mesh_cell_mm), "mesh_cell_mm must be from 0.2 to 20"),
            (self.score_every > 0, "score_every must be at least 1"),
        ];
        match checks.into_iter().find(|(is_right, _)| !is_right) {
            Some((_, wrong)) => Err(wrong.to_owned()),
            None => {
                self.touch.check().map_err(|wrong| format!("touch.{wrong}"))?;
                self.slam.validate().map_err(|error| format!("slam.{error}"))
            }
        }
    }
}

/// What happens in a run, for whoever shows or records it.
pub enum Progress<'a> {
    /// It begins.
    Started {
        /// Frames there will be at most.
        frames: usize,
    },
    /// A frame has been estimated.
    Frame {
        /// What was estimated.
        row: &'a FrameRow,
        /// Whether the map keeps it.
        is_keyframe: bool,
        /// What was sensed, which is not needed any more.
        sensed: Box<Sensed>,
    },
    /// The shape has been meshed.
    Shape(&'a Shape),
    /// Something is amiss, and the run goes on.
    Warning(&'a str),
    /// Something worth telling.
    Event(&'a Event),
}

/// What a run is made of.
pub struct Pipeline<'a> {
    /// Settings.
    pub config: &'a RunConfig,
    /// What is estimated.
    pub mode: Mode,
    /// Where the pose of a given shape starts.
    pub init: Init,
    /// Seed of the estimate.
    pub seed: u64,
    /// Which hand.
    pub side: Side,
    /// The true object, where it is known.
    pub object: Option<&'a TrueObject>,
    /// What an earlier run has learnt, to go on with.
    pub map: Option<Map>,
    /// Directs the hand.
    pub supervisor: Option<Supervisor>,
    /// Everything on the calling thread.
    pub single_threaded: bool,
}

/// What a run has come to.
pub struct Finished {
    /// The surface in the coordinates from which the estimated poses lead; none before anything was seen.
    pub mesh: Option<Mesh>,
    /// What was estimated.
    pub estimator: Estimator,
    /// Wall time from the first frame asked for to the last one estimated, seconds.
    pub wall_s: f64,
    /// Whether it came to its end.
    pub complete: bool,
}

/// How far a source runs ahead, frames.
const AHEAD: usize = 2;

type Frame = Result<Option<Sensed>>;

/// Frames of a source in order, and directives back to it.
enum Feed<'a> {
    Inline { source: &'a mut dyn Source, ahead: VecDeque<Frame>, ended: bool },
    Threaded { frames: Receiver<Frame>, directives: Sender<Directive> },
}

impl Feed<'_> {
    fn next(&mut self) -> Frame {
        match self {
            Self::Inline { source, ahead, ended } => {
                while ahead.len() < AHEAD && !*ended {
                    let frame = source.next();
                    *ended = !matches!(frame, Ok(Some(_)));
                    ahead.push_back(frame);
                }
                ahead.pop_front().unwrap_or(Ok(None))
            }
            Self::Threaded { frames, .. } => frames.recv().unwrap_or(Ok(None)),
        }
    }

    fn direct(&mut self, directive: Directive) -> Result<()> {
        match self {
            Self::Inline { source, .. } => source.direct(directive),
            // Whoever does not listen any more has ended.
            Self::Threaded { directives, .. } => {
                let _ = directives.send(directive);
                Ok(())
            }
        }
    }
}

/// The part of a feed that runs on the source's thread.
fn serve(source: &mut dyn Source, frames: &SyncSender<Frame>, directives: &Receiver<Directive>) {
    for number in 0.. {
        let directed = if number < AHEAD {
            Ok(())
        } else {
            let Ok(directive) = directives.recv() else { return };
            source.direct(directive)
        };
        let frame = directed.and_then(|()| source.next());
        let is_last = !matches!(frame, Ok(Some(_)));
        if frames.send(frame).is_err() || is_last {
            return;
        }
    }
}

/// Meshes and scores snapshots in order.
enum Mesher<'a> {
    Inline { cell_m: f32, truth: Option<&'a TrueSurface>, done: VecDeque<Shape> },
    Threaded { snapshots: Sender<Snapshot>, done: Receiver<Shape> },
}

impl Mesher<'_> {
    fn push(&mut self, snapshot: Snapshot) {
        match self {
            Self::Inline { cell_m, truth, done } => done.push_back(snapshot.shape(*cell_m, *truth)),
            // The thread ends only when this does.
            Self::Threaded { snapshots, .. } => drop(snapshots.send(snapshot)),
        }
    }

    fn poll(&mut self) -> Option<Shape> {
        match self {
            Self::Inline { done, .. } => done.pop_front(),
            Self::Threaded { done, .. } => done.try_recv().ok(),
        }
    }

    /// What is still under way.
    fn finish(self) -> Vec<Shape> {
        match self {
            Self::Inline { done, .. } => done.into(),
            Self::Threaded { snapshots, done } => {
                drop(snapshots);
                done.into_iter().collect()
            }
        }
    }
}

impl Pipeline<'_> {
    /// Runs until the source ends or `stop` is set.
    ///
    /// # Errors
    /// If the source fails, or the mode needs what is not known.
    pub fn run(
        mut self,
        source: &mut dyn Source,
        stop: &AtomicBool,
        listener: &mut dyn FnMut(Progress<'_>),
    ) -> Result<Finished> {
        // Before the clock runs: the truth is no part of the work.
        let truth = self.object.map(|object| TrueSurface::new(&object.mesh, POINTS, 0));
        let given = match self.mode {
            Mode::Pose => Some(Given::new(self.object.context("--mode pose needs the object: give --object")?)?),
            Mode::Slam | Mode::Map => None,
        };
        listener(Progress::Started { frames: source.len() });
        let cell_m = (self.config.mesh_cell_mm * 1e-3) as f32;
        let truth = truth.as_ref();
        let finished = thread::scope(|scope| {
            let (feed, mesher) = if self.single_threaded {
                (
                    Feed::Inline { source: &mut *source, ahead: VecDeque::new(), ended: false },
                    Mesher::Inline { cell_m, truth, done: VecDeque::new() },
                )
            } else {
                let (frame_sender, frames) = mpsc::sync_channel(AHEAD);
                let (directives, directive_receiver) = mpsc::channel();
                let source = &mut *source;
                scope.spawn(move || serve(source, &frame_sender, &directive_receiver));
                let (snapshots, snapshot_receiver) = mpsc::channel::<Snapshot>();
                let (shapes, done) = mpsc::channel();
                scope.spawn(move || {
                    // Until nobody waits for shapes any more.
                    snapshot_receiver.iter().all(|snapshot| shapes.send(snapshot.shape(cell_m, truth)).is_ok())
                });
                (Feed::Threaded { frames, directives }, Mesher::Threaded { snapshots, done })
            };
            self.follow(feed, mesher, given, stop, listener)
        })?;
        if finished.complete {
            let (reason, as_meant) = source.end();
            let time_s = finished.last_s;
            if !as_meant {
                listener(Progress::Event(&Event { time_s, text: reason }));
            }
        }
        let mesh = match (&finished.estimator, self.object) {
            (Some(estimator), object) if estimator.map().is_none() => object.map(|object| object.mesh.clone()),
            _ => finished.mesh,
        };
        let estimator = finished.estimator.context("there was no frame")?;
        Ok(Finished { mesh, estimator, wall_s: finished.wall_s, complete: finished.complete })
    }

    fn follow(
        &mut self,
        mut feed: Feed<'_>,
        mut mesher: Mesher<'_>,
        mut given: Option<Given>,
        stop: &AtomicBool,
        listener: &mut dyn FnMut(Progress<'_>),
    ) -> Result<Followed> {
        let mut scorer = Scorer::new(self.object, self.mode != Mode::Slam);
        let mut estimator: Option<Estimator> = None;
        let mut last: Option<FrameRow> = None;
        let mut complete = false;
        let begun = Instant::now();
        while !stop.load(Ordering::Relaxed) {
            let Some(sensed) = feed.next()? else {
                complete = true;
                break;
            };
            let Sensed { frame, truth, sense_ms, .. } = sensed;
            sensed.warnings.iter().for_each(|warning| listener(Progress::Warning(warning)));
            let unknown =
                "where the object is at the first frame is not known; there are --mode slam and --init search";
            let known = match &mut estimator {
                Some(known) => known,
                None => estimator.insert(match (given.take(), self.map.take()) {
                    (Some(given), _) => {
                        let start = match self.init {
                            Init::Search => None,
                            init => init.start(truth.context(unknown)?, self.seed),
                        };
                        Estimator::with_shape(&self.config.slam, self.side, self.seed, given, start)
                    }
                    (None, Some(map)) => Estimator::resume(&self.config.slam, self.side, self.seed, map)?,
                    (None, None) => Estimator::new(&self.config.slam, self.side, self.seed)?,
                }),
            };
            let given_pose = match self.mode {
                Mode::Map => {
                    let Some(truth) = truth else {
                        listener(Progress::Warning(&format!("frame {frame} has no true pose and is left out")));
                        feed.direct(Directive::Continue)?;
                        continue;
                    };
                    Some(Isometry::<Model, _>::new(truth.untyped()))
                }
                Mode::Slam | Mode::Pose => None,
            };
            let estimate = known.step(&sensed.depth, given_pose);
            feed.direct(self.decide(known, &estimate, listener))?;
            let row = scorer.row(frame, &estimate, truth, sense_ms);
            tell_changes(last.as_ref(), &row, &estimate, listener);
            listener(Progress::Frame { row: &row, is_keyframe: estimate.keyframe, sensed: Box::new(sensed) });
            if let Some(map) =
                known.map().filter(|_| (estimate.frame as u64 + 1).is_multiple_of(self.config.score_every))
            {
                mesher.push(Snapshot::new(map, &row, scorer.gauge()));
            }
            while let Some(shape) = mesher.poll() {
                listener(Progress::Shape(&shape));
            }
            last = Some(row);
        }
        let wall_s = begun.elapsed().as_secs_f64();
        // The source's thread waits for a directive or for room; without this end it stops.
        drop(feed);
        let map = estimator.as_ref().and_then(Estimator::map).filter(|map| !map.keyframes().is_empty());
        if let Some((map, row)) = map.zip(last.as_ref()) {
            mesher.push(Snapshot::new(map, row, scorer.gauge()));
        }
        let mut mesh = None;
        for shape in mesher.finish() {
            listener(Progress::Shape(&shape));
            mesh = Some(shape.mesh);
        }
        Ok(Followed { mesh, estimator, wall_s, complete, last_s: last.map_or(0.0, |row| row.time_s) })
    }

    /// What the hand is to do, from what is believed alone.
    fn decide(
        &mut self,
        estimator: &Estimator,
        estimate: &Estimate,
        listener: &mut dyn FnMut(Progress<'_>),
    ) -> Directive {
        let Some(supervisor) = &mut self.supervisor else { return Directive::Continue };
        let directive = supervisor.decide(&estimator.belief(estimate));
        let text = match &directive {
            Directive::Continue | Directive::Recentre { .. } => return directive,
            Directive::SwitchGait(name) => format!("goes over to gait {name}"),
            Directive::Regrasp => "re-grasps".to_owned(),
            Directive::Stop => "the goal is reached".to_owned(),
        };
        listener(Progress::Event(&Event { time_s: estimate.time_s, text }));
        directive
    }
}

struct Followed {
    mesh: Option<Mesh>,
    estimator: Option<Estimator>,
    wall_s: f64,
    complete: bool,
    last_s: f64,
}

fn tell_changes(
    before: Option<&FrameRow>,
    row: &FrameRow,
    estimate: &Estimate,
    listener: &mut dyn FnMut(Progress<'_>),
) {
    let mut tell = |text: &str| listener(Progress::Event(&Event { time_s: row.time_s, text: text.to_owned() }));
    if estimate.loop_closed {
        tell("closed a loop: the shape has come round");
    }
    let before = before.map_or(TrackState::Tracking, |row| row.state);
    match (before, row.state) {
        (TrackState::Tracking | TrackState::Relocalised, TrackState::Lost) => tell("lost the object"),
        (_, TrackState::Relocalised) => tell("found the object again"),
        _ => {}
    }
}

#[cfg(test)]
mod tests;
