//! How well measurements usually agree with the estimate, and surprises: frames that agree less.

/// Usual confidence at first: a field that has learnt little agrees less than later.
const AT_FIRST: f64 = 0.9;
/// The usual confidence follows new ones with this time constant, seconds.
const FOLLOW_S: f64 = 0.316;
/// A frame after a pause counts no more than one after this time, seconds.
const LONGEST_S: f64 = 0.1;

// Why: notes/decisions/estimation.md, "After a surprise the map stays as it is".
/// Follows the confidence. A map that learns at a wrong pose confirms that pose, so that frames after a surprise are not learnt before one
/// agrees as usual again.
#[derive(Debug, Clone)]
pub(crate) struct Agreement {
    /// Usual confidence, 0 to 1.
    usual: f64,
    /// Time of the first of the surprising frames in a row, seconds.
    surprised_s: Option<f64>,
    /// Time of the frame before, seconds.
    before_s: Option<f64>,
}

impl Agreement {
    /// Expects as much as a young field gives.
    pub fn new() -> Self {
        Self { usual: AT_FIRST, surprised_s: None, before_s: None }
    }

    /// Whether a confidence is lower than usual by more than `drop`.
    pub fn is_surprised_by(&self, confidence: f64, drop: f64) -> bool {
        confidence < self.usual - drop
    }

    /// Takes the confidence of a frame, and returns whether it may be learnt: it agrees as usual, or the surprise has lasted for longer than
    /// `patience_s`, so that less agreement is the usual one from now on.
    pub fn take(&mut self, time_s: f64, confidence: f64, drop: f64, patience_s: f64) -> bool {
        let interval_s =
            self.before_s.replace(time_s).map_or(0.0, |before_s| (time_s - before_s).clamp(0.0, LONGEST_S));
        if self.is_surprised_by(confidence, drop) {
            let since_s = *self.surprised_s.get_or_insert(time_s);
            if time_s - since_s <= patience_s {
                return false;
            }
            self.usual = confidence;
        }
        self.surprised_s = None;
        self.usual += (1.0 - (-interval_s / FOLLOW_S).exp()) * (confidence - self.usual);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_is_learnt_after_a_surprise_until_frames_agree_again_or_patience_ends() {
        let mut agreement = Agreement::new();
        let mut time_s = 0.0;
        let mut take = |confidence: f64| {
            time_s += 1.0 / 30.0;
            agreement.take(time_s, confidence, 0.05, 0.09)
        };
        assert!((0..40).all(|_| take(0.87)), "a young field");
        assert!((0..40).all(|_| take(1.0)));
        assert!(take(1.0) && take(0.96));
        assert_eq!([0.8, 0.9, 0.93].map(&mut take), [false; 3]);
        assert!(take(0.96), "as usual");
        assert_eq!([0.8, 0.8, 0.8, 0.8, 0.78, 0.7].map(&mut take), [false, false, false, true, true, false]);
    }
}
