//! Finding an object again that was lost.

use glam::Vec3;
use mvt_frames::{Field, Isometry, World};

use super::{Knowledge, Slam, TrackState};

/// An object turns by so many standard deviations of its angular velocity at most while it is lost.
const TURNS_SIGMAS: f64 = 2.0;

impl Slam {
    /// Whether another search is due.
    fn is_search_due(&self, time_s: f64) -> bool {
        self.searched_s.is_none_or(|before_s| time_s - before_s >= self.config.trust.search_interval_s)
    }

    /// Turns the pose to the rotation that colours recognise, if they recognise one.
    pub(super) fn recognise_turn(&mut self, time_s: f64) {
        if !self.is_search_due(time_s) {
            return;
        }
        self.searched_s = Some(time_s);
        let reference = self.knowledge.reference();
        let rivals = self.rivals.iter().map(|turn| Isometry::new(self.pose.untyped() * turn));
        let candidates: Vec<_> =
            [self.pose].into_iter().chain(rivals).chain(self.tracker.spun(reference, self.pose)).collect();
        if let Some(pose) = self.tracker.recognise(reference, &candidates, &|pose| self.knowledge.most_alike(pose)) {
            self.tracker.restart(pose);
            self.pose = pose;
            (self.turn_is_known, self.is_recognised) = (true, true);
            self.rivals.clear();
        }
    }

    /// While lost: takes the pose that tracking found if it is convincing, else searches now and then.
    pub(super) fn search(&mut self, time_s: f64, followed: Isometry<Field, World>, confidence: f64) -> f64 {
        let trust = self.config.trust.clone();
        let mut best = (followed, confidence);
        let mut turn_is_known = true;
        let mut rivals = Vec::new();
        if confidence < trust.found_above && self.is_search_due(time_s) {
            self.searched_s = Some(time_s);
            let centre = match &self.knowledge {
                Knowledge::Growing(map) => map.space().bounds().map_or(Vec3::ZERO, |[a, b]| 0.5 * (a + b)),
                Knowledge::Known(given) => given.centre,
            };
            let mut rng = self.generator(1);
            let reference = self.knowledge.reference();
            let found = self.tracker.relocalise(reference, centre, Some(self.pose), &mut rng);
            let judged = found.first().map(|nearest| {
                self.tracker.restart(*nearest);
                (*nearest, self.tracker.assess(reference).confidence)
            });
            best = judged.filter(|(_, confidence)| *confidence > best.1).unwrap_or(best);
            if self.config.tracker.texel_weight > 0.0
                && let Some((nearest, _)) = judged.filter(|(_, confidence)| *confidence >= trust.found_above)
            {
                let spun = self.tracker.spun(reference, nearest);
                // An object that was lost for a moment has not turned far.
                let lost_for_s = self.doubted_s.map_or(0.0, |since_s| time_s - since_s);
                let reach_rad = TURNS_SIGMAS * self.config.tracker.velocity_sigma_rad_s * lost_for_s;
                let before = self.pose.untyped().rotation;
                rivals = self.tracker.rivals(reference, nearest, centre, &mut rng);
                rivals.retain(|rival| rival.untyped().rotation.angle_to(&before) < reach_rad);
                turn_is_known = spun.is_empty() && rivals.is_empty();
                let candidates: Vec<_> = [nearest].into_iter().chain(rivals.iter().copied()).chain(spun).collect();
                let most_alike = |pose| self.knowledge.most_alike(pose);
                if let Some(pose) = self.tracker.recognise(reference, &candidates, &most_alike) {
                    self.tracker.restart(pose);
                    let confidence = self.tracker.assess(reference).confidence;
                    // A pose that colours recognise goes before one that fits a little better.
                    if confidence >= trust.found_above {
                        best = (pose, confidence);
                        (turn_is_known, self.is_recognised) = (true, true);
                    }
                }
            }
        }
        if best.1 >= trust.found_above {
            self.tracker.restart(best.0);
            self.pose = best.0;
            self.state = TrackState::Tracking;
            self.turn_is_known = turn_is_known;
            let found = best.0.untyped().inverse();
            self.rivals = rivals.iter().map(|rival| found * rival.untyped()).collect();
            self.doubted_s = None;
        }
        best.1
    }
}
