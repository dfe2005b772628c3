//! What a run publishes: pose with covariance, transform, mesh, contacts and diagnostics.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use mvt_frames::{Isometry, Model, World};
use mvt_mesh::Mesh;
use mvt_robot::hand::Hand;
use mvt_robot::observation::Percept;
use mvt_run::live::LiveListener;
use mvt_run::pipeline::{FrameResult, MeshedShape, Progress};
use mvt_run::report::{Deviation, LiveLatency, LiveRecord, TrackState};

use crate::bus::{Bus, Delivery, Outlet};
use crate::contacts::contacts;
use crate::error::LiveError;
use crate::outgoing::{self, DiagnosticLevel, OutgoingHeader};
use crate::setup::PublishSetup;
use crate::source::Link;

/// How often diagnostics are published.
const DIAGNOSTICS_EVERY: Duration = Duration::from_secs(1);
/// Pause between the pieces of a mesh: receivers with small buffers lose pieces that come at once.
const PIECE_PAUSE: Duration = Duration::from_millis(2);
/// Frames that are older than this have stamps of another clock, milliseconds: the pipeline never holds one so long.
const OLDEST_MS: f64 = 60_000.0;
/// Messages that wait for slow receivers: a mesh of 50,000 triangles in pieces.
const WAITING: usize = 64;

/// Publishes the results of a run as they come.
pub struct RosPublisher {
    link: Arc<Link>,
    setup: PublishSetup,
    pose: Outlet,
    transforms: Option<Outlet>,
    /// Points of contact, and the hand that feels them; `None` without touch sensors.
    contacts: Option<(Outlet, Arc<Hand>)>,
    diagnostics: Outlet,
    /// Meshes on their way to the thread that sends them; `None` without.
    meshes: Option<(SyncSender<MeshMessage>, JoinHandle<()>)>,
    mesh_sent: Option<Instant>,
    told: Option<Instant>,
    latencies_ms: Vec<f64>,
}

/// A mesh with time and frame.
struct MeshMessage {
    stamp_ns: i64,
    frame: String,
    triangles: Vec<[[f64; 3]; 3]>,
}

/// Returns pose and variances in the frame that is published; `None` while the object is lost.
pub(crate) fn published(
    pose: Isometry<Model, World>,
    deviation: Option<Deviation>,
    frame_from_world: &nalgebra::Isometry3<f64>,
) -> Option<(nalgebra::Isometry3<f64>, [f64; 2])> {
    let deviation = deviation?;
    Some((frame_from_world * pose.untyped(), [deviation.surface_m.powi(2), deviation.angle_rad.powi(2)]))
}

fn triangles(mesh: &Mesh) -> Vec<[[f64; 3]; 3]> {
    mesh.triangles().map(|corners| corners.map(|corner| corner.to_array().map(f64::from))).collect()
}

/// Sends meshes until there are no more.
fn send_meshes(outlet: &Outlet, meshes: &Receiver<MeshMessage>) {
    let mut pieces = 0;
    for MeshMessage { stamp_ns, frame, triangles } in meshes {
        let markers = outgoing::markers(OutgoingHeader { stamp_ns, frame: &frame }, &triangles, pieces);
        pieces = triangles.len().div_ceil(outgoing::MOST_TRIANGLES);
        for marker in markers {
            outlet.send(marker);
            std::thread::sleep(PIECE_PAUSE);
        }
    }
}

impl RosPublisher {
    /// Announces the topics. Points of contact are published for a hand that has touch sensors.
    ///
    /// # Errors
    /// [`LiveError`] if the network cannot be used.
    pub(crate) fn announce(
        bus: &Bus,
        setup: &PublishSetup,
        hand: &Arc<Hand>,
        link: Arc<Link>,
    ) -> Result<Self, LiveError> {
        let delivery = |latched, depth| Delivery { reliable: true, latched, depth };
        let name = |last: &str| format!("{}/{last}", setup.prefix);
        let transforms =
            setup.transforms.then(|| bus.speak("/tf", outgoing::TRANSFORMS, delivery(false, WAITING))).transpose()?;
        let meshes = match setup.mesh_hz > 0.0 {
            true => {
                let outlet = bus.speak(&name("mesh"), outgoing::MARKER, delivery(false, WAITING))?;
                let (sender, receiver) = sync_channel(1);
                Some((sender, std::thread::spawn(move || send_meshes(&outlet, &receiver))))
            }
            false => None,
        };
        let contacts = match hand.pads().is_empty() {
            true => None,
            false => {
                Some((bus.speak(&name("contacts"), outgoing::POINTS, delivery(false, WAITING))?, Arc::clone(hand)))
            }
        };
        Ok(Self {
            contacts,
            pose: bus.speak(&name("pose"), outgoing::POSE, delivery(false, WAITING))?,
            transforms,
            diagnostics: bus.speak("/diagnostics", outgoing::DIAGNOSTICS, delivery(false, WAITING))?,
            meshes,
            link,
            setup: setup.clone(),
            mesh_sent: None,
            told: None,
            latencies_ms: Vec::new(),
        })
    }

    fn frame(&mut self, number: u64, percept: &Percept, result: &FrameResult) {
        let (frame, stamp_ns, published, frame_from_world) = {
            let place = self.link.place();
            let Some(stamp_ns) = place.stamp_ns(number) else { return };
            let estimate = &result.estimate;
            let published = published(estimate.pose, estimate.deviation, &place.frame_from_world);
            (place.frame.clone(), stamp_ns, published, place.frame_from_world)
        };
        if let Some(driver) = self.link.driver.get() {
            driver.motion().estimated(stamp_ns, result.row.time_s, result.row.state == TrackState::Lost);
        }
        let header = OutgoingHeader { stamp_ns, frame: &frame };
        if let Some((pose, variances)) = published {
            self.pose.send(outgoing::pose(header, &pose, variances));
            if let Some(transforms) = &self.transforms {
                transforms.send(outgoing::transform(header, &self.setup.object_frame, &pose));
            }
        }
        if let Some((outlet, hand)) = &self.contacts {
            outlet.send(outgoing::points(header, &contacts(hand, percept, &frame_from_world)));
        }
        let now_ns = self.link.clock.now_ns();
        let age_ms = now_ns.saturating_sub(stamp_ns) as f64 * 1e-6;
        // With another clock the age is unknown.
        if (0.0..OLDEST_MS).contains(&age_ms) {
            self.latencies_ms.push(age_ms);
        }
        if self.told.is_none_or(|told| told.elapsed() >= DIAGNOSTICS_EVERY) {
            self.told = Some(Instant::now());
            let latency_ms = LiveLatency::of(self.latencies_ms.clone());
            let record = {
                let mut record = self.link.record();
                record.latency_ms = latency_ms;
                record.clone()
            };
            let (level, message) = judged(result.row.state, result.row.confidence);
            let values = values(result, &record, age_ms);
            let header = OutgoingHeader { stamp_ns: now_ns, frame: "" };
            self.diagnostics.send(outgoing::diagnostics(header, level, ["mambavitact", message, ""], &values));
        }
    }

    fn shape(&mut self, shape: &MeshedShape) {
        let Some((meshes, _)) = &self.meshes else { return };
        let period = Duration::from_secs_f64(1.0 / self.setup.mesh_hz);
        if self.mesh_sent.is_some_and(|sent| sent.elapsed() < period) {
            return;
        }
        let stamp_ns = self.link.place().stamp_ns(shape.frame).unwrap_or_else(|| self.link.clock.now_ns());
        let message =
            MeshMessage { stamp_ns, frame: self.setup.object_frame.clone(), triangles: triangles(&shape.mesh) };
        // A mesh that finds the one before under way is left out.
        if meshes.try_send(message).is_ok() {
            self.mesh_sent = Some(Instant::now());
        }
    }
}

impl LiveListener for RosPublisher {
    fn receive(&mut self, progress: &Progress<'_>) {
        match progress {
            Progress::Frame { results, sensed } => {
                if let Some(result) = results.first().and_then(Option::as_ref) {
                    self.frame(sensed.frame, &sensed.percept, result);
                }
            }
            Progress::Shape(0, shape) => self.shape(shape),
            _ => {}
        }
    }

    fn finish(mut self: Box<Self>) {
        let commands = self.link.driver.get().map(|driver| driver.finish("the run ended"));
        {
            let mut record = self.link.record();
            record.latency_ms = LiveLatency::of(std::mem::take(&mut self.latencies_ms));
            record.commands = commands;
        }
        if let Some((meshes, thread)) = self.meshes.take() {
            drop(meshes);
            let _ = thread.join();
        }
    }
}

/// How well tracking works, in words.
fn judged(state: TrackState, confidence: f64) -> (DiagnosticLevel, &'static str) {
    /// Below this confidence the tracker is doubtful.
    const DOUBTFUL: f64 = 0.5;
    match state {
        TrackState::Lost => (DiagnosticLevel::Error, "the object is lost and searched for"),
        _ if confidence < DOUBTFUL => (DiagnosticLevel::Warn, "the pose is doubtful"),
        _ => (DiagnosticLevel::Ok, "the object is tracked"),
    }
}

fn values(result: &FrameResult, record: &LiveRecord, age_ms: f64) -> Vec<(String, String)> {
    let row = &result.row;
    let mut values = vec![
        ("confidence".to_owned(), format!("{:.3}", row.confidence)),
        ("lost".to_owned(), (row.state == TrackState::Lost).to_string()),
        ("frames".to_owned(), record.frames.to_string()),
        ("late".to_owned(), record.late.to_string()),
        ("unpaired".to_owned(), record.unpaired.to_string()),
        ("unusable".to_owned(), record.unusable.to_string()),
        ("latency_ms".to_owned(), format!("{age_ms:.1}")),
    ];
    if let Some(deviation) = row.deviation {
        values.push(("deviation_mm".to_owned(), format!("{:.2}", deviation.surface_m * 1e3)));
        values.push(("deviation_deg".to_owned(), format!("{:.2}", deviation.angle_rad.to_degrees())));
    }
    if let Some(latency) = record.latency_ms {
        values.push(("latency_median_ms".to_owned(), format!("{:.1}", latency.median)));
        values.push(("latency_p95_ms".to_owned(), format!("{:.1}", latency.p95)));
    }
    for topic in &record.topics {
        values.push((format!("{} hz", topic.topic), format!("{:.1}", topic.hz)));
        values.push((format!("{} lost", topic.topic), topic.lost.to_string()));
    }
    values
}
