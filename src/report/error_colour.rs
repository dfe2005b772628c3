//! The colours that stand for a distance from the true surface.

use image::Rgb;

/// The error from which on the colour does not change, metres: the threshold of the headline score.
pub(super) const FULL_SCALE_M: f32 = 0.005;

/// Viridis in nine steps (van der Walt and Smith, CC0), from none to full scale: its lightness grows all the way, so that it reads
/// the same for people who see red and green alike, and in grey.
const STEPS: [[u8; 3]; 9] = [
    [68, 1, 84],
    [71, 45, 123],
    [59, 82, 139],
    [44, 114, 142],
    [33, 145, 140],
    [40, 174, 128],
    [94, 201, 98],
    [173, 220, 48],
    [253, 231, 37],
];

/// The colour of an error in metres; that of full scale for what is not a number.
pub(super) fn of(error_m: f32) -> Rgb<u8> {
    let share = error_m.abs() / FULL_SCALE_M;
    let position = if share < 1.0 { share } else { 1.0 } * (STEPS.len() - 1) as f32;
    let low = (position as usize).min(STEPS.len() - 2);
    let within = position - low as f32;
    Rgb(std::array::from_fn(|c| {
        let [a, b] = [STEPS[low][c], STEPS[low + 1][c]].map(f32::from);
        (a + (b - a) * within).round() as u8
    }))
}
