//! Maps on disk, so that a run continues an earlier one: the field with its optimiser, and the keyframes with their
//! rays. The knowledge of space follows from the keyframes.

use std::path::Path;
use std::sync::Arc;

use glam::{Mat3A, Vec3};
use mvt_frames::{Field, Isometry, World};
use nalgebra as na;

use super::{Map, MapConfig};
use crate::obstacles::Obstacles;
use crate::scan::{Detail, Hit, Lens, Lookup, Miss, Scan, Sensor, View};
use mvt_field::field::{FieldError, FieldTrainer};
use mvt_field::tensors::{Contents, FileError, Tensor, write};

/// The field and its optimiser.
const FIELD: &str = "field.safetensors";
/// The keyframes.
const KEYFRAMES: &str = "keyframes.safetensors";
/// Number of the first touch sensor in a file; cameras count from 0.
const FIRST_TOUCH: u32 = 1000;
/// Version of the keyframes' layout. Version 0.1.0 of the program wrote layout 1, without a number and with joint angles of a hand in place of
/// obstacle poses.
const LAYOUT: u32 = 2;
/// Largest valid coordinate and length, metres. A ray from farther away would take for ever to follow through the box.
const FARTHEST_M: f64 = 1000.0;
/// Largest valid time, seconds: ten years.
const LATEST_S: f64 = 3e8;
/// Memory that the lookups of all cameras together may take: so many times the file, and so many bytes besides.
const LOOKUPS_PER_FILE: usize = 3;
const LOOKUPS_BESIDES: usize = 200 << 20;

impl Map {
    /// The files that a saved map consists of.
    pub const FILES: [&str; 2] = [FIELD, KEYFRAMES];

    /// Writes the map into a folder.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn save(&self, folder: &Path) -> Result<(), FieldError> {
        self.trainer.save(&folder.join(FIELD))?;
        let keyframes = &self.keyframes;
        let count = keyframes.len();
        let poses = keyframes.iter().flat_map(|keyframe| numbers_of(&keyframe.pose().untyped()));
        let views = || keyframes.iter().zip(0u32..).flat_map(|(k, i)| k.scan().views.iter().map(move |view| (i, view)));
        let number = |sensor| match sensor {
            Sensor::Camera(index) => index as u32,
            Sensor::Touch(index) => FIRST_TOUCH + index as u32,
        };
        let table = views().map(|(keyframe, view)| {
            let [hits, outline, misses] = [view.hits.len(), view.outline().len(), view.misses.len()].map(|n| n as u32);
            [keyframe, number(view.sensor()), hits, outline, misses]
        });
        let lenses = views().map(|(_, view)| view.lookup().map_or([0.0; 15], lens_to_numbers));
        let hits = || views().flat_map(|(_, view)| view.hits.iter().chain(view.outline()));
        let misses = || views().flat_map(|(_, view)| &view.misses);
        let rows = views().count();
        let bodies = self.obstacles.len();
        // A body whose pose was not measured keeps the identity, far from every object.
        let obstacles = keyframes.iter().flat_map(|keyframe| {
            let poses = &keyframe.scan().obstacles;
            (0..bodies)
                .flat_map(|k| numbers_of(&poses.get(k).map_or_else(na::Isometry3::identity, |pose| pose.untyped())))
        });
        let tensors = [
            Tensor::new("time_s", vec![count], keyframes.iter().map(|k| k.scan().time_s)),
            Tensor::new("layout", vec![1], [LAYOUT]),
            Tensor::new("obstacle", vec![count, bodies, 7], obstacles),
            Tensor::new("pose", vec![count, 7], poses),
            Tensor::new("view", vec![rows, 5], table.flatten()),
            Tensor::new("origin", vec![rows, 3], views().flat_map(|(_, view)| view.origin.to_array())),
            Tensor::new("lens", vec![rows, 15], lenses.flatten()),
            Tensor::new("hit", vec![hits().count(), 9], hits().flat_map(hit_to_numbers)),
            Tensor::new(
                "miss",
                vec![misses().count(), 4],
                misses().flat_map(|m| m.direction.extend(m.free_m).to_array()),
            ),
        ];
        Ok(write(&folder.join(KEYFRAMES), None, &tensors)?)
    }

    /// Reads a map that [`Map::save`] wrote, for the same obstacles. Its time is shifted so that the last keyframe lies at 0, where the
    /// next run begins. The model's frame is that of the field.
    ///
    /// # Errors
    /// If a file cannot be read, is of an older layout, or belongs to other obstacles; the error names the tensor that is missing,
    /// misshapen or not finite.
    pub fn load(folder: &Path, config: MapConfig, obstacles: Obstacles) -> Result<Self, FieldError> {
        let trainer = FieldTrainer::load(&folder.join(FIELD))?;
        let keyframes = read(&folder.join(KEYFRAMES), Some(obstacles.len()))?;
        Ok(Self::of_keyframes(trainer, keyframes, config, obstacles))
    }

    /// Reads a map that [`Map::save`] wrote, to look at its shape: without the obstacles, whatever they were.
    ///
    /// # Errors
    /// As [`Map::load`].
    pub fn load_shape(folder: &Path) -> Result<Self, FieldError> {
        let trainer = FieldTrainer::load(&folder.join(FIELD))?;
        let keyframes = read(&folder.join(KEYFRAMES), None)?;
        Ok(Self::of_keyframes(trainer, keyframes, MapConfig::default(), Obstacles::default()))
    }

    fn of_keyframes(trainer: FieldTrainer, keyframes: Vec<PosedScan>, config: MapConfig, obstacles: Obstacles) -> Self {
        let mut map = Self::with(config, trainer, obstacles);
        for (scan, pose) in keyframes {
            map.take_back(&Arc::new(scan), pose);
        }
        map.unseen = map.space.unseen();
        map.first_pose = map.keyframes.first().map(|first| Isometry::new(first.pose().untyped()));
        map
    }
}

fn hit_to_numbers(hit: &Hit) -> [f32; 9] {
    let Hit { direction: d, range_m, normal: n, cosine, sigma_m } = *hit;
    [d.x, d.y, d.z, range_m, n.x, n.y, n.z, cosine, sigma_m]
}

/// Rotation by columns, centre, focal lengths, columns and rows.
fn lens_to_numbers(lookup: &Lookup) -> [f32; 15] {
    let (Lens { rotation, centre, focal, .. }, [columns, rows]) = (lookup.lens(), lookup.size());
    let r = rotation.to_cols_array();
    let mut numbers = [0.0; 15];
    numbers[..9].copy_from_slice(&r);
    numbers[9..].copy_from_slice(&[centre[0], centre[1], focal[0], focal[1], columns as f32, rows as f32]);
    numbers
}

/// Translation and quaternion (w, x, y, z).
fn numbers_of(pose: &na::Isometry3<f64>) -> [f64; 7] {
    let [x, y, z, w] = pose.rotation.coords.into();
    let t = &pose.translation;
    [t.x, t.y, t.z, w, x, y, z]
}

/// A scan, with the pose of the object at its time.
type PosedScan = (Scan, Isometry<Field, World>);

/// The keyframes in a file, with the poses of so many obstacles; without them if no number is given.
pub(super) fn read(path: &Path, bodies: Option<usize>) -> Result<Vec<PosedScan>, FileError> {
    let file = Contents::read(path)?;
    if file.has("joints") && !file.has("layout") {
        return Err(file.damaged(
            "was written by version 0.1.0, which stored joint angles in place of obstacle poses: run again to learn the shape anew"
                .to_owned(),
        ));
    }
    let layout: Vec<u32> = file.numbers("layout", Some(1), &[])?;
    if layout != [LAYOUT] {
        return Err(file.wrong("layout", format!("is not {LAYOUT}: use a newer version of the program")));
    }
    let times: Vec<f64> = file.numbers("time_s", None, &[])?;
    let last_s = times.last().copied().unwrap_or(0.0);
    if times.iter().any(|time_s| time_s.abs() > LATEST_S) {
        return Err(file.wrong("time_s", format!("has a time beyond {LATEST_S} s")));
    }
    let obstacles: Vec<f64> = match bodies {
        Some(bodies) => file.numbers("obstacle", Some(times.len()), &[bodies, 7])?,
        None => Vec::new(),
    };
    let bodies = bodies.unwrap_or(0);
    let poses: Vec<f64> = file.numbers("pose", Some(times.len()), &[7])?;
    let mut keyframes = Vec::with_capacity(times.len());
    let rigid = |tensor: &str, row: usize, &[x, y, z, qw, qx, qy, qz]: &[f64; 7]| {
        if [x, y, z].iter().any(|coordinate| coordinate.abs() > FARTHEST_M) {
            return Err(file.wrong(tensor, format!("is more than {FARTHEST_M} m away in row {row}")));
        }
        let rotation = na::UnitQuaternion::try_new(na::Quaternion::new(qw, qx, qy, qz), 1e-3)
            .ok_or_else(|| file.wrong(tensor, format!("has no rotation in row {row}")))?;
        Ok::<_, FileError>(na::Isometry3::from_parts(na::Translation3::new(x, y, z), rotation))
    };
    let obstacles = obstacles.as_chunks::<7>().0;
    for (frame, (&time_s, pose)) in times.iter().zip(poses.as_chunks::<7>().0).enumerate() {
        let own = obstacles.iter().skip(frame * bodies).take(bodies);
        let obstacles =
            own.map(|pose| Ok(Isometry::new(rigid("obstacle", frame, pose)?))).collect::<Result<_, FileError>>()?;
        let pose = Isometry::new(rigid("pose", frame, pose)?);
        keyframes.push((Scan { frame, time_s: time_s - last_s, obstacles, views: Vec::new() }, pose));
    }
    let table: Vec<u32> = file.numbers("view", None, &[5])?;
    let table = table.as_chunks::<5>().0;
    let origins: Vec<f32> = file.numbers("origin", Some(table.len()), &[3])?;
    let lenses: Vec<f32> = file.numbers("lens", Some(table.len()), &[15])?;
    let hits: Vec<f32> = file.numbers("hit", None, &[9])?;
    let misses: Vec<f32> = file.numbers("miss", None, &[4])?;
    let is_far = |&number: &f32| f64::from(number.abs()) > FARTHEST_M;
    for (name, numbers) in [("origin", &origins), ("hit", &hits), ("miss", &misses)] {
        if let Some(at) = numbers.iter().position(is_far) {
            return Err(file.wrong(name, format!("has {} at position {at}", numbers[at])));
        }
    }
    let mut lookups = LOOKUPS_PER_FILE * file.size_bytes() + LOOKUPS_BESIDES;
    let mut hits = hits.as_chunks::<9>().0.iter().map(|&[dx, dy, dz, range_m, nx, ny, nz, cosine, sigma_m]| Hit {
        direction: Vec3::new(dx, dy, dz),
        range_m,
        normal: Vec3::new(nx, ny, nz),
        cosine,
        sigma_m,
    });
    let mut misses =
        misses.as_chunks::<4>().0.iter().map(|&[x, y, z, free_m]| Miss { direction: Vec3::new(x, y, z), free_m });
    let frames = origins.as_chunks::<3>().0.iter().zip(lenses.as_chunks::<15>().0);
    for (&[keyframe, sensor, hit_count, outline_count, miss_count], (&origin, lens)) in table.iter().zip(frames) {
        let origin = Vec3::from(origin);
        let own: Vec<Hit> = hits.by_ref().take(hit_count as usize).collect();
        let outline: Vec<Hit> = hits.by_ref().take(outline_count as usize).collect();
        let passed: Vec<Miss> = misses.by_ref().take(miss_count as usize).collect();
        let complete =
            [own.len(), outline.len(), passed.len()] == [hit_count, outline_count, miss_count].map(|n| n as usize);
        let detail = match sensor.checked_sub(FIRST_TOUCH) {
            None => {
                let lookup = lookup(lens, origin, &own, lookups)
                    .map_err(|()| file.wrong("lens", "is that of a camera with too many pixels".to_owned()))?;
                lookups -= lookup.as_ref().map_or(0, Lookup::size_bytes);
                Detail::Camera { index: sensor as usize, lookup, outline, picture: None, texels: None }
            }
            Some(index) => Detail::Touch { index: index as usize, pad: None },
        };
        let Some((scan, _)) = keyframes.get_mut(keyframe as usize).filter(|_| complete) else {
            return Err(file.wrong("view", "does not fit the keyframes or the rays".to_owned()));
        };
        scan.views.push(View { origin, hits: own, misses: passed, detail });
    }
    Ok(keyframes)
}

/// Cameras have at most so many pixels along a side.
const LARGEST_PX: f32 = 20_000.0;

/// Returns the lookup of a camera, where the file has its lens; an error if it would take more than `most` bytes.
fn lookup(lens: &[f32; 15], origin: Vec3, hits: &[Hit], most: usize) -> Result<Option<Lookup>, ()> {
    let [r @ .., cx, cy, fx, fy, width, height] = lens;
    let [width, height] = [*width, *height];
    let sensible = (1.0..=LARGEST_PX).contains(&width) && (1.0..=LARGEST_PX).contains(&height);
    let rotation = Mat3A::from_cols_array(r);
    let lens = Lens { rotation, origin, focal_px: 0.5 * (fx + fy), centre: [*cx, *cy], focal: [*fx, *fy] };
    if !sensible {
        return Ok(None);
    }
    let (width, height) = (width as usize, height as usize);
    if Lookup::bytes_of(width, height) > most {
        return Err(());
    }
    Ok(Some(Lookup::new(lens, width, height, origin, hits)))
}
