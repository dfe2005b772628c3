use super::*;
use crate::scan::{Scan, ScanConfig};
use crate::synthetic::{BRICK, Solid, pose, seen};
use crate::tracker::{apply, to_na};

const HALF_M: f32 = 0.075;

/// Takes in a solid as it looks after a turn about the vertical.
fn look(space: &mut Space, frame: usize, solid: Solid, turn_deg: f64) {
    let at = pose([0.0; 3], [0.0, 0.0, turn_deg]);
    let scan = Scan::new(frame, &seen(frame, solid, at).measured(), &ScanConfig::default(), 1);
    let model_from_world = at.untyped().inverse();
    for view in &scan.views {
        space.add(view, |p| apply(&model_from_world, p));
    }
}

fn looked_at(solid: Solid, turns_deg: &[f64]) -> Space {
    let mut space = Space::new(HALF_M);
    for (frame, turn) in turns_deg.iter().enumerate() {
        look(&mut space, frame, solid, *turn);
    }
    space
}

/// The unseen cells that are taken for the object.
fn inside(space: &Space) -> Vec<Unseen> {
    space.unseen().into_iter().filter(|unseen| unseen.assumed.is_object()).collect()
}

/// Direction of the camera in the model's frame of an object that was not turned.
fn to_camera() -> Vec3 {
    Vec3::new(0.06, 0.24, 0.247).normalize()
}

#[test]
fn nothing_is_known_at_first() {
    let space = Space::new(HALF_M);
    assert_eq!(space.bounds(), None);
    assert_eq!(space.unseen_fraction(), 1.0);
    assert!(!space.is_near_surface(Vec3::ZERO));
    assert!(inside(&space).is_empty(), "without a hull there is no inside");
}

#[test]
fn surface_is_known_where_it_was_seen() {
    let radius = 0.03;
    let space = looked_at(Solid::Ball(0.03), &[0.0]);
    assert!(space.is_near_surface(to_camera() * radius));
    assert!(!space.is_near_surface(-to_camera() * radius), "the far side");
    assert!(!space.is_near_surface(Vec3::ZERO));
    assert!(!space.is_near_surface(to_camera() * 0.06));
    assert!(!space.is_near_surface(Vec3::splat(1.0)) && !space.is_near_surface(Vec3::NAN), "outside the box");
    let reach = 2.0 * 3f32.sqrt() * space.resolution_m();
    for i in 0..40_000u32 {
        let p = Vec3::new((i % 34) as f32, (i / 34 % 34) as f32, (i / 1156) as f32) * 0.0022 - 0.0374;
        if space.is_near_surface(p) {
            assert!((p.length() - radius).abs() < reach, "{p} is {} m from the surface", p.length() - radius);
        }
    }
}

#[test]
fn one_hit_is_not_a_surface() {
    let mut space = Space::new(HALF_M);
    let p = Vec3::new(0.01, 0.02, 0.03);
    for count in 1..=SEEN {
        space.add_hit(p);
        assert_eq!(space.is_near_surface(p), count >= SEEN);
        assert_eq!(space.bounds().is_some(), count >= SEEN);
    }
    let beside = Vec3::splat(space.resolution_m());
    assert!(space.is_near_surface(p + beside) && space.is_near_surface(p - beside));
    assert!(!space.is_near_surface(p + 2.0 * beside) && !space.is_near_surface(p - 2.0 * beside));
    // At the border of the box there are fewer neighbours, and counts stop before they overflow.
    for _ in 0..1000 {
        space.add_hit(Vec3::splat(0.9999 * HALF_M));
        space.add_hit(Vec3::splat(-HALF_M));
        space.add_hit(Vec3::splat(HALF_M + 0.01));
    }
    assert!(space.is_near_surface(Vec3::splat(-HALF_M)));
}

#[test]
fn rays_carve_up_to_the_surface() {
    let mut space = Space::new(HALF_M);
    let (from, to) = (Vec3::new(0.3, 0.01, -0.02), Vec3::new(0.02, 0.01, -0.02));
    space.pass(from, to, 0.004);
    let passes = |x: f32| space.passes[space.index(Vec3::new(x, 0.01, -0.02)).unwrap()];
    let cell = space.resolution_m();
    for i in 0..64 {
        let x = (i as f32 + 0.5) * cell - HALF_M;
        if x > 0.02 + 0.004 + cell {
            assert_eq!(passes(x), 1, "free at {x}");
        } else if x < 0.02 + 0.004 - cell {
            assert_eq!(passes(x), 0, "behind the end at {x}");
        }
    }
    let carved: usize = space.passes.iter().map(|&n| usize::from(n)).sum();
    assert!(carved < 64, "one row only");
    // A ray that misses the box, one that points away from it, and one of no length.
    let before = space.passes.clone();
    space.pass(Vec3::new(0.3, 0.3, 0.3), Vec3::new(-0.3, 0.3, 0.3), 0.0);
    space.pass(Vec3::new(0.3, 0.0, 0.0), Vec3::new(0.6, 0.0, 0.0), 0.0);
    space.pass(Vec3::ZERO, Vec3::ZERO, 0.0);
    assert_eq!(space.passes, before);
}

#[test]
fn nothing_of_the_solid_is_carved() {
    let space = looked_at(BRICK, &[0.0, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0]);
    let mut carved = 0;
    for z in 0..CELLS {
        for y in 0..CELLS {
            for x in 0..CELLS {
                let cell = UVec3::new(x, y, z);
                let p = (cell.as_vec3() + 0.5) * space.resolution_m() - HALF_M;
                if space.passes[flatten(cell)] >= EMPTY {
                    carved += 1;
                    let depth = -BRICK.distance(to_na(p));
                    assert!(depth < f64::from(space.resolution_m()), "{p} is {depth} m inside and was carved");
                }
            }
        }
    }
    assert!(carved > 40_000, "{carved} cells");
}

#[test]
fn the_unseen_inside_lies_within_the_hull_of_what_was_seen() {
    let space = looked_at(BRICK, &[0.0, 60.0, 120.0, 180.0, 240.0, 300.0]);
    let inside = inside(&space);
    assert!(inside.len() > 1000, "{}", inside.len());
    let slack = f64::from(HULL_MARGIN_M + space.resolution_m());
    for &Unseen { centre: p, depth_m, .. } in &inside {
        // The hull of the seen points lies in the brick; 66 directions leave its corners a little room.
        assert!(BRICK.distance(to_na(p)) < 2.0 * slack, "{p}");
        assert!(!space.is_near_surface(p));
        let depth = -BRICK.distance(to_na(p));
        assert!((depth - f64::from(depth_m)).abs() < 2.0 * slack, "{p} lies {depth} m deep, not {depth_m}");
    }
    let has = |p: Vec3| inside.iter().any(|q| (p - q.centre).abs().max_element() <= 0.51 * space.resolution_m());
    assert!(has(Vec3::ZERO), "the middle was never seen");
    // The bottom was not seen: cells over it count as inside, cells that sensors looked through do not.
    assert!(has(Vec3::new(0.0, 0.0, -0.016)));
    assert!(!has(Vec3::new(0.0, 0.0, 0.03)));
}

#[test]
fn bounds_are_those_of_the_solid_once_all_sides_were_seen() {
    let space = looked_at(BRICK, &[0.0, 60.0, 120.0, 180.0, 240.0, 300.0]);
    let ([low, high], [truly_low, truly_high]) = (space.bounds().unwrap(), BRICK.bounds());
    for (measured, truth) in [low.x, low.y, high.x, high.y, high.z].into_iter().zip([
        truly_low.x,
        truly_low.y,
        truly_high.x,
        truly_high.y,
        truly_high.z,
    ]) {
        // Hits keep three pixels from the outline, two millimetres there.
        assert!((measured - truth).abs() < 0.0035 && measured.abs() < truth.abs() + 1e-4, "{measured} {truth}");
    }
}

#[test]
fn less_is_unseen_the_more_was_seen() {
    let turns = [0.0, 60.0, 120.0, 180.0, 240.0, 300.0];
    let unseen: Vec<f64> =
        (0..=turns.len()).map(|n| looked_at(Solid::Ball(0.03), &turns[..n]).unseen_fraction()).collect();
    assert!(unseen.windows(2).all(|pair| pair[1] < pair[0] + 0.02), "{unseen:?}");
    // A view shows less than half of a ball, but more than half as seen from the middle of the shown part.
    assert!(unseen[1] > 0.3 && unseen[1] < 0.8, "{unseen:?}");
    assert!(unseen[6] < 0.3 && unseen[6] > 0.02, "a turn shows all but the bottom: {unseen:?}");
}

#[test]
fn the_hand_is_not_inside() {
    let mut space = looked_at(BRICK, &[0.0]);
    let before = inside(&space);
    let middle = before[before.len() / 2];
    let point = |depth_m| Occupied { point: middle.centre, depth_m };
    space.add_occupied((0..10).map(|_| point(0.5 * HAND_DEPTH_M)));
    assert_eq!(inside(&space), before, "gels give way");
    space.add_occupied((0..EMPTY).map(|_| point(2.0 * HAND_DEPTH_M)));
    let after = inside(&space);
    assert_eq!(after.len() + 1, before.len());
    assert!(!after.contains(&middle));
    space.add_occupied(std::iter::once(Occupied { point: Vec3::splat(9.0), depth_m: 1.0 }));
}

#[test]
fn rays_through_a_cube() {
    let random =
        |i: u32, k: u32| (i.wrapping_mul(2_654_435_761).wrapping_mul(2 * k + 1) >> 8) as f32 / (1 << 24) as f32 - 0.5;
    for i in 1..500u32 {
        let i = i.wrapping_mul(7919);
        let origin = Vec3::new(random(i, 1), random(i, 2), random(i, 3)) * 0.6;
        let direction = Vec3::new(random(i, 4), random(i, 5), random(i, 6)).normalize();
        let clipped = clip(origin, direction, HALF_M);
        // By brute force.
        let inside = |t: f32| (origin + direction * t).abs().max_element() < HALF_M;
        let steps: Vec<f32> = (0..20_000).map(|k| k as f32 * 5e-5).filter(|&t| inside(t)).collect();
        match (clipped, steps.first(), steps.last()) {
            (Some((enter, leave)), Some(first), Some(last)) => {
                assert!((enter.max(0.0) - first).abs() < 2e-4 && (leave - last).abs() < 2e-4);
            }
            (Some((enter, leave)), ..) => assert!(leave - enter.max(0.0) < 2e-4),
            (None, first, _) => assert!(first.is_none()),
        }
    }
    // Along an axis, where a reciprocal is infinite.
    let (enter, leave) = clip(Vec3::new(0.3, 0.0, 0.0), Vec3::NEG_X, 0.1).unwrap();
    assert!((enter - 0.2).abs() < 1e-6 && (leave - 0.4).abs() < 1e-6);
    assert_eq!(clip(Vec3::new(0.3, 0.2, 0.0), Vec3::NEG_X, 0.1), None);
}

#[test]
fn what_was_looked_through_is_empty_and_what_was_not_is_unknown() {
    let space = looked_at(Solid::Ball(0.03), &[0.0]);
    assert!(space.is_seen_empty(to_camera() * 0.05), "between camera and ball");
    assert!(!space.is_seen_empty(to_camera() * 0.03), "on the ball");
    assert!(!space.is_seen_empty(-to_camera() * 0.05), "behind the ball");
    assert!(!space.is_seen_empty(Vec3::splat(1.0)), "outside the box");
}

#[test]
fn a_cavity_that_was_looked_into_continues_where_nothing_was_seen() {
    // A cup of 40 mm by formula: floor and walls were seen, the upper half of its inside was looked through, the lower half was not seen.
    let mut space = Space::new(HALF_M);
    let steps = |k: i32| 0.002 * k as f32;
    for (a, b) in (-10..=10).flat_map(|a| (-10..=10).map(move |b| (steps(a), steps(b)))) {
        let walls = [[a, b, -0.02], [0.02, a, b], [-0.02, a, b], [a, 0.02, b], [a, -0.02, b]];
        (0..SEEN).for_each(|_| walls.iter().for_each(|p| space.add_hit(Vec3::from_array(*p))));
    }
    let deep = Vec3::new(0.0, 0.0, -0.006);
    let is_inside = |space: &Space| inside(space).iter().any(|cell| cell.centre.distance(deep) < 0.003);
    assert!(is_inside(&space), "what was never looked into counts as solid");
    for cell in cells() {
        let p = space.centre(cell);
        if p.x.abs() < 0.015 && p.y.abs() < 0.015 && p.z > 0.0 {
            space.passes[flatten(cell)] = EMPTY;
        }
    }
    assert!(space.is_seen_empty(Vec3::new(0.0, 0.0, 0.005)));
    assert!(!is_inside(&space), "what continues a cavity does not");
}

/// A cup of 40 mm by formula: walls `wall_m` thick were seen from both sides, floor and foot were not, and its inside was looked through
/// down to the middle.
fn cup(wall_m: f32) -> Space {
    let mut space = Space::new(HALF_M);
    let steps = |k: i32| 0.002 * k as f32;
    for (a, b) in (-10..=10).flat_map(|a| (-10..=10).map(move |b| (steps(a), steps(b)))) {
        for (x, reach) in [(0.02, 0.02), (0.02 - wall_m, 0.02 - wall_m)] {
            let a = a * reach / 0.02;
            let walls = [[x, a, b], [-x, a, b], [a, x, b], [a, -x, b]];
            (0..SEEN).for_each(|_| walls.iter().for_each(|p| space.add_hit(Vec3::from_array(*p))));
        }
    }
    for cell in cells() {
        let p = space.centre(cell);
        let across = p.x.abs().max(p.y.abs());
        let [clear, outer] = [0.02 - wall_m - 0.003, 0.023];
        if across > outer || p.z > 0.023 || (across < clear && p.z > 0.0) {
            space.passes[flatten(cell)] = EMPTY;
        }
    }
    space
}

#[test]
fn of_a_cup_with_thin_walls_the_unseen_inside_is_air_and_the_foot_is_closed() {
    let space = cup(0.002);
    let at = |p: Vec3| {
        space.unseen().iter().find(|cell| (p - cell.centre).abs().max_element() <= 0.0012).map(|cell| cell.assumed)
    };
    let [deep, foot] = [Vec3::new(0.0, 0.0, -0.008), Vec3::new(0.003, -0.004, -0.0185)];
    assert_eq!([at(deep), at(foot)], [Some(Assumed::Air), Some(Assumed::Wall)]);
    assert_eq!(at(Vec3::new(0.0, 0.0, 0.01)), None, "it was looked through");
    // Up to the walls.
    assert!((-5..=5).all(|k| at(Vec3::new(0.0023 * k as f32, 0.0, -0.0185)) == Some(Assumed::Wall)));
    assert!(space.frontier().iter().any(|patch| patch.normal.z < -0.7), "nobody saw the foot");
}

#[test]
fn a_pit_in_a_solid_does_not_make_it_thin_walled() {
    // Its walls are 14 mm thick: nothing is known below the pit.
    let space = cup(0.014);
    assert!(!space.seen_cavity(&space.depths_m()).is_empty(), "the pit is a cavity");
    assert!(space.unseen().iter().all(|cell| cell.assumed == Assumed::Inside));
}

#[test]
fn the_frontier_is_the_side_that_was_not_seen() {
    let space = looked_at(BRICK, &[0.0, 60.0, 120.0, 180.0, 240.0, 300.0]);
    let patches = space.frontier();
    let [low, high] = BRICK.bounds();
    let bottom_m2 = (high.x - low.x) * (high.y - low.y);
    let down: Vec<&FrontierPatch> = patches.iter().filter(|patch| patch.normal.z < -0.7).collect();
    let (all_m2, down_m2) = (area_m2(&patches), down.iter().map(|patch| patch.area_m2).sum::<f32>());
    assert!((0.6..1.1).contains(&(down_m2 / bottom_m2)), "{down_m2} of {bottom_m2} m^2");
    assert!(down_m2 > 0.8 * all_m2, "the rest was seen: {down_m2} of {all_m2} m^2");
    for patch in down {
        assert!((patch.centre.z - low.z).abs() < 0.005, "{patch:?}");
        assert!((patch.normal.length() - 1.0).abs() < 1e-5);
    }
    // Half a view leaves more, and nothing is known before the first.
    assert!(area_m2(&looked_at(BRICK, &[0.0]).frontier()) > 1.2 * all_m2);
    assert!(Space::new(HALF_M).frontier().is_empty());
}

fn area_m2(patches: &[FrontierPatch]) -> f32 {
    patches.iter().map(|patch| patch.area_m2).sum()
}

#[test]
fn depths_of_cells_are_those_of_their_centres() {
    let space = looked_at(Solid::Ball(0.03), &[0.0, 60.0, 120.0]);
    let depths_m = space.depths_m();
    let mut inside = 0;
    for cell in cells() {
        let depth_m = Some(depths_m[flatten(cell)]).filter(|&depth_m| depth_m > -HULL_MARGIN_M);
        assert_eq!(depth_m, space.depth_m(space.centre(cell)), "{cell}");
        inside += usize::from(depth_m.is_some());
    }
    assert!(inside > 1000, "{inside}");
}
