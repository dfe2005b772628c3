//! Arrangement of groups of pictures in a rectangle, in which the pictures are as large as possible.

use mvt_picture::draw::Area;

/// Distance between pictures, and height of the title above each, pixels.
pub const GAP: u32 = 6;
pub const TITLE: u32 = 15;

/// Groups of equally large pictures in a rectangle.
#[derive(Debug, Clone, Copy)]
pub struct Tiling {
    area: Area,
    per_group: u32,
    /// Groups side by side.
    across: u32,
    /// Pictures of a group side by side.
    columns: u32,
    /// Columns and rows of pictures.
    counts: [u32; 2],
    /// Width of a picture, pixels.
    picture_width: f64,
}

impl Tiling {
    /// Returns the best arrangement of groups of pictures; `aspect` is width over height of a picture.
    pub fn best(area: Area, groups: u32, per_group: u32, aspect: f64) -> Self {
        let (groups, per_group) = (groups.max(1), per_group.max(1));
        let arrangement = |across: u32, columns: u32| {
            let counts = [across * columns, groups.div_ceil(across) * per_group.div_ceil(columns)];
            let width = (f64::from(area.width) / f64::from(counts[0]) - f64::from(GAP)).max(0.0);
            let height = (f64::from(area.height) / f64::from(counts[1]) - f64::from(GAP + TITLE)).max(0.0);
            Self { area, per_group, across, columns, counts, picture_width: width.min(height * aspect) }
        };
        let columns = || (1..=per_group).rev();
        let all = (1..=groups).flat_map(|across| columns().map(move |columns| (across, columns)));
        let all = all.map(|(across, columns)| arrangement(across, columns));
        // Of equally good ones the first: groups below each other, each a row.
        all.reduce(|best, other| if other.picture_width > best.picture_width { other } else { best })
            .unwrap_or_else(|| arrangement(1, per_group))
    }

    /// Returns the rectangle of a picture of a group, with its title.
    pub fn cell(&self, group: u32, picture: u32) -> Area {
        let (x, y) = (group % self.across, group / self.across);
        let column = x * self.columns + picture % self.columns;
        let row = y * self.per_group.div_ceil(self.columns) + picture / self.columns;
        let [width, height] = [self.area.width / self.counts[0], self.area.height / self.counts[1]];
        Area {
            x: self.area.x + column * width,
            y: self.area.y + row * height,
            width: width.saturating_sub(GAP),
            height: height.saturating_sub(GAP),
        }
    }
}

/// Divides a rectangle between two sets of groups, one beside or above the other, so that all their pictures become
/// large.
pub fn share(area: Area, first: impl Fn(Area) -> Tiling, second: impl Fn(Area) -> Tiling) -> [Tiling; 2] {
    /// Parts in which the rectangle is divided.
    const PARTS: u32 = 16;
    let split = |part: u32, is_beside: bool| {
        let [width, height] = [area.width, area.height].map(|side| side * part / PARTS);
        if is_beside {
            let right = Area { x: area.x + width, width: area.width - width, ..area };
            [first(Area { width, ..area }), second(right)]
        } else {
            let below = Area { y: area.y + height, height: area.height - height, ..area };
            [first(Area { height, ..area }), second(below)]
        }
    };
    // The product favours neither side.
    let worth = |[a, b]: &[Tiling; 2]| a.picture_width * b.picture_width;
    let all = (1..PARTS).flat_map(|part| [false, true].map(|is_beside| split(part, is_beside)));
    all.reduce(|best, other| if worth(&other) > worth(&best) { other } else { best })
        .unwrap_or_else(|| split(PARTS / 2, false))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_of_a_wide_area_fill_most_of_it() {
        let area = Area { x: 6, y: 26, width: 1268, height: 688 };
        let [cameras, touch] =
            share(area, |area| Tiling::best(area, 1, 3, 4.0 / 3.0), |area| Tiling::best(area, 4, 3, 0.75));
        let covered = 3.0 * cameras.picture_width.powi(2) * 0.75 + 12.0 * touch.picture_width.powi(2) / 0.75;
        let whole = f64::from(area.width * area.height);
        assert!(covered > 0.6 * whole, "{:.2} of the area", covered / whole);
        for (tiling, groups) in [(cameras, 1), (touch, 4)] {
            for (group, picture) in (0..groups).flat_map(|group| (0..3).map(move |picture| (group, picture))) {
                let cell = tiling.cell(group, picture);
                assert!(cell.x + cell.width <= area.x + area.width && cell.y + cell.height <= area.y + area.height);
                assert!(f64::from(cell.width) + 1.0 >= tiling.picture_width);
            }
        }
    }

    #[test]
    fn any_number_of_pads_fits() {
        let area = Area { x: 6, y: 26, width: 500, height: 560 };
        let mut narrower = f64::INFINITY;
        for pads in 0..=8 {
            let tiling = Tiling::best(area, pads, 3, 0.75);
            assert!(tiling.picture_width > 50.0 && tiling.picture_width <= narrower, "{pads}: {tiling:?}");
            narrower = tiling.picture_width;
            for (pad, picture) in (0..pads).flat_map(|pad| (0..3).map(move |picture| (pad, picture))) {
                let cell = tiling.cell(pad, picture);
                assert!(cell.x + cell.width <= area.x + area.width && cell.y + cell.height <= area.y + area.height);
            }
        }
    }

    #[test]
    fn areas_without_pixels_do_no_harm() {
        let tiling = Tiling::best(Area { x: 0, y: 0, width: 0, height: 0 }, 0, 0, 1.0);
        assert_eq!((tiling.picture_width, tiling.cell(0, 0).width), (0.0, 0));
    }
}
