//! Dark dots in an image, to a fraction of a pixel.

use image::RgbImage;

/// Dots of one size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct DotFinder {
    /// Radius of a dot, pixels.
    pub radius_px: f64,
    /// Distance between neighbours, pixels.
    pub pitch_px: f64,
    /// Share of the light that a place must lack in all colours before it counts as a dot.
    pub least_darkness: f32,
}

/// Half of a square with the area of a dot, in radii.
const INNER: f64 = 0.886;
/// Squares that give the surroundings of a dot, half sides in radii: the dot and its blur stay inside the smaller one.
const AROUND: [f64; 2] = [1.9, 2.8];
/// Reach of the dot's blur beyond its radius, pixels.
const SOFT_PX: f64 = 2.5;
/// Least distance between two dots, in pitches. A gel that is pressed in between two never brings them closer.
const APART: f64 = 0.45;
/// Steps that move the middle of a dot to the middle of its darkness.
const STEPS: usize = 3;

/// Sums of an image's levels over all pixels above and to the left.
struct Sums {
    width: usize,
    sums: Vec<[u32; 3]>,
}

impl Sums {
    fn new(image: &RgbImage) -> Self {
        let width = image.width() as usize + 1;
        let mut sums = vec![[0; 3]; width * (image.height() as usize + 1)];
        for (row, pixels) in image.rows().enumerate() {
            let mut line = [0; 3];
            for (column, pixel) in pixels.enumerate() {
                let above = sums[row * width + column + 1];
                for c in 0..3 {
                    line[c] += u32::from(pixel.0[c]);
                    sums[(row + 1) * width + column + 1][c] = above[c] + line[c];
                }
            }
        }
        Self { width, sums }
    }

    /// Sum over the square of this half side around a pixel.
    fn square(&self, (u, v): (usize, usize), half: usize) -> [f32; 3] {
        let at = |row: usize, column: usize| self.sums[row * self.width + column];
        let [a, b, c, d] = [
            at(v - half, u - half),
            at(v - half, u + half + 1),
            at(v + half + 1, u - half),
            at(v + half + 1, u + half + 1),
        ];
        std::array::from_fn(|k| (a[k] + d[k] - b[k] - c[k]) as f32)
    }
}

impl DotFinder {
    /// Returns the dots of an image, columns and rows, row by row. Dots whose surroundings are cut off are left out.
    pub fn find(&self, image: &RgbImage) -> Vec<[f64; 2]> {
        let (width, height) = (image.width() as usize, image.height() as usize);
        let [inner, near, far] = [INNER, AROUND[0], AROUND[1]].map(|share| (share * self.radius_px).round() as usize);
        if width.min(height) <= 2 * far {
            return Vec::new();
        }
        let sums = Sums::new(image);
        let area = |half: usize| (2 * half + 1).pow(2) as f32;
        let mut darkness = vec![0.0_f32; width * height];
        for v in far..height - far {
            for u in far..width - far {
                let (dot, inside, outside) =
                    (sums.square((u, v), inner), sums.square((u, v), near), sums.square((u, v), far));
                let missing = (0..3).map(|c| {
                    let around = (outside[c] - inside[c]) / (area(far) - area(near));
                    1.0 - dot[c] / area(inner) / around.max(1.0)
                });
                // Light from one side brightens some colours and darkens others; a dot darkens all.
                darkness[v * width + u] = missing.fold(1.0, f32::min);
            }
        }
        let apart = (APART * self.pitch_px) as usize;
        let mut dots = Vec::new();
        for v in far..height - far {
            for u in far..width - far {
                let here = darkness[v * width + u];
                if here < self.least_darkness {
                    continue;
                }
                let rows = v.saturating_sub(apart)..(v + apart + 1).min(height);
                let is_darkest = rows.into_iter().all(|row| {
                    let columns = u.saturating_sub(apart)..(u + apart + 1).min(width);
                    columns.into_iter().all(|column| {
                        let there = darkness[row * width + column];
                        // Of equals, the first counts.
                        if (row, column) < (v, u) { there < here } else { there <= here }
                    })
                });
                if is_darkest {
                    dots.push(self.middle(image, [u as f64, v as f64]));
                }
            }
        }
        dots
    }

    /// Returns the middle of the darkness around a place.
    fn middle(&self, image: &RgbImage, start: [f64; 2]) -> [f64; 2] {
        let reach = self.radius_px + SOFT_PX;
        let mut place = start;
        for _ in 0..STEPS {
            let plane = self.surroundings(image, place);
            let (mut weights, mut moments) = (0.0, [0.0; 2]);
            for (way, pixel) in around(image, place, reach) {
                let levels = plane.at(way);
                let missing: f64 = (0..3).map(|c| levels[c] - f64::from(pixel[c])).sum();
                // Pixels across the border count in part, so that nothing jumps as the middle moves.
                let inside = (reach - way[0].hypot(way[1])).clamp(0.0, 1.0);
                let weight = inside * missing.max(0.0);
                weights += weight;
                moments = [moments[0] + weight * way[0], moments[1] + weight * way[1]];
            }
            if weights > 0.0 {
                place = [place[0] + moments[0] / weights, place[1] + moments[1] / weights];
            }
        }
        // A middle that wanders off belongs to something else.
        if (place[0] - start[0]).hypot(place[1] - start[1]) > self.radius_px { start } else { place }
    }

    /// Returns the levels around a dot as a plane.
    fn surroundings(&self, image: &RgbImage, place: [f64; 2]) -> Plane {
        let (from, to) = (self.radius_px + SOFT_PX, self.radius_px + 2.0 * SOFT_PX);
        let ring = || around(image, place, to).filter(|(way, _)| way[0].hypot(way[1]) >= from);
        let (mut count, mut levels) = (0.0, [0.0; 3]);
        for (_, pixel) in ring() {
            count += 1.0;
            levels = [0, 1, 2].map(|c| levels[c] + f64::from(pixel[c]));
        }
        let mean = levels.map(|sum| sum / f64::max(count, 1.0));
        let (mut squares, mut moments) = ([0.0; 2], [[0.0; 2]; 3]);
        for (way, pixel) in ring() {
            squares = [squares[0] + way[0] * way[0], squares[1] + way[1] * way[1]];
            for c in 0..3 {
                let above = f64::from(pixel[c]) - mean[c];
                moments[c] = [moments[c][0] + above * way[0], moments[c][1] + above * way[1]];
            }
        }
        // A ring is nearly symmetric: its terms do not mix.
        Plane([0, 1, 2].map(|c| {
            let [x, y] = moments[c];
            [mean[c], x / f64::max(squares[0], 1.0), y / f64::max(squares[1], 1.0)]
        }))
    }

    /// Fills dots with the colours around them.
    pub fn erase(&self, dots: &[[f64; 2]], image: &mut RgbImage) {
        let reach = self.radius_px + SOFT_PX;
        for dot in dots {
            let plane = self.surroundings(image, *dot);
            let [u, v] = *dot;
            for row in span(v, reach, image.height()) {
                for column in span(u, reach, image.width()) {
                    let way = [f64::from(column) - u, f64::from(row) - v];
                    if way[0].hypot(way[1]) < reach {
                        image.put_pixel(column, row, image::Rgb(plane.at(way).map(|level| level.round() as u8)));
                    }
                }
            }
        }
    }
}

/// Levels of three colours: in the middle, and their slopes to the right and downwards.
struct Plane([[f64; 3]; 3]);

impl Plane {
    fn at(&self, way: [f64; 2]) -> [f64; 3] {
        self.0.map(|[level, x, y]| level + x * way[0] + y * way[1])
    }
}

/// Returns the columns or rows within a reach.
fn span(middle: f64, reach: f64, size: u32) -> std::ops::Range<u32> {
    (middle - reach).ceil() as u32..((middle + reach) as u32 + 1).min(size)
}

/// Returns the pixels within a reach of a place, with the ways to them.
fn around(image: &RgbImage, [u, v]: [f64; 2], reach: f64) -> impl Iterator<Item = ([f64; 2], [u8; 3])> {
    span(v, reach, image.height()).flat_map(move |row| {
        span(u, reach, image.width()).filter_map(move |column| {
            let way = [f64::from(column) - u, f64::from(row) - v];
            (way[0].hypot(way[1]) < reach).then(|| (way, image.get_pixel(column, row).0))
        })
    })
}

#[cfg(test)]
mod tests {
    use image::Rgb;

    use super::*;

    /// A dot that is drawn with 8 x 8 samples per pixel, on light that falls off to one side.
    fn dots(places: &[[f64; 2]], radius: f64) -> RgbImage {
        RgbImage::from_fn(120, 90, |u, v| {
            let samples = (0..64).map(|k| {
                let at =
                    [f64::from(u) + f64::from(k % 8) / 8.0 - 0.4375, f64::from(v) + f64::from(k / 8) / 8.0 - 0.4375];
                let covered = places.iter().any(|p| (p[0] - at[0]).hypot(p[1] - at[1]) < radius);
                if covered { 0.4 } else { 1.0 }
            });
            let light = samples.sum::<f64>() / 64.0;
            Rgb([120.0 - 0.4 * f64::from(u), 80.0 + 0.3 * f64::from(v), 100.0]
                .map(|level| (level * light).round() as u8))
        })
    }

    const FINDER: DotFinder = DotFinder { radius_px: 3.8, pitch_px: 26.0, least_darkness: 0.15 };

    #[test]
    fn dots_are_found_to_a_tenth_of_a_pixel() {
        let places = [[30.3, 25.8], [61.0, 24.5], [90.7, 60.2], [33.33, 66.67]];
        let found = FINDER.find(&dots(&places, 3.8));
        assert_eq!(found.len(), 4, "{found:?}");
        for place in places {
            let nearest = found.iter().map(|f| (f[0] - place[0]).hypot(f[1] - place[1])).fold(f64::MAX, f64::min);
            assert!(nearest < 0.1, "{place:?}: {nearest} px");
        }
    }

    #[test]
    fn light_and_shade_are_no_dots() {
        // A bump: red is brighter on its left and darker on its right, blue the other way round.
        let image = RgbImage::from_fn(120, 90, |u, v| {
            let (dx, dy) = (f64::from(u) - 60.0, f64::from(v) - 45.0);
            let slope = 8.0 * dx * (-(dx * dx + dy * dy) / 60.0).exp();
            Rgb([100.0 - slope, 100.0, 100.0 + slope].map(|level: f64| level.clamp(0.0, 255.0) as u8))
        });
        assert_eq!(FINDER.find(&image), Vec::<[f64; 2]>::new());
    }

    #[test]
    fn erased_dots_leave_the_light() {
        let places = [[30.3, 25.8], [61.0, 24.5]];
        let mut image = dots(&places, 3.8);
        FINDER.erase(&FINDER.find(&image.clone()), &mut image);
        let plain = dots(&[], 3.8);
        let worst = image.iter().zip(plain.iter()).map(|(a, b)| a.abs_diff(*b)).max();
        assert!(worst <= Some(2), "{worst:?} grey levels");
    }
}
