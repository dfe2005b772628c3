//! A grid of truncated distances (Curless and Levoy 1996): what fields that learn are compared with.

use glam::Vec3;
use mvt_field::exact::KnownShape;
use mvt_frames::Occupied;
use mvt_slam::scan::View;
use mvt_slam::space::{Space, clip};

/// Edge of a voxel, metres.
pub const VOXEL_M: f32 = 0.0015;
/// Distances are cut off at this, metres.
const TRUNCATION_M: f32 = 0.005;
/// A ray tells of this much behind the surface that it hit, metres. As far as before it: with less, uncertain poses shift the mean.
const BEHIND_M: f32 = 0.005;
/// Weight of a ray where it is free, against one that hits at a right angle.
const FREE_WEIGHT: f32 = 0.3;
/// A voxel counts as observed from this weight on: a few stray rays are none.
const OBSERVED: f32 = 1.0;

/// Weighted mean of the distances that were measured at a voxel.
#[derive(Debug, Clone, Copy, Default)]
struct Voxel {
    distance_m: f32,
    weight: f32,
}

impl Voxel {
    fn add(&mut self, distance_m: f32, weight: f32) {
        self.weight += weight;
        self.distance_m += (distance_m - self.distance_m) * weight / self.weight;
    }
}

/// Voxels of a cube around the origin of the model's frame.
pub struct Tsdf {
    half_extent_m: f32,
    /// A ray that hit tells of free space this far before the surface, metres.
    free_reach_m: f32,
    /// Voxels along an axis, the first and the last on the faces of the cube.
    count: usize,
    voxels: Vec<Voxel>,
}

impl Tsdf {
    /// Nothing is known of a cube that reaches `half_extent_m` from the origin.
    pub fn new(half_extent_m: f32, free_reach_m: f32) -> Self {
        let count = (2.0 * half_extent_m / VOXEL_M).round() as usize + 1;
        Self { half_extent_m, free_reach_m, count, voxels: vec![Voxel::default(); count.pow(3)] }
    }

    /// Memory of the voxels, bytes.
    pub fn size_bytes(&self) -> usize {
        size_of_val(self.voxels.as_slice())
    }

    /// Takes in the rays of a sensor. `to_model` takes points of the world to the model's frame.
    pub fn add(&mut self, view: &View, to_model: impl Fn(Vec3) -> Vec3) {
        let origin = to_model(view.origin);
        for hit in &view.hits {
            let direction = to_model(view.origin + hit.direction) - origin;
            let reach = [hit.range_m - self.free_reach_m, hit.range_m + BEHIND_M];
            self.add_ray(origin, direction, reach, hit.cosine.powi(2), |t| (hit.range_m - t) * hit.cosine);
        }
        for miss in &view.misses {
            let direction = to_model(view.origin + miss.direction) - origin;
            self.add_ray(origin, direction, [0.0, miss.free_m], FREE_WEIGHT, |_| f32::INFINITY);
        }
    }

    /// Takes in a ray over a part of its length. `distance` gives the distance from the surface at a length; `weight` is that of
    /// distances that are not cut off.
    fn add_ray(
        &mut self,
        origin: Vec3,
        direction: Vec3,
        [start, end]: [f32; 2],
        weight: f32,
        distance: impl Fn(f32) -> f32,
    ) {
        let Some((enter, leave)) = clip(origin, direction, self.half_extent_m) else { return };
        let (mut t, end) = (start.max(enter).max(0.0), end.min(leave));
        let mut last = usize::MAX;
        while t < end {
            if let Some((i, centre)) = self.voxel(origin + direction * t)
                && i != last
            {
                let distance_m = distance((centre - origin).dot(direction));
                let weight = if distance_m < TRUNCATION_M { weight } else { FREE_WEIGHT };
                self.voxels[i].add(distance_m.clamp(-TRUNCATION_M, TRUNCATION_M), weight);
                last = i;
            }
            // Near the surface a ray is to miss no voxel that it crosses.
            t += if distance(t) < TRUNCATION_M { 0.5 * VOXEL_M } else { VOXEL_M };
        }
    }

    /// Takes in points inside the hand, in the model's frame: the object is at least as far away as the hand's surface.
    pub fn add_occupied(&mut self, occupied: impl Iterator<Item = Occupied>) {
        for Occupied { point, depth_m } in occupied {
            if let Some((i, _)) = self.voxel(point) {
                let voxel = &mut self.voxels[i];
                voxel.add(voxel.distance_m.max(depth_m.min(TRUNCATION_M)), FREE_WEIGHT);
            }
        }
    }

    /// The voxel nearest to a point, and its centre.
    fn voxel(&self, p: Vec3) -> Option<(usize, Vec3)> {
        let at = ((p + self.half_extent_m) / VOXEL_M).round();
        let inside = at.min_element() >= 0.0 && at.max_element() < self.count as f32;
        inside.then(|| (self.index(at.to_array().map(|x| x as usize)), self.centre(at)))
    }

    fn centre(&self, at: Vec3) -> Vec3 {
        at * VOXEL_M - self.half_extent_m
    }

    fn index(&self, [x, y, z]: [usize; 3]) -> usize {
        x + self.count * (y + self.count * z)
    }

    /// The shape as measured so far. Unobserved cells count as inside within the hull of the surface that `space` knows, as
    /// it does for fields that learn, and as outside elsewhere.
    pub fn shape(&self, space: &Space) -> KnownShape {
        KnownShape::of_nodes(Vec3::splat(-self.half_extent_m), VOXEL_M, [self.count; 3], |at| {
            let Voxel { distance_m, weight } = self.voxels[self.index(at)];
            let centre = self.centre(Vec3::from_array(at.map(|x| x as f32)));
            if weight >= OBSERVED {
                distance_m
            } else if space.is_within_hull(centre) {
                -TRUNCATION_M
            } else {
                TRUNCATION_M
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mvt_field::shape::Shape as _;
    use mvt_field::surface::outer_surface;
    use mvt_slam::scan::{Detail, Hit, Miss};

    const RADIUS_M: f32 = 0.03;
    const HALF_M: f32 = 0.075;

    /// Exact rays onto a sphere around the origin, from a place.
    fn view(origin: Vec3) -> View {
        let (forward, distance) = (-origin.normalize(), origin.length());
        let (right, up) = forward.any_orthonormal_pair();
        let (mut hits, mut misses) = (Vec::new(), Vec::new());
        for (u, v) in (-60..=60).flat_map(|u| (-60..=60).map(move |v| (u as f32, v as f32))) {
            let direction = (forward + 0.002 * (u * right + v * up)).normalize();
            let along = distance * forward.dot(direction);
            let square = RADIUS_M.powi(2) - (distance.powi(2) - along.powi(2));
            if square < 0.0 {
                misses.push(Miss { direction, free_m: 1.0 });
                continue;
            }
            let range_m = along - square.sqrt();
            let normal = (origin + direction * range_m) / RADIUS_M;
            let cosine = (-normal.dot(direction)).clamp(0.2, 1.0);
            hits.push(Hit { direction, range_m, normal, cosine, sigma_m: 0.0 });
        }
        View {
            origin,
            hits,
            misses,
            detail: Detail::Camera { index: 0, outline: Vec::new(), lookup: None, picture: None, texels: None },
        }
    }

    fn seen(places: &[Vec3]) -> (Tsdf, Space) {
        let (mut tsdf, mut space) = (Tsdf::new(HALF_M, 0.06), Space::new(HALF_M));
        for place in places {
            // Model and world differ by a shift.
            let view = view(*place);
            let shifted = View { origin: view.origin + 0.1, ..view };
            tsdf.add(&shifted, |p| p - 0.1);
            space.add(&shifted, |p| p - 0.1);
        }
        (tsdf, space)
    }

    #[test]
    fn exact_rays_onto_a_sphere_give_the_sphere() {
        let axes = [Vec3::X, Vec3::Y, Vec3::Z, Vec3::NEG_X, Vec3::NEG_Y, Vec3::NEG_Z];
        let (tsdf, space) = seen(&axes.map(|axis| 0.35 * axis));
        // As the comparison does it: single voxels that too few rays crossed are no part of the object.
        let mesh = outer_surface(&tsdf.shape(&space), HALF_M, VOXEL_M);
        let error = |p: &Vec3| (p.length() - RADIUS_M).abs();
        let worst = mesh.vertices.iter().map(error).fold(0.0, f32::max);
        assert!(worst < 0.001, "{worst} m");
        let mean = mesh.vertices.iter().map(error).sum::<f32>() / mesh.vertices.len() as f32;
        assert!(mean < 0.0003, "{mean} m");
        let area = 4.0 * std::f64::consts::PI * f64::from(RADIUS_M).powi(2);
        assert!((mesh.area_m2() / area - 1.0).abs() < 0.05, "{} {area}", mesh.area_m2());
    }

    #[test]
    fn what_nobody_saw_is_inside_unless_the_hand_is_there() {
        let (mut tsdf, space) =
            seen(&[Vec3::new(0.0, 0.0, 0.35), Vec3::new(0.35, 0.0, 0.0), Vec3::new(-0.35, 0.0, 0.0)]);
        let hidden = [Vec3::ZERO, Vec3::new(0.0, 0.0, 0.2)];
        let distances = |tsdf: &Tsdf| {
            let mut out = [0.0; 2];
            tsdf.shape(&space).distances(&hidden, &mut out);
            out
        };
        let [middle, far] = distances(&tsdf);
        assert!(middle < 0.0 && far > 0.0, "{middle} {far}");
        for _ in 0..10 {
            tsdf.add_occupied([Occupied { point: Vec3::ZERO, depth_m: 0.003 }].into_iter());
        }
        assert!((distances(&tsdf)[0] - 0.003).abs() < 1e-6);
    }
}
