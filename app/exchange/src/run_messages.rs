//! The messages of a run with Foxglove's schemas: for a file, and for programs that watch the run.

use std::io::{self, Cursor};

use mvt_feelsight::image::RgbImage;
use mvt_feelsight::image::codecs::jpeg::JpegEncoder;
use mvt_frames::camera::PosedCamera;
use mvt_recording::{CameraImages, RecordedMoment, Recording};
use mvt_robot::hand::{PerPad, TouchPad};
use mvt_run::report::ShapePoint;

use crate::error::ExchangeError;
use crate::foxglove::{
    CAMERA_CALIBRATION, COMPRESSED_IMAGE, FRAME_TRANSFORMS, JOINT_STATES, LOG, Level, POINT_CLOUD, RAW_IMAGE,
    SCENE_UPDATE, TIMESTAMP, calibration, compressed, joint_states, log_line, mesh, optical, point_cloud, raw_image,
    time_ns, timestamp, transform, transforms,
};
use crate::protobuf::Message;
use crate::schema::{Kind, MessageType, one, optional};
use crate::writer::{Channel, MessageSink};

static ESTIMATE: MessageType = MessageType {
    package: "mambavitact",
    name: "Estimate",
    fields: &[
        one(1, "timestamp", Kind::Of(&TIMESTAMP)),
        one(2, "is_tracking", Kind::Bool),
        one(3, "confidence", Kind::Double),
        optional(4, "deviation_mm"),
        optional(5, "deviation_deg"),
        optional(6, "add_s_mm"),
        optional(7, "rotation_error_deg"),
    ],
};

static SHAPE_SCORES: MessageType = MessageType {
    package: "mambavitact",
    name: "ShapeScores",
    fields: &[
        one(1, "timestamp", Kind::Of(&TIMESTAMP)),
        one(2, "f_score_2mm", Kind::Double),
        one(3, "f_score_5mm", Kind::Double),
        one(4, "precision_5mm", Kind::Double),
        one(5, "recall_5mm", Kind::Double),
    ],
};

/// Quality of the images' JPEG files.
const QUALITY: u8 = 90;
/// Colours of the shapes, red, green, blue and opacity.
const ESTIMATED: [f64; 4] = [0.9, 0.55, 0.2, 1.0];
const TRUE: [f64; 4] = [0.3, 0.6, 0.9, 0.4];

/// The messages of a run in their order. The run may go on meanwhile.
pub(crate) struct RunMessages {
    channels: RunChannels,
    /// Warnings and events that were sent.
    warnings: usize,
    events: usize,
    /// Index of the shape that was sent last.
    shape: Option<usize>,
    is_truth_sent: bool,
}

impl RunMessages {
    /// Opens the channels of a run.
    pub fn new(sink: &mut impl MessageSink, recording: &Recording) -> io::Result<Self> {
        let channels = RunChannels::new(sink, recording)?;
        Ok(Self { channels, warnings: 0, events: 0, shape: None, is_truth_sent: false })
    }

    /// Begins again.
    #[cfg(feature = "foxglove")]
    pub fn rewind(&mut self) {
        (self.warnings, self.events, self.shape, self.is_truth_sent) = (0, 0, None, false);
    }

    /// Sends the messages of a moment, and the news up to it. `io` names the place of messages in an error of the operating system.
    pub fn moment(
        &mut self,
        recording: &Recording,
        number: usize,
        with_images: bool,
        sink: &mut impl MessageSink,
        io: &dyn Fn(io::Error) -> ExchangeError,
    ) -> Result<(), ExchangeError> {
        let Some(moment) = recording.moments().get(number) else { return Ok(()) };
        let time_s = moment.row.time_s;
        let stamp = timestamp(time_ns(time_s));
        let mut messages = self.channels.frame(recording, moment, &stamp);
        if with_images && recording.images_at(number) == Some(number) {
            self.channels.images(recording, number, &stamp, &mut messages)?;
        }
        for (channel, message) in messages {
            sink.push(channel, time_ns(time_s), &message.into_bytes()).map_err(io)?;
        }
        self.news(recording, number, sink, io)
    }

    /// Sends what is new up to a moment and does not belong to every frame: a shape that grew, scores, events and warnings.
    pub fn news(
        &mut self,
        recording: &Recording,
        number: usize,
        sink: &mut impl MessageSink,
        io: &dyn Fn(io::Error) -> ExchangeError,
    ) -> Result<(), ExchangeError> {
        let Some(moment) = recording.moments().get(number) else { return Ok(()) };
        let (channels, time_s) = (&self.channels, moment.row.time_s);
        let stamp = timestamp(time_ns(time_s));
        let mut messages = Vec::new();
        let grown = recording.shape_at(number).filter(|index| self.shape != Some(*index));
        if let Some(index) = grown
            && let Some(shape) = recording.shape(number)?
        {
            // A shape is meshed while the run goes on, and belongs to an earlier frame.
            let moments = recording.moments();
            let of = moments.get(moments.partition_point(|moment| moment.row.frame < shape.frame)).unwrap_or(moment);
            let stamp = timestamp(time_ns(of.row.time_s));
            messages.push((channels.mesh, mesh(&stamp, "estimate", "estimate", &shape.mesh, ESTIMATED)));
            messages.extend(shape.point.map(|point| (channels.scores, scores(&stamp, &point))));
            self.shape = Some(index);
        }
        for text in recording.warnings().iter().skip(self.warnings) {
            messages.push((channels.events, log_line(&stamp, Level::Warning, text)));
            self.warnings += 1;
        }
        if let Some(truth) = recording.true_mesh().filter(|_| !std::mem::replace(&mut self.is_truth_sent, true)) {
            messages.push((channels.truth, mesh(&stamp, "object", "object", truth, TRUE)));
        }
        let is_last = number + 1 == recording.moments().len() && !recording.is_growing();
        for event in recording.events().iter().skip(self.events).take_while(|event| is_last || event.time_s <= time_s) {
            messages.push((channels.events, log_line(&stamp, Level::Info, &event.text)));
            self.events += 1;
        }
        messages
            .into_iter()
            .try_for_each(|(channel, message)| sink.push(channel, time_ns(time_s), &message.into_bytes()))
            .map_err(io)
    }
}

/// The channels of a run.
struct RunChannels {
    tf: Channel,
    joints: Channel,
    cameras: Vec<CameraChannels>,
    touch: PerPad<[Channel; 2]>,
    mesh: Channel,
    state: Channel,
    scores: Channel,
    truth: Channel,
    events: Channel,
}

struct CameraChannels {
    frame: String,
    color: Channel,
    depth: Channel,
    points: Channel,
    calibration: Channel,
}

impl RunChannels {
    fn new(sink: &mut impl MessageSink, recording: &Recording) -> io::Result<Self> {
        let mut channel = |topic: &str, of| sink.channel(topic, of);
        let mut cameras = Vec::new();
        for PosedCamera { name, .. } in &recording.about().cameras {
            cameras.push(CameraChannels {
                frame: format!("camera/{name}"),
                color: channel(&format!("/camera/{name}/color"), &COMPRESSED_IMAGE)?,
                depth: channel(&format!("/camera/{name}/depth"), &RAW_IMAGE)?,
                points: channel(&format!("/camera/{name}/points"), &POINT_CLOUD)?,
                calibration: channel(&format!("/camera/{name}/calibration"), &CAMERA_CALIBRATION)?,
            });
        }
        let mut touch = PerPad(Vec::new());
        for TouchPad { name, .. } in recording.about().hand.pads() {
            touch.0.push([
                channel(&format!("/touch/{name}/image"), &COMPRESSED_IMAGE)?,
                channel(&format!("/touch/{name}/depth"), &RAW_IMAGE)?,
            ]);
        }
        Ok(Self {
            cameras,
            touch,
            tf: channel("/tf", &FRAME_TRANSFORMS)?,
            joints: channel("/hand/joints", &JOINT_STATES)?,
            mesh: channel("/estimate/mesh", &SCENE_UPDATE)?,
            state: channel("/estimate/state", &ESTIMATE)?,
            scores: channel("/estimate/scores", &SHAPE_SCORES)?,
            truth: channel("/truth/mesh", &SCENE_UPDATE)?,
            events: channel("/events", &LOG)?,
        })
    }

    /// Returns the messages that every frame has.
    fn frame(&self, recording: &Recording, moment: &RecordedMoment, stamp: &Message) -> Vec<(Channel, Message)> {
        let about = recording.about();
        let mut poses: Vec<Message> = about
            .cameras
            .iter()
            .zip(&self.cameras)
            .map(|(camera, channels)| transform(stamp, &channels.frame, camera.pose * optical()))
            .collect();
        for (pad, pose) in about.hand.pads().iter().zip(about.hand.world_from_touch_cameras(&moment.joints)) {
            poses.push(transform(stamp, &touch_frame(pad), pose * optical()));
        }
        poses.extend(moment.estimate().map(|pose| transform(stamp, "estimate", pose)));
        poses.extend(moment.row.truth.map(|pose| transform(stamp, "object", pose)));
        vec![
            (self.tf, transforms(&poses)),
            (self.joints, joint_states(stamp, &about.hand, &moment.joints)),
            (self.state, state(stamp, moment)),
        ]
    }

    /// Adds the images of a moment.
    fn images(
        &self,
        recording: &Recording,
        number: usize,
        stamp: &Message,
        messages: &mut Vec<(Channel, Message)>,
    ) -> Result<(), ExchangeError> {
        let Some(images) = recording.images(number)? else { return Ok(()) };
        let about = recording.about();
        for ((channels, camera), seen) in self.cameras.iter().zip(&about.cameras).zip(&images.cameras) {
            let Some(CameraImages { colour, depth_m, .. }) = seen else { continue };
            let frame = &channels.frame;
            messages.push((channels.calibration, calibration(stamp, frame, &camera.intrinsics)));
            messages.extend(picture(stamp, frame, colour).map(|message| (channels.color, message)));
            let depth: Vec<f32> = depth_m.iter().copied().collect();
            messages.push((channels.depth, raw_image(stamp, frame, depth_m.ncols(), &depth)));
            let coloured =
                depth_m.indexed_iter().filter(|(_, depth)| **depth > 0.0).filter_map(|((row, column), z)| {
                    let pixel = colour.get_pixel_checked(column as u32, row as u32)?;
                    let point =
                        optical().inverse() * camera.intrinsics.unproject(column as f64, row as f64, f64::from(*z));
                    let point = point.coords();
                    Some(([point.x as f32, point.y as f32, point.z as f32], pixel.0))
                });
            messages.push((channels.points, point_cloud(stamp, frame, coloured)));
        }
        for ((pad, [image, depth]), felt) in about.hand.pads().iter().zip(&self.touch).zip(&images.touch) {
            let Some(felt) = felt else { continue };
            let frame = touch_frame(pad);
            messages.extend(picture(stamp, &frame, &felt.image).map(|message| (*image, message)));
            if let Some(depth_m) = pad.profile.gel_view().depth_of(&felt.indentation_mm) {
                let pixels: Vec<f32> = depth_m.iter().copied().collect();
                messages.push((*depth, raw_image(stamp, &frame, depth_m.ncols(), &pixels)));
            }
        }
        Ok(())
    }
}

fn touch_frame(pad: &TouchPad) -> String {
    format!("touch/{}", pad.name)
}

/// Returns an image as a JPEG file; `None` for an empty one.
fn picture(stamp: &Message, frame: &str, image: &RgbImage) -> Option<Message> {
    let mut file = Cursor::new(Vec::new());
    image.write_with_encoder(JpegEncoder::new_with_quality(&mut file, QUALITY)).ok()?;
    Some(compressed(stamp, frame, &file.into_inner()))
}

fn state(stamp: &Message, moment: &RecordedMoment) -> Message {
    let row = &moment.row;
    let is_tracking = u64::from(row.state.is_tracking());
    let mut message = Message::default().message(1, stamp).varint(2, is_tracking).double(3, row.confidence);
    if let Some(deviation) = row.deviation {
        message = message.double(4, 1e3 * deviation.surface_m).double(5, deviation.angle_rad.to_degrees());
    }
    if let Some((add_s, angle_rad)) = row.add_s.zip(row.rotation_error_rad()) {
        message = message.double(6, 1e3 * add_s.one_directional_m).double(7, angle_rad.to_degrees());
    }
    message
}

fn scores(stamp: &Message, point: &ShapePoint) -> Message {
    let values = [point.f2, point.f5, point.precision5, point.recall5];
    (2..).zip(values).fold(Message::default().message(1, stamp), |message, (field, value)| message.double(field, value))
}
