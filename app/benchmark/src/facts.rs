//! Facts about an RGB-D sequence, and what will be hard in it.

use std::fmt;

use mvt_frames::{Point, World};
use mvt_rgbd::{RgbdFrame, object_distance_m};
use mvt_run::mvt_slam::scan::ScanConfig;
use mvt_run::ndarray::Array2;
use mvt_run::source::RgbdSequence;
use serde::Serialize;

/// Objects with fewer pixels have too few points for their rotation: a cube of 5 cm at 0.6 m has some 2,500.
const FEW_PIXELS: f64 = 1000.0;
/// Motion between frames that alignment from the last pose still follows well, mm.
const FAST_MM: f64 = 10.0;
/// The tracker suits objects up to this distance, metres: noise of depth grows with its square.
const FAR_M: f64 = 0.8;
/// Share of the pixels of a mask without depth that is usual at edges.
const HOLES: f64 = 0.2;
/// Share of the frames that may lack something before it is worth a sentence.
const FEW_FRAMES: f64 = 0.05;
/// Pixels between the three depths whose second difference shows noise: far enough apart for those of most sensors to have errors of their own.
const NOISE_REACH_PX: usize = 3;
/// Noise above so many times that of the settings is worth a sentence.
const NOISY: f64 = 2.0;
/// A step of time that is longer than so many usual ones is a gap.
const GAP: f64 = 1.5;

/// Facts about an RGB-D sequence. Quantities of masks are those of the frames whose mask shows the object; null where none does.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SequenceFacts {
    /// The folder or file.
    pub path: String,
    /// How its files are laid out.
    pub layout: &'static str,
    /// Number of frames.
    pub frames: usize,
    /// Width and height of the depth images, pixels.
    pub size: [usize; 2],
    /// Frames per second, by the usual step of time; null of one frame.
    pub frames_per_second: Option<f64>,
    /// Time from the first frame to the last, seconds.
    pub duration_s: f64,
    /// Median distance of the object along the optical axis, metres.
    pub distance_m: Option<f64>,
    /// The greatest distance of the object, metres.
    pub farthest_m: Option<f64>,
    /// Median number of pixels of the object.
    pub pixels: Option<f64>,
    /// Least number of pixels of the object.
    pub least_pixels: Option<f64>,
    /// Width of a pixel on the object, mm.
    pub pixel_mm: Option<f64>,
    /// Median share of the pixels of the object without depth.
    pub without_depth: Option<f64>,
    /// Noise of depth on the object: the standard deviation that second differences along rows show, mm.
    pub depth_noise_mm: Option<f64>,
    /// Median motion of the middle of the seen surface between two frames, mm.
    pub motion_mm: Option<f64>,
    /// The same of which 95 % of the steps are shorter, mm.
    pub motion_p95_mm: Option<f64>,
    /// Share of the frames without a mask.
    pub without_mask: f64,
    /// Whether masks are carried into the frames without one; else those are not used.
    pub carries_masks: bool,
    /// Share of the frames whose mask is empty.
    pub hidden: f64,
    /// Share of the frames whose mask touches the border of the image.
    pub at_border: f64,
    /// Number of gaps in time.
    pub gaps: usize,
    /// The longest step of time, seconds.
    pub longest_step_s: f64,
    /// Whether a true pose of the object is known in some frame.
    pub has_truth: bool,
    /// Whether the pose of the camera is known and changes.
    pub has_camera_poses: bool,
    /// Assumptions of the reader.
    pub notes: Vec<String>,
    /// What will be hard, in sentences.
    pub difficulties: Vec<String>,
}

/// What a frame shows.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Glance {
    pub time_s: f64,
    pub has_mask: bool,
    pub pixels: usize,
    pub without_depth: f64,
    pub distance_m: Option<f64>,
    pub depth_noise_m: Option<f64>,
    pub pixel_m: f64,
    pub touches_border: bool,
    pub middle: Option<Point<World>>,
    pub has_truth: bool,
}

impl Glance {
    /// Looks at a frame.
    pub fn of(frame: &RgbdFrame) -> Self {
        let RgbdFrame { time_s, depth_m, mask, intrinsics, world_from_camera, camera_from_object, .. } = frame;
        let mut glance = Self {
            time_s: *time_s,
            has_mask: mask.is_some(),
            pixels: 0,
            without_depth: 0.0,
            distance_m: None,
            depth_noise_m: None,
            pixel_m: 0.0,
            touches_border: false,
            middle: None,
            has_truth: camera_from_object.is_some(),
        };
        let Some(mask) = mask else { return glance };
        let (rows, columns) = mask.dim();
        let (mut measured, mut sum) = (0usize, [0.0; 3]);
        for (((v, u), _), depth_m) in mask.indexed_iter().zip(depth_m).filter(|((_, inside), _)| **inside) {
            glance.pixels += 1;
            glance.touches_border |= u == 0 || v == 0 || u + 1 == columns || v + 1 == rows;
            if *depth_m > 0.0 {
                measured += 1;
                let point = intrinsics.unproject(u as f64, v as f64, f64::from(*depth_m)).coords();
                [0, 1, 2].into_iter().for_each(|axis| sum[axis] += point[axis]);
            }
        }
        glance.without_depth = 1.0 - measured as f64 / glance.pixels.max(1) as f64;
        glance.distance_m = object_distance_m(depth_m, mask).map(f64::from);
        glance.depth_noise_m = depth_noise_m(depth_m, mask);
        glance.pixel_m = glance.distance_m.unwrap_or(0.0) / intrinsics.fx;
        let [x, y, z] = sum.map(|total| total / measured.max(1) as f64);
        glance.middle = (measured > 0).then(|| *world_from_camera * Point::new(x, y, z));
        glance
    }
}

/// The standard deviation of depth within a mask, metres. Second differences of a smooth surface are small, and their deviation is that of depth
/// times the root of 6; half of their absolute values are below 0.674 deviations. Noise that pixels share is not seen.
fn depth_noise_m(depth_m: &Array2<f32>, mask: &Array2<bool>) -> Option<f64> {
    let differences = mask.indexed_iter().filter(|(_, inside)| **inside).filter_map(|((v, u), _)| {
        let depth_m = |u: usize| {
            let inside = mask.get((v, u)).is_some_and(|inside| *inside);
            depth_m.get((v, u)).filter(|depth_m| inside && **depth_m > 0.0).map(|depth_m| f64::from(*depth_m))
        };
        Some((depth_m(u.checked_sub(NOISE_REACH_PX)?)? - 2.0 * depth_m(u)? + depth_m(u + NOISE_REACH_PX)?).abs())
    });
    Some(quantile(differences, 0.5)? / 0.674 / 6_f64.sqrt())
}

/// Returns the value below which a share of the values lies; `None` without values.
fn quantile(values: impl Iterator<Item = f64>, share: f64) -> Option<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_unstable_by(f64::total_cmp);
    values.get(((values.len().max(1) - 1) as f64 * share).round() as usize).copied()
}

impl SequenceFacts {
    /// Sums up what was seen in all frames.
    pub(crate) fn new(sequence: &RgbdSequence, glances: &[Glance]) -> Self {
        let seen = || glances.iter().filter(|glance| glance.pixels > 0);
        let of = |value: fn(&Glance) -> f64, share: f64| quantile(seen().map(value), share);
        let distance = |share| quantile(seen().filter_map(|glance| glance.distance_m), share);
        let share = |is: fn(&Glance) -> bool| {
            glances.iter().filter(|glance| is(glance)).count() as f64 / glances.len().max(1) as f64
        };
        let steps = || glances.windows(2).filter_map(|pair| pair.first().zip(pair.last()));
        let times_s: Vec<f64> = steps().map(|(a, b)| b.time_s - a.time_s).collect();
        let usual_s = quantile(times_s.iter().copied(), 0.5);
        let is_gap = |step_s: &&f64| usual_s.is_some_and(|usual_s| **step_s > GAP * usual_s);
        // Over a gap a motion is not that of a frame.
        let motions: Vec<f64> = steps()
            .zip(&times_s)
            .filter(|(_, step_s)| !is_gap(step_s))
            .filter_map(|((a, b), _)| Some(1e3 * (b.middle?.coords() - a.middle?.coords()).norm()))
            .collect();
        let poses = sequence.camera_poses();
        let size = sequence.intrinsics().map_or([0; 2], |camera| [camera.width, camera.height]);
        let mut facts = Self {
            path: sequence.path().display().to_string(),
            layout: sequence.layout(),
            frames: glances.len(),
            size,
            frames_per_second: usual_s.filter(|usual_s| *usual_s > 0.0).map(f64::recip),
            duration_s: glances.last().zip(glances.first()).map_or(0.0, |(last, first)| last.time_s - first.time_s),
            distance_m: distance(0.5),
            farthest_m: distance(1.0),
            pixels: of(|glance| glance.pixels as f64, 0.5),
            least_pixels: of(|glance| glance.pixels as f64, 0.0),
            pixel_mm: quantile(seen().filter(|glance| glance.pixel_m > 0.0).map(|glance| 1e3 * glance.pixel_m), 0.5),
            without_depth: of(|glance| glance.without_depth, 0.5),
            depth_noise_mm: quantile(seen().filter_map(|glance| glance.depth_noise_m), 0.5)
                .map(|noise_m| 1e3 * noise_m),
            motion_mm: quantile(motions.iter().copied(), 0.5),
            motion_p95_mm: quantile(motions.iter().copied(), 0.95),
            without_mask: share(|glance| !glance.has_mask),
            carries_masks: sequence.carries_masks(),
            hidden: share(|glance| glance.has_mask && glance.pixels == 0),
            at_border: share(|glance| glance.touches_border),
            gaps: times_s.iter().filter(is_gap).count(),
            longest_step_s: times_s.iter().copied().fold(0.0, f64::max),
            has_truth: glances.iter().any(|glance| glance.has_truth),
            has_camera_poses: poses.windows(2).any(|pair| pair.first() != pair.last()),
            notes: sequence.notes().to_vec(),
            difficulties: Vec::new(),
        };
        facts.difficulties = facts.difficulties_of(seen().next());
        facts
    }

    /// Returns what will be hard, in sentences. `first` is the first frame that shows the object.
    fn difficulties_of(&self, first: Option<&Glance>) -> Vec<String> {
        let mut sentences = Vec::new();
        let mut say = |is_hard: bool, sentence: String| sentences.extend(is_hard.then_some(sentence));
        let percent = |share: f64| 100.0 * share;
        let (pixels, distance_m) = (self.pixels.unwrap_or(0.0), self.distance_m.unwrap_or(0.0));
        say(
            pixels < FEW_PIXELS,
            format!(
                "the object has {pixels:.0} pixels: go nearer, or record larger images ({FEW_PIXELS:.0} are enough)"
            ),
        );
        say(
            distance_m > FAR_M,
            format!("the object is {distance_m:.2} m away, where depth is noisy: up to {FAR_M} m is good"),
        );
        let noise_mm = self.depth_noise_mm.unwrap_or(0.0);
        let assumed_mm = 1e3 * f64::from(ScanConfig::default().camera_sigma_m(distance_m as f32));
        say(
            noise_mm > NOISY * assumed_mm,
            format!(
                "depth has a noise of {noise_mm:.1} mm, more than the {assumed_mm:.1} mm that are assumed of structured light at this distance: state the sensor \
                 (`--set slam.scan.depth_sensor=time_of_flight`) or its noise (`--set slam.scan.camera_sigma_per_m2={:.4}`)",
                1e-3 * noise_mm / (distance_m * distance_m)
            ),
        );
        let fast_mm = self.motion_p95_mm.unwrap_or(0.0);
        say(
            fast_mm > FAST_MM,
            format!(
                "the object moves by up to {fast_mm:.1} mm a frame (95 %): move it more slowly, or record more frames per second ({FAST_MM:.0} mm is good)"
            ),
        );
        let holes = self.without_depth.unwrap_or(0.0);
        say(
            holes > HOLES,
            format!("{:.0} % of the object has no depth: it is dark, shiny, transparent or too near", percent(holes)),
        );
        say(
            self.at_border > FEW_FRAMES,
            format!("the object touches the border of the image in {:.0} % of the frames", percent(self.at_border)),
        );
        say(
            self.without_mask > FEW_FRAMES,
            format!(
                "{:.0} % of the frames have no mask {}",
                percent(self.without_mask),
                if self.carries_masks {
                    "and receive a carried one: where a hand hides the object, give a second mask"
                } else {
                    "and are not used"
                }
            ),
        );
        say(
            self.hidden > FEW_FRAMES,
            format!("the object is hidden in {:.0} % of the frames (empty masks)", percent(self.hidden)),
        );
        say(
            self.gaps > 0,
            format!("frames are missing at {} places, the longest for {:.2} s", self.gaps, self.longest_step_s),
        );
        if let Some(first) = first {
            say(
                2 * first.pixels < pixels as usize || first.touches_border,
                "the first frame shows the object small or cut off: start at a frame that shows it well".to_owned(),
            );
        }
        sentences
    }
}

impl fmt::Display for SequenceFacts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let number = |value: Option<f64>, digits: usize| {
            value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"))
        };
        let percent = |share: Option<f64>| number(share.map(|share| 100.0 * share), 1);
        let yes = |is: bool| if is { "yes" } else { "no" };
        writeln!(f, "{}: {}", self.path, self.layout)?;
        writeln!(
            f,
            "  frames          {}, {} x {} pixels, {} a second, {:.1} s",
            self.frames,
            self.size[0],
            self.size[1],
            number(self.frames_per_second, 1),
            self.duration_s
        )?;
        writeln!(f, "  distance        {} m, at most {} m", number(self.distance_m, 3), number(self.farthest_m, 3))?;
        writeln!(
            f,
            "  object          {} pixels, at least {}; a pixel is {} mm; {} % without depth, whose noise is {} mm",
            number(self.pixels, 0),
            number(self.least_pixels, 0),
            number(self.pixel_mm, 2),
            percent(self.without_depth),
            number(self.depth_noise_mm, 1)
        )?;
        writeln!(
            f,
            "  motion          {} mm a frame, 95 % below {} mm",
            number(self.motion_mm, 1),
            number(self.motion_p95_mm, 1)
        )?;
        writeln!(
            f,
            "  masks           missing in {} % of the frames, empty in {} %, at the border in {} %",
            percent(Some(self.without_mask)),
            percent(Some(self.hidden)),
            percent(Some(self.at_border))
        )?;
        writeln!(f, "  gaps in time    {}, longest step {:.3} s", self.gaps, self.longest_step_s)?;
        write!(
            f,
            "  known           true poses: {}, motion of the camera: {}",
            yes(self.has_truth),
            yes(self.has_camera_poses)
        )?;
        for note in &self.notes {
            write!(f, "\nnote: {note}")?;
        }
        for sentence in &self.difficulties {
            write!(f, "\nhard: {sentence}")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use mvt_frames::Isometry;
    use mvt_frames::camera::Intrinsics;
    use ndarray::Array2;

    use super::*;

    #[test]
    fn a_frame_is_measured() {
        let mut mask = Array2::from_elem((6, 8), false);
        let mut depth_m = Array2::from_elem((6, 8), 0.5);
        for place in [(2, 3), (2, 4), (3, 3), (3, 4)] {
            mask[place] = true;
        }
        depth_m[(3, 4)] = 0.0;
        let frame = RgbdFrame {
            name: "0".to_owned(),
            time_s: 0.0,
            color: image::RgbImage::new(8, 6),
            depth_m,
            mask: Some(mask.clone()),
            intrinsics: Intrinsics { width: 8, height: 6, fx: 10.0, fy: 10.0, cx: 3.0, cy: 2.0 },
            world_from_camera: Isometry::identity(),
            camera_from_object: None,
        };
        let glance = Glance::of(&frame);
        assert_eq!((glance.pixels, glance.without_depth, glance.touches_border), (4, 0.25, false));
        assert_eq!((glance.distance_m, glance.pixel_m), (Some(0.5), 0.05));
        let middle = glance.middle.unwrap().coords();
        assert!((middle.x - 0.05 / 3.0).abs() < 1e-9 && (middle.z + 0.5).abs() < 1e-9, "{middle:?}");
        mask[(0, 5)] = true;
        assert!(Glance::of(&RgbdFrame { mask: Some(mask), ..frame.clone() }).touches_border);
        assert_eq!(Glance::of(&RgbdFrame { mask: None, ..frame }).pixels, 0);
    }

    #[test]
    fn quantiles_are_values() {
        let values = || [4.0, 1.0, 3.0, 2.0, 5.0].into_iter();
        assert_eq!([0.0, 0.5, 1.0].map(|share| quantile(values(), share)), [Some(1.0), Some(3.0), Some(5.0)]);
        assert_eq!(quantile(std::iter::empty(), 0.5), None);
    }
}
