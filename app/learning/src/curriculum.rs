//! The order in which a training meets its objects.

use std::sync::Arc;

use mvt_environment::Scene;

/// Scenes of a training, which have the same settings.
#[derive(Clone)]
pub struct Curriculum {
    /// Scenes with which it begins.
    pub first: Vec<Arc<Scene>>,
    /// Scenes that join when the objects of the first are held and turned, as [`crate::LearningConfig`] says.
    pub later: Vec<Arc<Scene>>,
}

impl From<Vec<Arc<Scene>>> for Curriculum {
    /// Returns a training of all scenes from the start.
    fn from(scenes: Vec<Arc<Scene>>) -> Self {
        Self { first: scenes, later: Vec::new() }
    }
}

impl Curriculum {
    /// Returns all scenes, once; `None` if there are no later ones, or if they have joined.
    pub(crate) fn widen(&mut self) -> Option<Vec<Arc<Scene>>> {
        let later = std::mem::take(&mut self.later);
        (!later.is_empty()).then(|| self.first.iter().cloned().chain(later).collect())
    }
}
