//! How well measurements usually agree with the estimate, and surprises: frames that agree less.

/// Usual confidence at first: a field that has learnt little agrees less than later.
const AT_FIRST: f64 = 0.9;
/// The usual confidence follows new ones by this part.
const FOLLOW: f64 = 0.1;

/// Follows the confidence. A map that learns at a wrong pose confirms that pose, so that frames after a surprise are not learnt before one
/// agrees as usual again.
#[derive(Debug, Clone)]
pub(crate) struct Agreement {
    /// Usual confidence, 0 to 1.
    usual: f64,
    /// Frames since the last that agreed as usual.
    surprising: usize,
}

impl Agreement {
    /// Expects as much as a young field gives.
    pub fn new() -> Self {
        Self { usual: AT_FIRST, surprising: 0 }
    }

    /// Whether a confidence is lower than usual by more than `drop`.
    pub fn is_surprised_by(&self, confidence: f64, drop: f64) -> bool {
        confidence < self.usual - drop
    }

    /// Takes the confidence of a frame, and returns whether it may be learnt: it agrees as usual, or the surprise has lasted for `patience`
    /// frames, so that less agreement is the usual one from now on.
    pub fn take(&mut self, confidence: f64, drop: f64, patience: usize) -> bool {
        self.surprising = if self.is_surprised_by(confidence, drop) { self.surprising + 1 } else { 0 };
        if self.surprising > patience {
            *self = Self { usual: confidence, surprising: 0 };
        }
        if self.surprising == 0 {
            self.usual += FOLLOW * (confidence - self.usual);
        }
        self.surprising == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_is_learnt_after_a_surprise_until_frames_agree_again_or_patience_ends() {
        let mut agreement = Agreement::new();
        assert!((0..40).all(|_| agreement.take(0.87, 0.05, 3)), "a young field");
        assert!((0..40).all(|_| agreement.take(1.0, 0.05, 3)));
        let mut take = |confidence: f64| agreement.take(confidence, 0.05, 3);
        assert!(take(1.0) && take(0.96));
        assert_eq!([0.8, 0.9, 0.93].map(&mut take), [false; 3]);
        assert!(take(0.96), "as usual");
        assert_eq!([0.8, 0.8, 0.8, 0.8, 0.78, 0.7].map(&mut take), [false, false, false, true, true, false]);
    }
}
