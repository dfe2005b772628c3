//! The colours that stand for a distance from the true surface.

use image::Rgb;

/// The error from which on the colour does not change, metres: the threshold of the headline score.
pub const FULL_SCALE_M: f32 = 0.005;

/// From none to full scale: pale, orange, dark red. The lightness falls all the way, so that it reads the same for people who see red and
/// green alike, and in grey; and what is right is pale, so that its shading shows.
const STEPS: [[u8; 3]; 5] = [[236, 236, 228], [250, 204, 116], [232, 130, 52], [188, 58, 46], [92, 20, 58]];

/// The colour of an error in metres; that of full scale for what is not a number.
pub fn of(error_m: f32) -> Rgb<u8> {
    let share = error_m.abs() / FULL_SCALE_M;
    let position = if share < 1.0 { share } else { 1.0 } * (STEPS.len() - 1) as f32;
    let low = (position as usize).min(STEPS.len() - 2);
    let within = position - low as f32;
    Rgb(std::array::from_fn(|c| {
        let [a, b] = [STEPS[low][c], STEPS[low + 1][c]].map(f32::from);
        (a + (b - a) * within).round() as u8
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_larger_error_is_darker_up_to_full_scale() {
        let lightness = |error_m: f32| {
            let [r, g, b] = of(error_m).0.map(f32::from);
            0.2126 * r + 0.7152 * g + 0.0722 * b
        };
        let steps: Vec<f32> = (0..=20).map(|k| lightness(FULL_SCALE_M * k as f32 / 20.0)).collect();
        assert!(steps.windows(2).all(|pair| pair[1] < pair[0]), "{steps:?}");
        for error_m in [1.0, f32::INFINITY, f32::NAN] {
            assert_eq!(of(error_m), of(FULL_SCALE_M));
        }
        assert_eq!(of(-0.001), of(0.001));
    }
}
