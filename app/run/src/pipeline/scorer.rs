//! Compares estimates with the truth. Nothing here goes back into estimation or control.

use std::time::Instant;

use glam::Vec3;
use mvt_field::field::NeuralField;
use mvt_field::shape::Shape as _;
use mvt_field::surface::outer_surface;
use mvt_frames::{Field, Isometry, Model, Object, World};
use mvt_mesh::Mesh;
use mvt_metrics::{POINTS, THRESHOLDS_M, sample_surface};
use mvt_slam::Estimate;
use mvt_slam::map::Map;
use mvt_slam::space::Space;

use crate::report::{FrameRow, ShapePoint, StageMs, TrackState};
use crate::sdf_grid::SdfGrid;
use crate::truth::Truth;

/// Rows of a run's record, one by one.
pub struct Scorer<'a> {
    truth: Option<&'a Truth>,
    /// From the model's coordinates to the object's: a choice of coordinates, made once, at the first estimate.
    gauge: Option<Isometry<Model, Object>>,
}

impl<'a> Scorer<'a> {
    /// Scores against the true surface, where it is known. With `model_is_object` the model's coordinates are the object's.
    pub fn new(truth: Option<&'a Truth>, model_is_object: bool) -> Self {
        Self { truth, gauge: model_is_object.then(Isometry::identity) }
    }

    /// The row of a frame.
    pub fn row(
        &mut self,
        frame: u64,
        estimate: &Estimate,
        truth: Option<Isometry<Object, World>>,
        sense_ms: f64,
    ) -> FrameRow {
        // A pose that is not trusted fixes nothing: a resumed run begins with a search.
        if estimate.state.is_tracking() && self.gauge.is_none() {
            // Without truth any will do.
            self.gauge = Some(truth.map_or_else(Isometry::identity, |truth| truth.inverse() * estimate.pose));
        }
        // Before the object was seen its pose is as unknown as when it is lost.
        let state = if estimate.state == TrackState::Waiting { TrackState::Lost } else { estimate.state };
        let pose = estimate.pose * self.gauge().inverse();
        // Without an estimate there is no error.
        let error = truth.zip(self.truth).filter(|_| self.gauge.is_some());
        let error = error.map(|(truth, surface)| (surface, truth.inverse() * pose));
        FrameRow {
            frame,
            time_s: estimate.time_s,
            state,
            confidence: estimate.confidence,
            deviation: estimate.deviation,
            estimate: pose,
            truth,
            add_s: error.map(|(surface, motion)| surface.original().add_s_of(surface.quick(), motion)),
            add_m: error.map(|(surface, motion)| surface.quick().add_m(motion)),
            stage_ms: StageMs {
                sense: sense_ms,
                track: estimate.spent.track.as_secs_f64() * 1e3,
                map: estimate.spent.map.as_secs_f64() * 1e3,
                mesh: 0.0,
            },
        }
    }

    /// From the model's coordinates to the object's.
    pub fn gauge(&self) -> Isometry<Model, Object> {
        self.gauge.unwrap_or_else(Isometry::identity)
    }
}

/// The shape at a frame, to be meshed and scored by another thread.
pub struct ShapeSnapshot {
    /// Number of the frame.
    pub frame: u64,
    /// Seconds.
    pub time_s: f64,
    field: NeuralField,
    /// The space to whose seen surface the mesh is limited, if it is.
    seen: Option<Space>,
    object_from_field: Isometry<Field, Object>,
    /// From the estimated object to the true one.
    error: Option<Isometry<Object, Object>>,
}

/// A snapshot as a mesh.
pub struct MeshedShape {
    /// Number of the frame.
    pub frame: u64,
    /// The surface in the coordinates from which the estimated poses lead.
    pub mesh: Mesh,
    /// Signed distances around it.
    pub sdf: SdfGrid,
    /// Its scores, where the truth is known.
    pub point: Option<ShapePoint>,
    /// Takes the coordinates of the field to those of the mesh.
    pub object_from_field: Isometry<Field, Object>,
    /// Wall time, milliseconds.
    pub mesh_ms: f64,
}

impl ShapeSnapshot {
    /// Copies the shape of a map at the frame of a row.
    pub fn new(map: &Map, row: &FrameRow, gauge: Isometry<Model, Object>) -> Self {
        Self {
            frame: row.frame,
            time_s: row.time_s,
            field: map.field().clone(),
            seen: map.seen().cloned(),
            object_from_field: gauge * map.field_from_model().inverse(),
            error: row.truth.map(|truth| truth.inverse() * row.estimate),
        }
    }

    /// Meshes with cells of `cell_m` and scores.
    pub fn shape(&self, cell_m: f32, truth: Option<&Truth>) -> MeshedShape {
        let begun = Instant::now();
        let mut mesh = outer_surface(&self.field, self.field.config().half_extent_m, cell_m);
        if let Some(seen) = &self.seen {
            mesh = mesh.part(|vertex| seen.is_near_surface(vertex));
        }
        let (rotation, translation) = self.object_from_field.to_f32();
        for vertex in &mut mesh.vertices {
            *vertex = Vec3::from(rotation * glam::Vec3A::from(*vertex) + translation);
        }
        let point = truth.zip(self.error).map(|(truth, error)| {
            let score = truth.original().score(&sample_surface(&mesh, POINTS, 1), error, &THRESHOLDS_M);
            let at = |mm: f64| score.f_scores.iter().find(|f| (f.threshold_m * 1e3 - mm).abs() < 1e-6);
            ShapePoint {
                time_s: self.time_s,
                f5: at(5.0).map_or(0.0, mvt_metrics::FScore::f),
                f2: at(2.0).map_or(0.0, mvt_metrics::FScore::f),
                f1: at(1.0).map_or(0.0, mvt_metrics::FScore::f),
                f10: at(10.0).map_or(0.0, mvt_metrics::FScore::f),
                precision5: at(5.0).map_or(0.0, |f| f.precision),
                recall5: at(5.0).map_or(0.0, |f| f.recall),
            }
        });
        let mesh_ms = begun.elapsed().as_secs_f64() * 1e3;
        let sdf = self.distances(mesh.bounds_m());
        MeshedShape { frame: self.frame, mesh, sdf, point, object_from_field: self.object_from_field, mesh_ms }
    }

    /// Signed distances in and around a box, coarsely.
    fn distances(&self, [low, high]: [Vec3; 2]) -> SdfGrid {
        const NODES: f32 = 32.0;
        const MARGIN_M: f32 = 0.012;
        let (low, high) = (low - MARGIN_M, high + MARGIN_M);
        let cell_m = (high - low).max_element() / (NODES - 1.0);
        let counts = ((high - low) / cell_m).ceil().to_array().map(|cells| cells as u32 + 1);
        let (rotation, translation) = self.object_from_field.inverse().to_f32();
        let [columns, rows, layers] = counts;
        let nodes = (0..layers).flat_map(|z| (0..rows).flat_map(move |y| (0..columns).map(move |x| [x, y, z])));
        let to_field = |node: [u32; 3]| {
            let point = low + cell_m * Vec3::from(node.map(|c| c as f32));
            Vec3::from(rotation * glam::Vec3A::from(point) + translation)
        };
        let points: Vec<Vec3> = nodes.map(to_field).collect();
        let mut distances = vec![0.0; points.len()];
        self.field.distances(&points, &mut distances);
        // The cast clamps.
        let values = distances.iter().map(|distance| (distance / SdfGrid::STEP_M).round() as i8).collect();
        SdfGrid { low, cell_m, counts, values }
    }
}
