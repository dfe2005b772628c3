//! Whether the depth of a camera is in metres and sees the hand.

/// Depth in the median that no camera before a hand has, metres.
const IMPOSSIBLE_M: std::ops::RangeInclusive<f32> = 0.005..=50.0;
/// Usual depth in the median, metres.
const USUAL_M: std::ops::RangeInclusive<f32> = 0.05..=5.0;
/// The nearest depth is at most this multiple of the camera's distance from the hand, and the farthest at least this share of it.
const FARTHER: f64 = 3.0;
const NEARER: f64 = 0.3;
/// Pixels of an image that are looked at, and images of a camera.
const PIXELS: usize = 4096;
const IMAGES: usize = 1000;

/// Depths of the images of a camera: near, median and far, metres.
#[derive(Debug, Default)]
pub(crate) struct DepthCheck(Vec<[f32; 3]>);

impl DepthCheck {
    /// Adds an image, metres, 0 where nothing was measured.
    pub fn add(&mut self, depth_m: &[f32]) {
        if self.0.len() >= IMAGES {
            return;
        }
        let step = depth_m.len().div_ceil(PIXELS).max(1);
        let mut measured: Vec<f32> = depth_m.iter().step_by(step).copied().filter(|depth| *depth > 0.0).collect();
        measured.sort_by(f32::total_cmp);
        let at = |share: usize| measured.get(measured.len().saturating_sub(1) * share / 20).copied();
        if let (Some(near), Some(middle), Some(far)) = (at(1), at(10), at(19)) {
            self.0.push([near, middle, far]);
        }
    }

    /// Returns a note if the depth is unusual for a camera at this distance from the hand.
    ///
    /// # Errors
    /// A sentence if it cannot be in metres.
    pub fn verdict(&self, camera: &str, distance_m: f64) -> Result<Option<String>, String> {
        let middle = |which: usize| {
            let mut all: Vec<f32> = self.0.iter().filter_map(|image| image.get(which).copied()).collect();
            all.sort_by(f32::total_cmp);
            all.get(all.len() / 2).copied()
        };
        let (Some(near), Some(median), Some(far)) = (middle(0), middle(1), middle(2)) else {
            return Ok(Some(format!("the depth of camera {camera} is 0 throughout: nothing was measured")));
        };
        let remedy = "float depth must be in metres; depth_unit_m is the step of whole numbers";
        if !IMPOSSIBLE_M.contains(&median) {
            return Err(format!("the depth of camera {camera} is {median} m in the median; {remedy}"));
        }
        if !USUAL_M.contains(&median) {
            return Ok(Some(format!("the depth of camera {camera} is {median} m in the median: {remedy}")));
        }
        let sees_hand = f64::from(near) <= FARTHER * distance_m && f64::from(far) >= NEARER * distance_m;
        Ok((!sees_hand).then(|| {
            format!(
                "the depth of camera {camera} is {near} to {far} m, and the hand is {distance_m:.2} m away: check depth_unit_m and the camera's pose; {remedy}"
            )
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depth_in_another_unit_is_refused_or_noted() {
        let verdict = |depth: f32, distance_m| {
            let mut check = DepthCheck::default();
            (0..5).for_each(|_| check.add(&[0.0, depth, depth, 0.0, depth * 1.1]));
            check.verdict("front", distance_m)
        };
        assert_eq!(verdict(0.4, 0.36), Ok(None));
        assert_eq!(verdict(1.0, 0.36), Ok(None));
        for millimetres in [543.0, 0.000_54] {
            assert!(verdict(millimetres, 0.36).unwrap_err().contains("in metres"));
        }
        for (depth, said) in [
            (5.43, "5.43 m in the median"),
            (0.03, "0.03 m"),
            (3.6, "the hand is 0.36 m away"),
            (0.06, "0.36 m away"),
            (0.0, "0 throughout"),
        ] {
            let note = verdict(depth, 0.36).unwrap().unwrap();
            assert!(note.contains(said), "{note}");
        }
    }
}
