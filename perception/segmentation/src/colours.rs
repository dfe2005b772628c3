//! How likely a colour is that of an object, by what was seen of the object and of its surroundings.

/// Levels of red, green and blue that are told apart.
const LEVELS: usize = 16;
/// Pixels of any colour that are assumed to have been seen, so that a rare colour says little, share of all.
const UNSEEN: f32 = 2e-4;

/// Colours of an object and of its surroundings.
#[derive(Debug, Clone)]
pub(crate) struct Colours {
    /// Pixels by colour: of the surroundings, and of the object.
    seen: [Vec<f32>; 2],
    sums: [f32; 2],
    /// Share of the surroundings that is kept from frame to frame.
    kept: f32,
}

impl Colours {
    pub fn new(kept: f32) -> Self {
        Self { seen: [(); 2].map(|()| vec![0.0; LEVELS.pow(3)]), sums: [0.0; 2], kept }
    }

    fn bin(colour: [u8; 3]) -> usize {
        colour.iter().fold(0, |bin, &level| bin * LEVELS + usize::from(level) * LEVELS / 256)
    }

    /// Begins a frame: earlier surroundings count less.
    pub fn fade(&mut self) {
        let kept = self.kept;
        self.seen[0].iter_mut().for_each(|count| *count *= kept);
        self.sums[0] *= kept;
    }

    pub fn add(&mut self, colour: [u8; 3], is_object: bool) {
        let side = usize::from(is_object);
        self.seen[side][Self::bin(colour)] += 1.0;
        self.sums[side] += 1.0;
    }

    /// Returns the logarithm of how much more frequent a colour is on the object than around it; 0 if nothing is known.
    pub fn log_odds(&self, colour: [u8; 3]) -> f32 {
        if self.sums.contains(&0.0) {
            return 0.0;
        }
        let bin = Self::bin(colour);
        let [outside, inside] = [0, 1].map(|side| self.seen[side][bin] / self.sums[side] + UNSEEN);
        (inside / outside).ln()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_colour_of_the_object_speaks_for_it() {
        let mut colours = Colours::new(0.9);
        let (red, wood) = ([200, 20, 30], [120, 90, 60]);
        assert!(colours.log_odds(red).abs() < 1e-6);
        for _ in 0..100 {
            colours.add(red, true);
            colours.add(wood, false);
        }
        assert!(colours.log_odds(red) > 2.0 && colours.log_odds(wood) < -2.0);
        assert!(colours.log_odds([0, 0, 255]).abs() < 1e-6);
    }
}
