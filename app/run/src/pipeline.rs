//! One loop for simulated episodes and logs: sense, estimate, score, direct.
//!
//! The source runs one frame ahead on a thread of its own. A directive after frame k reaches the episode before it senses frame
//! k + 2, whatever the machine's speed and its number of threads, so that the result is always the same.

mod scorer;

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, Sender, SyncSender};
use std::thread;
use std::time::Instant;

use anyhow::{Context as _, Result};
use mvt_calibration::Calibration;
use mvt_frames::{Isometry, Model};
use mvt_gaits::directive::Directive;
use mvt_gaits::feedback::EstimatedPlace;
use mvt_mesh::Mesh;
use mvt_objects::object::Object as TrueObject;
use mvt_robot::hand::Hand;
use mvt_robot::observation::Percept;
use mvt_segmentation::CarriedMask;
use mvt_slam::Estimate;
use mvt_slam::map::{BoxChange, Map};
use mvt_slam::scan::Scan;

pub use scorer::{MeshedShape, Scorer, ShapeSnapshot};

use crate::carrier::LabelCarrier;
use crate::estimator::{Estimator, Given, Init, Mode};
use crate::explorer::{ExplorerChoice, Outlook};
use crate::input::Input;
use crate::report::{Event, FrameRow, TrackState};
use crate::source::{Modality, Sensed, Source};
use crate::supervisor::Supervisor;
use crate::truth::Truth;

/// Progress of a run, for listeners.
pub enum Progress<'a> {
    /// The run begins.
    Started {
        /// Frames there will be at most.
        frames: usize,
    },
    /// All estimators have taken a frame.
    Frame {
        /// The results, in the order of the estimators. One that left the frame out has none.
        results: &'a [Option<FrameResult>],
        /// The frame, which is not needed any more.
        sensed: Box<Sensed>,
    },
    /// The shape of an estimator, by its index, has been meshed.
    Shape(usize, &'a MeshedShape),
    /// A problem; the run goes on.
    Warning(&'a str),
    /// Something that is worth showing.
    Event(&'a Event),
    /// The explorer has chosen the hand's next action.
    Choice(&'a ExplorerChoice),
}

/// The result of an estimator on a frame.
pub struct FrameResult {
    /// The record of the frame.
    pub row: FrameRow,
    /// The estimate.
    pub estimate: Estimate,
    /// The rays on which it stands.
    pub scan: Arc<Scan>,
}

/// How an estimator of a run is set up.
pub struct EstimatorSetup<'a> {
    /// Settings.
    pub config: &'a mvt_slam::SlamConfig,
    /// The estimated quantities.
    pub mode: Mode,
    /// Which sensors are used.
    pub modality: Modality,
    /// Where the pose of a given shape starts.
    pub init: Init,
    /// Seed of the estimate.
    pub seed: u64,
    /// The map of an earlier run, which is continued.
    pub map: Option<Map>,
}

/// When shapes are meshed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Meshing {
    /// Edge of the cells, metres.
    pub cell_m: f32,
    /// Every Nth frame; `None` for the last frame alone.
    pub every: Option<u64>,
}

/// One loop for every run: a source, any number of estimators on its frames, and a supervisor that acts on the first of them.
pub struct Pipeline<'a> {
    /// The estimators.
    pub estimators: Vec<EstimatorSetup<'a>>,
    /// When shapes are meshed.
    pub meshing: Meshing,
    /// The true object, where it is known.
    pub object: Option<&'a TrueObject>,
    /// The true surface, against which frames and shapes are scored while the run goes on.
    pub truth: Option<&'a Truth>,
    /// Directs the hand.
    pub supervisor: Option<Supervisor>,
    /// Whether everything runs on the calling thread.
    pub single_threaded: bool,
}

/// The end of a run.
pub struct Finished {
    /// The estimators with their shapes, in order. One that never received a frame is `None`.
    pub estimators: Vec<Option<Estimated>>,
    /// Wall time from the first frame asked for to the last one estimated, seconds.
    pub wall_s: f64,
    /// Whether the source came to its end.
    pub complete: bool,
    /// Why the source ended, in words; empty if it did not.
    pub end: String,
    /// The refined calibration; `None` if it was taken as given.
    pub calibration: Option<Calibration>,
}

/// An estimator at the end of a run.
pub struct Estimated {
    /// The estimator.
    pub estimator: Estimator,
    /// The surface in the coordinates from which the estimated poses lead; `None` before anything was seen.
    pub mesh: Option<Mesh>,
}

/// How far a source runs ahead, frames.
const AHEAD: usize = 2;

type Frame = Result<Option<Sensed>>;

/// The answer to the source after a frame.
#[derive(Debug, Clone, PartialEq)]
struct Order {
    directive: Directive,
    /// Estimated place of the object, where the source needs it and it is known.
    place: Option<EstimatedPlace>,
}

impl Order {
    fn give(self, source: &mut dyn Source) -> Result<()> {
        if let Some(place) = self.place {
            source.see(place);
        }
        source.direct(self.directive)
    }
}

/// Frames of a source in order, and directives back to it.
enum Feed<'a> {
    Inline { source: &'a mut dyn Source, ahead: VecDeque<Frame>, ended: bool },
    Threaded { frames: Receiver<Frame>, directives: Sender<Order> },
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

    fn order(&mut self, order: Order) -> Result<()> {
        match self {
            Self::Inline { source, .. } => order.give(*source),
            // A source that has ended takes no directives.
            Self::Threaded { directives, .. } => {
                let _ = directives.send(order);
                Ok(())
            }
        }
    }
}

/// The part of a feed that runs on the source's thread.
fn serve(source: &mut dyn Source, frames: &SyncSender<Frame>, directives: &Receiver<Order>) {
    for number in 0.. {
        let directed = if number < AHEAD {
            Ok(())
        } else {
            let Ok(order) = directives.recv() else { return };
            order.give(source)
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
    Inline { cell_m: f32, truth: Option<&'a Truth>, done: VecDeque<(usize, MeshedShape)> },
    Threaded { snapshots: Sender<(usize, ShapeSnapshot)>, done: Receiver<(usize, MeshedShape)> },
}

impl Mesher<'_> {
    fn push(&mut self, estimator: usize, snapshot: ShapeSnapshot) {
        match self {
            Self::Inline { cell_m, truth, done } => done.push_back((estimator, snapshot.shape(*cell_m, *truth))),
            // The thread ends only when this does.
            Self::Threaded { snapshots, .. } => drop(snapshots.send((estimator, snapshot))),
        }
    }

    fn poll(&mut self) -> Option<(usize, MeshedShape)> {
        match self {
            Self::Inline { done, .. } => done.pop_front(),
            Self::Threaded { done, .. } => done.try_recv().ok(),
        }
    }

    /// The shapes that are still under way.
    fn finish(self) -> Vec<(usize, MeshedShape)> {
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
    /// If the source fails, a setting is out of range, or a mode needs the object or its pose and it is unknown.
    pub fn run(
        mut self,
        source: &mut dyn Source,
        stop: &AtomicBool,
        listener: &mut dyn FnMut(Progress<'_>),
    ) -> Result<Finished> {
        let (object, truth, cell_m) = (self.object, self.truth, self.meshing.cell_m);
        let (hand, needs_place) = (Arc::clone(source.hand()), source.needs_place());
        let runners =
            self.estimators.drain(..).map(|entry| Runner::new(entry, object, truth)).collect::<Result<Vec<_>>>()?;
        listener(Progress::Started { frames: source.frame_count() });
        let carrier = source.carries_masks().map(LabelCarrier::new);
        let mut finished = thread::scope(|scope| {
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
                let (snapshots, snapshot_receiver) = mpsc::channel::<(usize, ShapeSnapshot)>();
                let (shapes, done) = mpsc::channel();
                scope.spawn(move || {
                    // Ends when the receiver is gone.
                    let mut meshed = snapshot_receiver.iter().map(|(k, snapshot)| (k, snapshot.shape(cell_m, truth)));
                    meshed.all(|shape| shapes.send(shape).is_ok())
                });
                (Feed::Threaded { frames, directives }, Mesher::Threaded { snapshots, done })
            };
            self.follow(feed, mesher, runners, carrier, (&hand, needs_place), stop, listener)
        })?;
        if finished.complete {
            let (reason, as_meant) = source.end();
            finished.end.clone_from(&reason);
            // How an object was held in the air is worth an event, too.
            if !as_meant || needs_place {
                listener(Progress::Event(&Event { time_s: finished.last_s, text: reason }));
            }
        }
        for known in finished.estimators.iter_mut().flatten() {
            if known.estimator.map().is_none() {
                known.mesh = object.map(|object| object.mesh.clone());
            }
        }
        let Followed { estimators, wall_s, complete, end, .. } = finished;
        Ok(Finished { estimators, wall_s, complete, end, calibration: source.calibration() })
    }

    fn follow(
        &mut self,
        mut feed: Feed<'_>,
        mut mesher: Mesher<'_>,
        mut runners: Vec<Runner<'_>>,
        mut carrier: Option<LabelCarrier>,
        (hand, needs_place): (&Arc<Hand>, bool),
        stop: &AtomicBool,
        listener: &mut dyn FnMut(Progress<'_>),
    ) -> Result<Followed> {
        let mut complete = false;
        let begun = Instant::now();
        while !stop.load(Ordering::Relaxed) {
            let Some(mut sensed) = feed.next()? else {
                complete = true;
                break;
            };
            sensed.warnings.iter().for_each(|warning| listener(Progress::Warning(warning)));
            for text in &sensed.events {
                listener(Progress::Event(&Event { time_s: sensed.percept.time_s, text: text.clone() }));
            }
            if let (Some(carrier), Some(carried)) = (&mut carrier, &mut sensed.carried) {
                *carried =
                    carrier.carry(&mut sensed.percept, runners.first().and_then(Runner::estimator)).unwrap_or_default();
            }
            let input = Input::new(hand, &sensed.percept);
            let mut scans = Vec::new();
            let mut results = Vec::with_capacity(runners.len());
            for runner in &mut runners {
                results.push(runner.step(&sensed, &input, hand, &mut scans, listener)?);
            }
            if let (Some(carrier), Some(Some(result))) = (&mut carrier, results.first()) {
                carrier.learn(&sensed.percept, &result.estimate, sensed.carried.is_none());
                // A region that the estimate does not recognise was a guess.
                sensed.carried = sensed.carried.take().map(|carried| match result.estimate.state.is_tracking() {
                    true => carried,
                    false => CarriedMask::default(),
                });
            }
            let acting = runners.first().and_then(Runner::estimator).zip(results.first().and_then(Option::as_ref));
            let directive = match acting {
                Some((estimator, result)) => self.decide(estimator, &result.estimate, &sensed.percept, hand, listener),
                None => Directive::Continue,
            };
            let place =
                acting.filter(|_| needs_place).and_then(|(estimator, result)| estimator.place(&result.estimate));
            feed.order(Order { directive, place })?;
            if let (Some(runner), Some(result)) = (runners.first(), results.first().and_then(Option::as_ref)) {
                tell_changes(runner.last.as_ref(), &result.row, &result.estimate, listener);
            }
            for (runner, result) in runners.iter_mut().zip(&results) {
                runner.last = result.as_ref().map(|result| result.row).or(runner.last);
            }
            listener(Progress::Frame { results: &results, sensed: Box::new(sensed) });
            for (k, (runner, result)) in runners.iter().zip(&results).enumerate() {
                let is_due = |result: &FrameResult| {
                    self.meshing.every.is_some_and(|every| (result.estimate.frame as u64 + 1).is_multiple_of(every))
                };
                let map = runner.estimator().and_then(Estimator::map);
                if let Some((map, result)) = map.zip(result.as_ref().filter(|result| is_due(result))) {
                    mesher.push(k, ShapeSnapshot::new(map, &result.row, runner.scorer.gauge()));
                }
            }
            while let Some((k, shape)) = mesher.poll() {
                listener(Progress::Shape(k, &shape));
            }
        }
        let wall_s = begun.elapsed().as_secs_f64();
        // The source's thread waits for a directive or for room; without this end it stops.
        drop(feed);
        for (k, runner) in runners.iter().enumerate() {
            let map = runner.estimator().and_then(Estimator::map).filter(|map| !map.keyframes().is_empty());
            if let Some((map, row)) = map.zip(runner.last.as_ref()) {
                mesher.push(k, ShapeSnapshot::new(map, row, runner.scorer.gauge()));
            }
        }
        let mut meshes: Vec<Option<Mesh>> = runners.iter().map(|_| None).collect();
        for (k, shape) in mesher.finish() {
            listener(Progress::Shape(k, &shape));
            if let Some(mesh) = meshes.get_mut(k) {
                *mesh = Some(shape.mesh);
            }
        }
        let last_s = runners.first().and_then(|runner| runner.last).map_or(0.0, |row| row.time_s);
        let estimators = runners.into_iter().zip(meshes);
        let estimators =
            estimators.map(|(runner, mesh)| Some(Estimated { estimator: runner.started()?, mesh })).collect();
        Ok(Followed { estimators, wall_s, complete, end: String::new(), last_s })
    }

    /// The directive of the supervisor, from the estimate alone.
    fn decide(
        &mut self,
        estimator: &Estimator,
        estimate: &Estimate,
        percept: &Percept,
        hand: &Hand,
        listener: &mut dyn FnMut(Progress<'_>),
    ) -> Directive {
        let Some(supervisor) = &mut self.supervisor else { return Directive::Continue };
        let outlook = estimator.map().map(|map| Outlook::new(map, estimate.pose, percept, hand));
        let directive = supervisor.decide_seeing(&estimator.belief(estimate), outlook.as_ref());
        let choice = supervisor.take_choice();
        let text = match &directive {
            Directive::Continue | Directive::Recentre { .. } | Directive::Hold => return directive,
            Directive::SwitchGait(name) => format!("switches to gait {name}"),
            Directive::ChangeController(name) => format!("changes to controller {name}"),
            Directive::Regrasp => "re-grasps".to_owned(),
            Directive::Stop if choice.is_some() => "nothing is left that a controller would show".to_owned(),
            Directive::Stop => "the goal is reached".to_owned(),
        };
        let text = match &choice {
            Some(choice) => {
                listener(Progress::Choice(choice));
                format!("{text}{choice}")
            }
            None => text,
        };
        listener(Progress::Event(&Event { time_s: estimate.time_s, text }));
        directive
    }
}

struct Followed {
    estimators: Vec<Option<Estimated>>,
    wall_s: f64,
    complete: bool,
    end: String,
    last_s: f64,
}

/// An entry under way.
struct Runner<'a> {
    state: RunnerState<'a>,
    mode: Mode,
    modality: Modality,
    scorer: Scorer<'a>,
    last: Option<FrameRow>,
}

/// The first frame, with the true pose where it is known, makes an estimator of an entry.
enum RunnerState<'a> {
    Waiting(Option<Box<(EstimatorSetup<'a>, Option<Given>)>>),
    Started(Box<Estimator>, &'a mvt_slam::scan::ScanConfig, u64),
}

/// A scan that estimators of the same settings, seed and number of frames share.
type Shared<'a> = ((&'a mvt_slam::scan::ScanConfig, u64, usize, Modality), Arc<Scan>);

impl<'a> Runner<'a> {
    fn new(entry: EstimatorSetup<'a>, object: Option<&TrueObject>, truth: Option<&'a Truth>) -> Result<Self> {
        let given = match entry.mode {
            Mode::Pose => Some(Given::new(object.context("--mode pose needs the object: give --object")?)?),
            Mode::Slam | Mode::Map => None,
        };
        let scorer = Scorer::new(truth, entry.mode != Mode::Slam);
        let (mode, modality) = (entry.mode, entry.modality);
        Ok(Self { state: RunnerState::Waiting(Some(Box::new((entry, given)))), mode, modality, scorer, last: None })
    }

    fn estimator(&self) -> Option<&Estimator> {
        match &self.state {
            RunnerState::Started(estimator, ..) => Some(estimator),
            RunnerState::Waiting(_) => None,
        }
    }

    fn started(self) -> Option<Estimator> {
        match self.state {
            RunnerState::Started(estimator, ..) => Some(*estimator),
            RunnerState::Waiting(_) => None,
        }
    }

    fn step(
        &mut self,
        sensed: &Sensed,
        input: &Input,
        hand: &Arc<Hand>,
        scans: &mut Vec<Shared<'a>>,
        listener: &mut dyn FnMut(Progress<'_>),
    ) -> Result<Option<FrameResult>> {
        const UNKNOWN: &str =
            "the true pose at the first frame is unknown: use --mode slam, or --init search with --mode pose";
        let truth = sensed.truth;
        if let RunnerState::Waiting(waiting) = &mut self.state
            && let Some(waiting) = waiting.take()
        {
            let (EstimatorSetup { config, init, seed, map, .. }, given) = *waiting;
            let estimator = match (given, map) {
                (Some(given), _) => {
                    let start = match init {
                        Init::Search => None,
                        init => init.start(truth.context(UNKNOWN)?, seed),
                    };
                    Estimator::with_shape(config, hand, seed, given, start)?
                }
                (None, Some(map)) => Estimator::resume(config, hand, seed, map)?,
                (None, None) => Estimator::new(config, hand, seed)?,
            };
            self.state = RunnerState::Started(Box::new(estimator), &config.scan, seed);
        }
        let RunnerState::Started(estimator, scan_config, seed) = &mut self.state else { return Ok(None) };
        let given_pose = match self.mode {
            Mode::Map => {
                let Some(truth) = truth else {
                    let text = format!("frame {} has no true pose and is left out", sensed.frame);
                    listener(Progress::Warning(&text));
                    return Ok(None);
                };
                Some(Isometry::<Model, _>::new(truth.untyped()))
            }
            Mode::Slam | Mode::Pose => None,
        };
        let begun = Instant::now();
        let key = (*scan_config, *seed, estimator.frames(), self.modality);
        let scan = match scans.iter().find(|(other, _)| *other == key) {
            Some((_, scan)) => Arc::clone(scan),
            None => {
                let scan = estimator.scan(&input.measured(&sensed.percept, self.modality));
                scans.push((key, Arc::clone(&scan)));
                scan
            }
        };
        let drawn = begun.elapsed();
        let mut estimate = estimator.step(&scan, given_pose);
        estimate.spent.track += drawn;
        let row = self.scorer.row(sensed.frame, &estimate, truth, sensed.sense_ms);
        Ok(Some(FrameResult { row, estimate, scan }))
    }
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
    match estimate.box_change {
        Some(BoxChange::Grown(half_m)) => tell(&format!("the box around the object grew to {:.0} mm", 2e3 * half_m)),
        Some(BoxChange::TooSmall) => tell("the object is larger than the largest box: the part beyond is not mapped"),
        None => {}
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
