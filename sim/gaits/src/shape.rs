//! Size, fullness and mass of an object, by which its controller is chosen.

use std::ops::Range;

use mvt_objects::decompose;
use mvt_objects::object::Object;
use serde::{Deserialize, Serialize};

/// Limits of the objects that the controllers keep. Those longer than [`LONG_MM`] are kept if they lie in the hand, and are
/// neither sticks nor larger than the hand.
const LONGEST_MM: f64 = 195.0;
const HEAVIEST_G: f64 = 700.0;
/// The heaviest object with a controller of its own is a block of 729 g.
const HEAVIEST_SPECIAL_G: f64 = 750.0;
const SLENDEREST: f64 = 3.5;
const TINIEST_MM: f64 = 20.0;
const THINNEST_MM: f64 = 20.0;
const THICKEST_MM: f64 = 100.0;
/// Limits of the objects that the controllers turn.
const LONG_MM: f64 = 110.0;
const SMALLEST_MM: f64 = 48.0;
const FLATTEST_MM: f64 = 45.0;

/// Size and shape of an object as it stands on the palm.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObjectShape {
    /// Longer side of the footprint, millimetres.
    pub length_mm: f64,
    /// Shorter side of the footprint, millimetres.
    pub width_mm: f64,
    /// Height above the palm, millimetres.
    pub height_mm: f64,
    /// Share of its bounding box that the convex hull fills: a ball 0.52, an apple 0.62, an upright cylinder 0.79, a box 1.
    pub fill: f64,
    /// Mass, grams.
    pub mass_g: f64,
}

impl ObjectShape {
    /// Measures an object.
    pub fn of(object: &Object) -> Self {
        let [x, y, height] = object.extents_m();
        Self {
            length_mm: 1e3 * x.max(y),
            width_mm: 1e3 * x.min(y),
            height_mm: 1e3 * height,
            fill: decompose::hull_volume_m3(&object.mesh).unwrap_or(0.0) / (x * y * height),
            mass_g: 1e3 * object.mass_kg,
        }
    }
}

/// Objects that controllers turn, with their extents in ascending order, millimetres: one for each kind of shape.
const TURNED: [(&str, [f64; 3]); 9] = [
    ("018_plum", [53.0, 53.0, 56.0]),
    ("077_rubiks_cube", [58.0, 58.0, 59.0]),
    ("061_foam_brick", [51.0, 52.0, 78.0]),
    ("055_baseball", [72.0, 72.0, 73.0]),
    ("005_tomato_soup_can", [67.0, 68.0, 102.0]),
    ("065-g_cups", [74.0, 87.0, 87.0]),
    ("010_potted_meat_can", [57.0, 84.0, 102.0]),
    ("002_master_chef_can", [102.0, 102.0, 140.0]),
    ("006_mustard_bottle", [58.0, 96.0, 191.0]),
];

/// Why no controller turns an object.
#[derive(Debug, Clone, PartialEq)]
pub struct Unsuited {
    /// The reason, and the nearest object that fits.
    pub reason: String,
    /// The object may fall; otherwise it lies in the hand.
    pub falls: bool,
    /// The object is smaller than the fingers can turn.
    pub is_small: bool,
}

/// Kind of shape with a controller of its own.
struct Special {
    controller: &'static str,
    length_mm: Range<f64>,
    /// Largest ratio of the sides of the footprint.
    elongation: f64,
    height_mm: Range<f64>,
    fill: Range<f64>,
}

/// Limits around the objects that each of these controllers was made for.
const SPECIALS: [Special; 21] = [
    Special {
        controller: "turn_disc",
        length_mm: 75.0..100.0,
        elongation: 1.1,
        height_mm: 28.0..45.0,
        fill: 0.7..0.85,
    },
    Special {
        controller: "turn_small",
        length_mm: 34.0..45.0,
        elongation: 1.25,
        height_mm: 28.0..57.0,
        fill: 0.0..0.58,
    },
    Special {
        controller: "turn_berry",
        length_mm: 45.0..48.0,
        elongation: 1.25,
        height_mm: 28.0..57.0,
        fill: 0.0..0.58,
    },
    Special { controller: "turn_stick", length_mm: 28.0..34.0, elongation: 1.1, height_mm: 62.0..70.0, fill: 0.4..0.5 },
    Special {
        controller: "turn_large_ball",
        length_mm: 110.0..135.0,
        elongation: 1.1,
        height_mm: 110.0..135.0,
        fill: 0.48..0.58,
    },
    Special {
        controller: "turn_small_cup",
        length_mm: 55.0..59.0,
        elongation: 1.1,
        height_mm: 58.0..64.0,
        fill: 0.58..0.68,
    },
    Special { controller: "turn_cup", length_mm: 52.0..67.5, elongation: 1.1, height_mm: 55.0..70.0, fill: 0.58..0.7 },
    Special {
        controller: "turn_bowl",
        length_mm: 150.0..170.0,
        elongation: 1.1,
        height_mm: 48.0..62.0,
        fill: 0.48..0.58,
    },
    Special {
        controller: "turn_bottle",
        length_mm: 90.0..102.0,
        elongation: 2.0,
        height_mm: 180.0..196.0,
        fill: 0.6..0.7,
    },
    Special {
        controller: "turn_post",
        length_mm: 80.0..100.0,
        elongation: 1.1,
        height_mm: 180.0..215.0,
        fill: 0.9..1.01,
    },
    Special {
        controller: "turn_brick",
        length_mm: 48.0..56.0,
        elongation: 1.1,
        height_mm: 73.0..83.0,
        fill: 0.9..1.01,
    },
    Special {
        controller: "turn_pepper",
        length_mm: 76.0..86.0,
        elongation: 1.1,
        height_mm: 90.0..100.0,
        fill: 0.46..0.56,
    },
    Special {
        controller: "turn_slender",
        length_mm: 45.0..55.0,
        elongation: 1.1,
        height_mm: 120.0..140.0,
        fill: 0.6..0.8,
    },
    Special {
        controller: "turn_duck",
        length_mm: 95.0..110.0,
        elongation: 1.6,
        height_mm: 70.0..85.0,
        fill: 0.35..0.45,
    },
    Special {
        controller: "turn_elephant",
        length_mm: 120.0..135.0,
        elongation: 1.6,
        height_mm: 90.0..105.0,
        fill: 0.43..0.53,
    },
    Special {
        controller: "tumble_pear",
        length_mm: 60.0..72.0,
        elongation: 1.1,
        height_mm: 94.0..110.0,
        fill: 0.4..0.53,
    },
    Special {
        controller: "tumble_block",
        length_mm: 30.0..50.0,
        elongation: 1.6,
        height_mm: 38.0..48.0,
        fill: 0.8..1.01,
    },
    Special {
        controller: "tumble_small_block",
        length_mm: 24.0..29.0,
        elongation: 1.1,
        height_mm: 24.0..29.0,
        fill: 0.9..1.01,
    },
    // Controllers that keep these kinds in all of 40 starts of the search, where those for wider kinds drop them.
    Special {
        controller: "turn_small",
        length_mm: 55.0..58.0,
        elongation: 1.1,
        height_mm: 55.0..58.0,
        fill: 0.5..0.56,
    },
    Special { controller: "cube", length_mm: 68.0..84.0, elongation: 1.1, height_mm: 66.0..73.0, fill: 0.64..0.68 },
    Special {
        controller: "turn_wide_cup",
        length_mm: 100.0..106.0,
        elongation: 1.1,
        height_mm: 73.0..78.0,
        fill: 0.64..0.68,
    },
];

impl ObjectShape {
    /// Returns the controller that was made for the object's kind of shape, if one exists.
    pub(crate) fn special_controller(&self) -> Option<&'static str> {
        let Self { length_mm, width_mm, height_mm, fill, mass_g } = *self;
        let is_within = |special: &&Special| {
            special.length_mm.contains(&length_mm)
                && length_mm < special.elongation * width_mm
                && special.height_mm.contains(&height_mm)
                && special.fill.contains(&fill)
                && mass_g <= HEAVIEST_SPECIAL_G
        };
        SPECIALS.iter().find(is_within).map(|special| special.controller)
    }

    /// Returns why no controller turns the object; `None` if one probably does. The limits are those of a survey of the
    /// catalogue with all controllers.
    pub fn unsuited(&self) -> Option<Unsuited> {
        let Self { length_mm, width_mm, height_mm, mass_g, .. } = *self;
        let mut sides = [length_mm, width_mm, height_mm];
        sides.sort_by(f64::total_cmp);
        let [least_mm, _, most_mm] = sides;
        if self.special_controller().is_some() {
            return None;
        }
        let is_small = length_mm < SMALLEST_MM;
        let is_long = length_mm > LONG_MM;
        let limits = [
            (most_mm > LONGEST_MM, true, format!("too long: {most_mm:.0} mm, at most {LONGEST_MM}")),
            (mass_g > HEAVIEST_G, true, format!("too heavy: {mass_g:.0} g, at most {HEAVIEST_G}")),
            (
                height_mm > SLENDEREST * width_mm,
                true,
                format!("too slender: {height_mm:.0} mm high, at most {SLENDEREST} times its width"),
            ),
            (most_mm < TINIEST_MM, true, format!("too small: {most_mm:.0} mm, at least {TINIEST_MM}")),
            (is_long && least_mm < THINNEST_MM, true, format!("too thin: {least_mm:.0} mm, at least {THINNEST_MM}")),
            (is_long && least_mm > THICKEST_MM, true, format!("too large: {least_mm:.0} mm, at most {THICKEST_MM}")),
            (is_long, false, format!("too long to turn: {length_mm:.0} mm, at most {LONG_MM}")),
            (is_small, false, format!("too small to turn: {length_mm:.0} mm, at least {SMALLEST_MM}")),
            (least_mm < FLATTEST_MM, false, format!("too flat to turn: {least_mm:.0} mm, at least {FLATTEST_MM}")),
        ];
        let (_, falls, reason) = limits.into_iter().find(|(is_beyond, ..)| *is_beyond)?;
        let distance = |(_, other): &(&str, [f64; 3])| {
            sides.iter().zip(other).map(|(a, b)| (a / b).ln().abs()).fold(0.0, f64::max)
        };
        let nearest = TURNED.iter().min_by(|a, b| distance(a).total_cmp(&distance(b)));
        let nearest = nearest.map_or("", |(name, _)| name);
        Some(Unsuited { reason: format!("{reason}; the nearest object that fits is {nearest}"), falls, is_small })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_reason_and_the_nearest_object_that_fits_are_named() {
        let mug = ObjectShape { length_mm: 107.0, width_mm: 78.0, height_mm: 84.0, fill: 0.64, mass_g: 200.0 };
        assert_eq!(mug.unsuited(), None);
        let unsuited = |shape: ObjectShape| shape.unsuited().unwrap();
        let heavy = unsuited(ObjectShape { mass_g: 900.0, ..mug });
        assert_eq!(heavy.reason, "too heavy: 900 g, at most 700; the nearest object that fits is 065-g_cups");
        assert!(heavy.falls && !heavy.is_small);
        let stick = unsuited(ObjectShape { length_mm: 120.0, width_mm: 18.0, height_mm: 18.0, ..mug });
        assert!(stick.falls && stick.reason.starts_with("too thin: 18 mm, at least 20"), "{}", stick.reason);
        let large = unsuited(ObjectShape { length_mm: 126.0, width_mm: 125.0, height_mm: 126.0, ..mug });
        assert!(large.falls && large.reason.starts_with("too large: 125 mm"), "{}", large.reason);
        let small = unsuited(ObjectShape { length_mm: 40.0, width_mm: 32.0, height_mm: 32.0, ..mug });
        assert!(!small.falls && small.is_small && small.reason.ends_with("018_plum"), "{}", small.reason);
    }

    #[test]
    fn special_shapes_are_turned_within_their_limits_alone() {
        let shape =
            |length_mm, width_mm, height_mm, fill, mass_g| ObjectShape { length_mm, width_mm, height_mm, fill, mass_g };
        let tuna = shape(85.0, 85.0, 34.0, 0.77, 171.0);
        let golf_ball = shape(43.0, 43.0, 42.0, 0.53, 46.0);
        let soccer_ball = shape(126.0, 125.0, 126.0, 0.53, 123.0);
        let cup = shape(57.0, 57.0, 62.0, 0.62, 13.0);
        let block = shape(48.0, 33.0, 43.0, 0.84, 20.0);
        for (kind, controller) in [
            (tuna, "turn_disc"),
            (golf_ball, "turn_small"),
            (soccer_ball, "turn_large_ball"),
            (cup, "turn_small_cup"),
            (ObjectShape { length_mm: 60.6, width_mm: 60.5, ..cup }, "turn_cup"),
            (block, "tumble_block"),
        ] {
            assert_eq!(kind.special_controller(), Some(controller));
            assert_eq!(kind.unsuited(), None, "{controller}");
            let heavy = ObjectShape { mass_g: 900.0, ..kind };
            assert!(heavy.unsuited().unwrap().reason.starts_with("too heavy"), "{controller}");
            let narrow = ObjectShape { width_mm: 0.5 * kind.width_mm, ..kind };
            assert_eq!(narrow.special_controller(), None, "{controller}");
        }
        let square = ObjectShape { fill: 0.95, ..tuna };
        assert!(square.unsuited().unwrap().reason.starts_with("too flat to turn: 34 mm, at least 45"));
    }
}
