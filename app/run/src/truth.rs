//! The true object of a run, its surface sampled and indexed once.

use std::sync::OnceLock;

use mvt_mesh::Mesh;
use mvt_metrics::{FINE_POINTS, POINTS, TrueSurface};
use mvt_objects::Object;

/// Points of the true surface over which the error is averaged while a run goes on: enough for two digits. Reported figures are averaged
/// over 10,000.
const QUICK_POINTS: usize = 300;
/// Seed of the samples: every score of an object uses the same points.
const SEED: u64 = 0;

/// The true object with its surface at the densities that scores need. Each is made on first use.
pub struct Truth {
    object: Object,
    quick: OnceLock<TrueSurface>,
    original: OnceLock<TrueSurface>,
    fine: OnceLock<TrueSurface>,
}

impl Truth {
    /// The truth about a run with this object.
    pub fn new(object: Object) -> Self {
        Self { object, quick: OnceLock::new(), original: OnceLock::new(), fine: OnceLock::new() }
    }

    /// The object.
    pub fn object(&self) -> &Object {
        &self.object
    }

    /// Its surface.
    pub fn mesh(&self) -> &Mesh {
        &self.object.mesh
    }

    /// 300 points, for errors while a run goes on.
    pub fn quick(&self) -> &TrueSurface {
        self.quick.get_or_init(|| TrueSurface::new(&self.object.mesh, QUICK_POINTS, SEED))
    }

    /// 10,000 points, as NeuralFeels scores.
    pub fn original(&self) -> &TrueSurface {
        self.original.get_or_init(|| TrueSurface::new(&self.object.mesh, POINTS, SEED))
    }

    /// 100,000 points, for thresholds of 1 and 2 mm.
    pub fn fine(&self) -> &TrueSurface {
        self.fine.get_or_init(|| TrueSurface::new(&self.object.mesh, FINE_POINTS, SEED))
    }
}
