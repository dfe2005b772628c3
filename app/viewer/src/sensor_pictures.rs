//! Pictures of the sensors' images in false colours.

use image::{GrayImage, Rgb, RgbImage};
use mvt_frames::camera::PosedCamera;
use mvt_frames::depth::OBJECT;
use mvt_frames::{Isometry, Object, World};
use mvt_render::rays::{Caster, Faces, Hits, Instance, PixelWindow, RayMesh};
use mvt_robot::digit;
use ndarray::Array2;

use mvt_picture::palette;
use mvt_recording::{CameraImages, FingerImages};
use mvt_robot::digit::gel;

/// Indentation with the lightest colour, millimetres.
const MOST_MM: f32 = 2.0;
/// Colour of outlines of the object and of contact.
const OUTLINE: Rgb<u8> = Rgb([240, 228, 66]);

/// Paints the depth of a camera, near is light, with the outline of the pixels that are labelled as object.
pub fn depth(camera: &CameraImages) -> RgbImage {
    let bounds = bounds_m(&camera.depth_m, &camera.segmentation);
    let mut picture = of_depth(&camera.depth_m, bounds);
    outline(&mut picture, &camera.segmentation, OBJECT);
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
    let mut picture = of_depth(&depth_m, bounds_m(&images.depth_m, &images.segmentation));
    outline(&mut picture, &images.segmentation, OBJECT);
    picture
}

/// Paints the labels object, hand, unsure and background.
pub fn segmentation(camera: &CameraImages) -> RgbImage {
    of_levels(&camera.segmentation)
}

/// Paints the measured indentation of a DIGIT with the outline of contact.
pub fn indentation(finger: &FingerImages) -> RgbImage {
    let mut picture = of_indentation(&finger.depth_m);
    outline(&mut picture, &finger.contact, 255);
    picture
}

/// Paints the true indentation of a DIGIT, where it is known.
pub fn true_indentation(finger: &FingerImages) -> Option<RgbImage> {
    finger.true_depth_m.as_ref().map(of_indentation)
}

/// Paints the contact of a DIGIT.
pub fn contact(finger: &FingerImages) -> RgbImage {
    let touch = palette::TOUCH;
    of(finger.contact.width(), finger.contact.height(), |x, y| {
        if finger.contact.get_pixel(x, y).0[0] > 127 { touch } else { Rgb([24, 24, 28]) }
    })
}

fn of(width: u32, height: u32, colour: impl Fn(u32, u32) -> Rgb<u8>) -> RgbImage {
    RgbImage::from_fn(width, height, colour)
}

fn of_depth(depth_m: &Array2<f32>, bounds_m: [f32; 2]) -> RgbImage {
    let (rows, columns) = depth_m.dim();
    of(columns as u32, rows as u32, |x, y| palette::depth(depth_m[(y as usize, x as usize)], bounds_m))
}

fn of_levels(levels: &GrayImage) -> RgbImage {
    of(levels.width(), levels.height(), |x, y| match levels.get_pixel(x, y).0[0] {
        OBJECT => Rgb([86, 180, 233]),
        mvt_frames::depth::HAND => Rgb([150, 110, 80]),
        mvt_frames::depth::UNSURE => Rgb([100, 100, 104]),
        _ => Rgb([40, 42, 46]),
    })
}

fn of_indentation(depth_m: &Array2<f32>) -> RgbImage {
    let gel = gel::depth_m();
    let (rows, columns) = depth_m.dim();
    let is_digit = (rows, columns) == (digit::HEIGHT, digit::WIDTH);
    of(columns as u32, rows as u32, |x, y| {
        let at = (y as usize, x as usize);
        let pressed_m = if is_digit && depth_m[at] > 0.0 { gel[at] - depth_m[at] } else { 0.0 };
        palette::indentation(pressed_m * 1e3, MOST_MM)
    })
}

/// Returns the nearest and farthest depth of the object, or of the whole image if no pixel is labelled as object,
/// metres.
fn bounds_m(depth_m: &Array2<f32>, segmentation: &GrayImage) -> [f32; 2] {
    let is_object = |&(_, level): &(&f32, &u8)| *level == OBJECT;
    let of_object = depth_m.iter().zip(segmentation.iter()).filter(is_object).map(|(z, _)| *z);
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

/// Draws the inner edge of the pixels that have a level in a mask.
fn outline(picture: &mut RgbImage, mask: &GrayImage, level: u8) {
    let is_in = |x: i64, y: i64| {
        let pixel = u32::try_from(x).ok().zip(u32::try_from(y).ok());
        pixel.and_then(|(x, y)| mask.get_pixel_checked(x, y)).is_some_and(|pixel| pixel.0 == [level])
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
    use image::Luma;

    #[test]
    fn an_outline_is_one_pixel_wide() {
        let mask =
            GrayImage::from_fn(9, 7, |x, y| Luma([if (2..6).contains(&x) && (1..5).contains(&y) { 255 } else { 0 }]));
        let mut picture = RgbImage::new(9, 7);
        outline(&mut picture, &mask, 255);
        assert_eq!(picture.pixels().filter(|pixel| **pixel == OUTLINE).count(), 12);
        assert_eq!(picture.get_pixel(3, 2).0, [0; 3]);
    }

    #[test]
    fn the_estimate_has_the_colours_of_the_measured_depth() {
        let camera = mvt_robot::rig::PLACEMENTS[2].camera(mvt_robot::hand::Side::Left);
        let ball = mvt_robot::hand::Primitive::Ellipsoid { centre: [0.0; 3], semi: [0.03; 3] };
        let mesh = RayMesh::new(&mvt_render::tessellation::tessellate(&ball, 32));
        let pose = Isometry::translation(-0.0475, 0.0, 0.05);
        let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
        let mut hits = Hits::new(PixelWindow::whole(&camera.intrinsics));
        let instance = Instance::new(&mesh, camera.pose.inverse() * pose);
        Caster::default().cast(&[instance], &camera.intrinsics, Faces::Both, &mut hits);
        let metres: Vec<f32> = hits.depth().iter().map(|z| if z.is_finite() { *z } else { 0.0 }).collect();
        let levels = metres.iter().map(|z| if *z > 0.0 { OBJECT } else { 0 }).collect();
        let images = CameraImages {
            colour: RgbImage::default(),
            depth_m: Array2::from_shape_vec((height, width), metres).unwrap(),
            segmentation: GrayImage::from_raw(width as u32, height as u32, levels).unwrap(),
        };
        assert_eq!(depth(&images), rendered_depth(&mesh, pose, &camera, &images));
    }

    #[test]
    fn images_without_pixels_give_pictures_without_pixels() {
        let (camera, finger) = (CameraImages::default(), FingerImages::default());
        assert_eq!(depth(&camera).len() + segmentation(&camera).len(), 0);
        assert_eq!(indentation(&finger).len() + contact(&finger).len(), 0);
        assert!(true_indentation(&finger).is_none());
    }
}
