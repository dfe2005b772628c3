//! Pictures of the sensors' images in false colours.

use image::{Rgb, RgbImage};
use mvt_frames::camera::PosedCamera;
use mvt_frames::depth::Label;
use mvt_frames::{Isometry, Object, World};
use mvt_render::rays::{Caster, Faces, Hits, Instance, PixelWindow, RayMesh};
use ndarray::Array2;

use mvt_picture::palette;
use mvt_recording::{CameraImages, TouchImages};

/// Indentation with the lightest colour, millimetres.
const MOST_MM: f32 = 2.0;
/// Colour of outlines of the object and of contact.
const OUTLINE: Rgb<u8> = Rgb([240, 228, 66]);

/// Paints the depth of a camera, near is light, with the outline of the pixels that are labelled as object.
pub fn depth(camera: &CameraImages) -> RgbImage {
    let bounds = bounds_m(&camera.depth_m, &camera.labels);
    let mut picture = of_depth(&camera.depth_m, bounds);
    outline(&mut picture, &camera.labels, &Label::Object);
    picture
}

/// Paints the depth of an estimated surface as a camera would measure it, in the colours of [`depth`] of these images.
pub fn rendered_depth(
    mesh: &RayMesh,
    pose: Isometry<Object, World>,
    camera: &PosedCamera,
    images: &CameraImages,
) -> RgbImage {
    let k = &camera.intrinsics;
    let mut hits = Hits::new(PixelWindow::whole(k));
    Caster::default().cast(&[Instance::new(mesh, camera.pose.inverse() * pose)], k, Faces::Both, &mut hits);
    let metres = hits.depth().iter().map(|z| if z.is_finite() { *z } else { 0.0 }).collect();
    let depth_m = Array2::from_shape_vec((k.height, k.width), metres).unwrap_or_default();
    let mut picture = of_depth(&depth_m, bounds_m(&images.depth_m, &images.labels));
    outline(&mut picture, &images.labels, &Label::Object);
    picture
}

/// Paints the labels object, hand, unsure and background.
pub fn segmentation(camera: &CameraImages) -> RgbImage {
    of_array(&camera.labels, colour_of_label)
}

/// Paints the measured indentation of a touch sensor with the outline of contact.
pub fn indentation(touch: &TouchImages) -> RgbImage {
    let mut picture = of_indentation(&touch.indentation_mm);
    outline(&mut picture, &touch.contact, &true);
    picture
}

/// Paints the true indentation of a touch sensor, where it is known.
pub fn true_indentation(touch: &TouchImages) -> Option<RgbImage> {
    touch.true_indentation_mm.as_ref().map(of_indentation)
}

/// Paints the contact of a touch sensor.
pub fn contact(touch: &TouchImages) -> RgbImage {
    of_array(&touch.contact, |touches| if touches { palette::TOUCH } else { Rgb([24, 24, 28]) })
}

fn of_array<T: Copy>(array: &Array2<T>, colour: impl Fn(T) -> Rgb<u8>) -> RgbImage {
    let (rows, columns) = array.dim();
    RgbImage::from_fn(columns as u32, rows as u32, |x, y| colour(array[(y as usize, x as usize)]))
}

fn of_depth(depth_m: &Array2<f32>, bounds_m: [f32; 2]) -> RgbImage {
    of_array(depth_m, |z| palette::depth(z, bounds_m))
}

fn colour_of_label(label: Label) -> Rgb<u8> {
    match label {
        Label::Object => Rgb([86, 180, 233]),
        Label::Hand => Rgb([150, 110, 80]),
        Label::Unsure => Rgb([100, 100, 104]),
        Label::Background => Rgb([40, 42, 46]),
    }
}

fn of_indentation(indentation_mm: &Array2<f32>) -> RgbImage {
    of_array(indentation_mm, |mm| palette::indentation(mm, MOST_MM))
}

/// Returns the nearest and farthest depth of the object, or of the whole image if no pixel is labelled as object,
/// metres.
fn bounds_m(depth_m: &Array2<f32>, labels: &Array2<Label>) -> [f32; 2] {
    let is_object = |&(_, label): &(&f32, &Label)| *label == Label::Object;
    let of_object = depth_m.iter().zip(labels).filter(is_object).map(|(z, _)| *z);
    let range = |depths: &mut dyn Iterator<Item = f32>| {
        let valid = depths.filter(|z| *z > 0.0);
        valid.fold([f32::INFINITY, 0.0f32], |[low, high], z| [low.min(z), high.max(z)])
    };
    let mut bounds = range(&mut of_object.into_iter());
    if bounds[1] <= bounds[0] {
        bounds = range(&mut depth_m.iter().copied());
    }
    if bounds[1] > bounds[0] { [bounds[0] - 0.01, bounds[1] + 0.01] } else { [0.2, 0.5] }
}

/// Draws the inner edge of the pixels that have a value.
fn outline<T: PartialEq>(picture: &mut RgbImage, array: &Array2<T>, value: &T) {
    let is_in = |x: i64, y: i64| {
        let at = usize::try_from(y).ok().zip(usize::try_from(x).ok());
        at.and_then(|at| array.get(at)) == Some(value)
    };
    for (x, y, pixel) in picture.enumerate_pixels_mut() {
        let (x, y) = (i64::from(x), i64::from(y));
        let is_edge = || [(1, 0), (-1, 0), (0, 1), (0, -1)].iter().any(|(dx, dy)| !is_in(x + dx, y + dy));
        if is_in(x, y) && is_edge() {
            *pixel = OUTLINE;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_outline_is_one_pixel_wide() {
        let mask = Array2::from_shape_fn((7, 9), |(y, x)| (2..6).contains(&x) && (1..5).contains(&y));
        let mut picture = RgbImage::new(9, 7);
        outline(&mut picture, &mask, &true);
        assert_eq!(picture.pixels().filter(|pixel| **pixel == OUTLINE).count(), 12);
        assert_eq!(picture.get_pixel(3, 2).0, [0; 3]);
    }

    #[test]
    fn the_estimate_has_the_colours_of_the_measured_depth() {
        let camera = mvt_robot::rig::PLACEMENTS[2].camera(&mvt_robot::hand::Hand::allegro(mvt_robot::hand::Side::Left));
        let ball = mvt_robot::hand::Primitive::Ellipsoid {
            centre: [0.0; 3],
            semi: [0.03; 3],
            orientation_wxyz: mvt_robot::hand::UPRIGHT,
        };
        let mesh = RayMesh::new(&mvt_render::tessellation::tessellate(&ball, 32));
        let pose = Isometry::translation(-0.0475, 0.0, 0.05);
        let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
        let mut hits = Hits::new(PixelWindow::whole(&camera.intrinsics));
        let instance = Instance::new(&mesh, camera.pose.inverse() * pose);
        Caster::default().cast(&[instance], &camera.intrinsics, Faces::Both, &mut hits);
        let metres: Vec<f32> = hits.depth().iter().map(|z| if z.is_finite() { *z } else { 0.0 }).collect();
        let depth_m = Array2::from_shape_vec((height, width), metres).unwrap();
        let images = CameraImages {
            colour: RgbImage::default(),
            labels: depth_m.mapv(|z| if z > 0.0 { Label::Object } else { Label::Background }),
            depth_m,
        };
        assert_eq!(depth(&images), rendered_depth(&mesh, pose, &camera, &images));
    }

    #[test]
    fn images_without_pixels_give_pictures_without_pixels() {
        let (camera, touch) = (CameraImages::default(), TouchImages::default());
        assert_eq!(depth(&camera).len() + segmentation(&camera).len(), 0);
        assert_eq!(indentation(&touch).len() + contact(&touch).len(), 0);
        assert!(true_indentation(&touch).is_none());
    }
}
