//! Finding an object again that was lost.

use glam::Vec3;
use mvt_frames::{Field, Isometry, World};

use super::{Knowledge, Slam, TrackState};

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
        let candidates: Vec<_> = [self.pose].into_iter().chain(self.tracker.spun(reference, self.pose)).collect();
        if let Some(pose) = self.tracker.recognise(reference, &candidates, &|pose| self.knowledge.most_alike(pose)) {
            self.tracker.restart(pose);
            self.pose = pose;
            self.turn_is_known = true;
        }
    }

    /// While lost: takes the pose that tracking found if it is convincing, else searches now and then.
    pub(super) fn search(&mut self, time_s: f64, followed: Isometry<Field, World>, confidence: f64) -> f64 {
        let trust = self.config.trust.clone();
        let mut best = (followed, confidence);
        let mut turn_is_known = true;
        if confidence < trust.found_above && self.is_search_due(time_s) {
            self.searched_s = Some(time_s);
            let centre = match &self.knowledge {
                Knowledge::Growing(map) => map.space().bounds().map_or(Vec3::ZERO, |[a, b]| 0.5 * (a + b)),
                Knowledge::Known(given) => given.centre,
            };
            let mut rng = self.generator(1);
            let reference = self.knowledge.reference();
            let mut found = self.tracker.relocalise(reference, centre, Some(self.pose), &mut rng);
            let nearest = found.first().copied();
            let mut recognised = None;
            if self.config.tracker.texel_weight > 0.0
                && let Some(nearest) = nearest
            {
                let spun = self.tracker.spun(reference, nearest);
                turn_is_known = spun.is_empty() && !self.tracker.has_rival(reference, &found);
                found.extend(spun);
                recognised = self.tracker.recognise(reference, &found, &|pose| self.knowledge.most_alike(pose));
            }
            for found in recognised.into_iter().chain(nearest) {
                self.tracker.restart(found);
                let confidence = self.tracker.assess(self.knowledge.reference()).confidence;
                if confidence > best.1 {
                    best = (found, confidence);
                }
                // A pose that colours recognise goes before one that fits a little better.
                if recognised == Some(found) && confidence >= trust.found_above {
                    turn_is_known = true;
                    break;
                }
            }
        }
        if best.1 >= trust.found_above {
            self.tracker.restart(best.0);
            self.pose = best.0;
            self.state = TrackState::Tracking;
            self.turn_is_known = turn_is_known;
            self.doubted_s = None;
        }
        best.1
    }
}
