//! Touch sensors of this computer beside the topics: their images, with the time of their arrival as stamp.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use image::RgbImage;
use mvt_robot::digit::profile::SensorProfile;
use mvt_sensor::TouchCamera;

use crate::cdr_writer::CdrWriter;
use crate::outgoing::OutgoingHeader;

/// Pause before a sensor that was lost is looked for again.
const AGAIN: Duration = Duration::from_secs(1);
/// How often it is checked whether the run ends.
const LOOK: Duration = Duration::from_millis(50);

/// Takes an image as it arrives.
pub(crate) type TakeImage = Box<dyn Fn(&RgbImage) + Send>;

/// Reads a sensor, named by its serial number or device, on a thread of its own until `stop` is set. One that is lost is opened again when it is
/// back.
pub(crate) fn read(name: String, profile: SensorProfile, stop: Arc<AtomicBool>, take: TakeImage) -> JoinHandle<()> {
    std::thread::spawn(move || {
        let is_over = || stop.load(Ordering::Relaxed);
        let mut told = String::new();
        while !is_over() {
            let reason = match TouchCamera::open(&name, &profile) {
                Ok(mut camera) => {
                    while let Some(image) = camera.newest(&stop) {
                        take(&image);
                        told.clear();
                    }
                    if is_over() {
                        return;
                    }
                    camera.ended()
                }
                Err(reason) => format!("{reason:#}"),
            };
            if reason != told {
                tracing::warn!("touch sensor {name}: {reason}");
                told = reason;
            }
            let lost = Instant::now();
            while !is_over() && lost.elapsed() < AGAIN {
                std::thread::sleep(LOOK);
            }
        }
    })
}

/// Returns an image as the message `sensor_msgs/msg/Image`, in which the topics deliver theirs.
pub(crate) fn message(stamp_ns: i64, frame: &str, image: &RgbImage) -> Vec<u8> {
    let (width, height) = image.dimensions();
    let mut writer = CdrWriter::new();
    OutgoingHeader { stamp_ns, frame }.write(&mut writer);
    writer.u32(height).u32(width).text("rgb8").u8(0).u32(3 * width).bytes(image.as_raw());
    writer.into_message()
}

#[cfg(test)]
mod tests {
    use mvt_bag::{RosHeader, RosPicture};

    use super::*;

    #[test]
    fn an_image_is_read_as_that_of_a_topic() {
        let image = RgbImage::from_fn(5, 3, |u, v| image::Rgb([u as u8, v as u8, 9]));
        let message = message(1_700_000_000_123_456_789, "D20123", &image);
        let header = RosHeader::decode(&message).unwrap();
        assert_eq!((header.stamp_ns, header.frame.as_str()), (1_700_000_000_123_456_789, "D20123"));
        assert_eq!(RosPicture::decode(&message, false).unwrap().colours().unwrap(), image);
    }
}
