use mvt_frames::ndarray::Array2;
use mvt_robot::hand::{Hand, Side};
use mvt_robot::rig::Placement;
use mvt_slam::SlamConfig;

use super::*;

const FRAME_S: f64 = 1.0 / 30.0;

fn options() -> Vec<ExplorerOption> {
    let option = |name: &str, axis| ExplorerOption { name: name.to_owned(), axis, rate_rad_s: 0.8 };
    let (x, y, z) = (na::Vector3::x(), na::Vector3::y(), na::Vector3::z());
    vec![option("cubelet", z), option("tumble_back", -y), option("roll_ball", x)]
}

/// A square of unseen surface, 4 x 4 cm, around `centre`.
#[derive(Debug)]
struct Unseen {
    centre: Vec3,
    normal: Vec3,
}

impl UnknownSurface for Unseen {
    fn patches(&self, _: &Map) -> Vec<FrontierPatch> {
        let (across, along) = self.normal.any_orthonormal_pair();
        let at = |k: usize| (k as f32 - 9.5) * 0.002;
        let patch = |k: usize| FrontierPatch {
            centre: self.centre + across * at(k % 20) + along * at(k / 20),
            normal: self.normal,
            area_m2: 4e-6,
        };
        (0..400).map(patch).collect()
    }
}

fn map() -> Map {
    let SlamConfig { map, field, .. } = SlamConfig::default();
    Map::new(map, &field, mvt_slam::Obstacles::default(), 1).unwrap()
}

/// The image of camera `side`: one label everywhere, as near as `depth_m`.
fn percept(label: Label, depth_m: f32) -> Percept {
    let camera = Placement::parse_list("side").unwrap().remove(0).camera(&Hand::allegro(Side::Left));
    let size = (camera.intrinsics.height, camera.intrinsics.width);
    let depth = CameraDepth {
        intrinsics: camera.intrinsics,
        world_from_camera: camera.pose,
        depth_m: Array2::from_elem(size, depth_m),
        labels: Array2::from_elem(size, label),
        colour: None,
    };
    Percept {
        time_s: 0.0,
        joints: vec![0.0; 16],
        cameras: vec![Some(depth)],
        touch: Hand::allegro(Side::Left).per_pad(|_| None),
    }
}

fn belief(time_s: f64, turned_rad: na::Vector3<f64>) -> Belief {
    Belief {
        time_s,
        pose: Isometry::translation(-0.03, 0.0, 0.05),
        centre_m: [-0.03, 0.0],
        turned_rad,
        confidence: 0.9,
        deviation_m: 0.001,
        lost: false,
        unobserved: 0.2,
    }
}

/// Returns the directives with their times, while the object turns about the axis of the present controller.
fn watch(mut explorer: Explorer, percept: &Percept, seconds: f64) -> (Vec<(f64, Directive)>, Vec<ExplorerChoice>) {
    let (map, mut turned) = (map(), na::Vector3::zeros());
    let (mut directives, mut choices) = (Vec::new(), Vec::new());
    for k in 0..(seconds / FRAME_S) as usize {
        let belief = belief(k as f64 * FRAME_S, turned);
        let hand = Hand::allegro(Side::Left);
        let outlook = Outlook::new(&map, belief.pose, percept, &hand);
        let directive = explorer.decide(&belief, &outlook);
        directives.extend(directive.map(|directive| (belief.time_s, directive)));
        choices.extend(explorer.take_choice());
        turned += explorer.options[explorer.current].axis * (0.8 * FRAME_S);
    }
    (directives, choices)
}

fn unseen(centre: [f32; 3], normal: Vec3) -> ExploreStrategy {
    ExploreStrategy::Surface(Arc::new(Unseen { centre: Vec3::from(centre), normal }))
}

/// From the object to the camera.
fn to_camera() -> na::Vector3<f64> {
    let camera = Placement::parse_list("side").unwrap().remove(0).camera(&Hand::allegro(Side::Left));
    camera.pose.origin().coords() - na::Vector3::new(-0.03, 0.0, 0.05)
}

/// An unseen side that faces the camera after a turn by this angle about z.
fn side_before(turn_rad: f32) -> ExploreStrategy {
    let across = Vec3::from(to_camera().map(|v| v as f32).data.0[0]).with_z(0.0).normalize();
    let normal = glam::Quat::from_rotation_z(-turn_rad) * across;
    unseen((normal * 0.03).to_array(), normal)
}

fn clear() -> Percept {
    percept(Label::Background, 0.0)
}

#[test]
fn the_axis_that_shows_the_unseen_side_is_chosen() {
    let to_camera = to_camera();
    let bottom = unseen([0.0, 0.0, -0.03], Vec3::NEG_Z);
    let (directives, choices) = watch(Explorer::new(options(), bottom, false), &clear(), PART_S + 1.0);
    let (first_s, directive) = &directives[0];
    assert!((PART_S..PART_S + LOOK_S).contains(first_s), "{first_s}");
    assert_ne!(*directive, Directive::Regrasp);
    let ExplorerChoice { chosen, gains_cm2_s, .. } = &choices[0];
    assert_eq!(*directive, Directive::ChangeController(chosen.clone()));
    assert_eq!(gains_cm2_s["cubelet"], 0.0, "a turn about z never shows the bottom: {gains_cm2_s:?}");
    // A turn by a right angle about each axis: which one turns the bottom most towards the camera?
    let shows = |axis: na::Vector3<f64>| {
        let turns = (0..100).map(|k| na::UnitQuaternion::new(axis * (0.0167 * f64::from(k))));
        turns.map(|turn| (turn * -na::Vector3::z()).dot(&to_camera)).fold(f64::NEG_INFINITY, f64::max)
    };
    let best = options().into_iter().max_by(|a, b| shows(a.axis).total_cmp(&shows(b.axis))).unwrap();
    assert_eq!(*chosen, best.name, "{gains_cm2_s:?}");
    // The far side comes into view by the present turn, which costs no change.
    let far = side_before(std::f32::consts::PI);
    let (directives, _) = watch(Explorer::new(options(), far, false), &clear(), PART_S + 0.6);
    assert_eq!(directives, []);
}

#[test]
fn what_the_hand_hides_is_no_gain() {
    let bottom = || unseen([0.0, 0.0, -0.03], Vec3::NEG_Z);
    let hidden = percept(Label::Hand, 0.1);
    let (directives, choices) = watch(Explorer::new(options(), bottom(), true), &hidden, PART_S + 1.0);
    assert_eq!(directives[0].1, Directive::Stop);
    assert_eq!(choices[0].chosen, NONE);
    assert!(choices[0].gains_cm2_s.values().all(|&gain| gain == 0.0), "{:?}", choices[0]);
    // Without such a goal the hand goes on.
    assert_eq!(watch(Explorer::new(options(), bottom(), false), &hidden, PART_S + 1.0).0, []);
    // A hand behind the object hides nothing.
    let behind = percept(Label::Hand, 2.0);
    assert_ne!(watch(Explorer::new(options(), bottom(), true), &behind, PART_S + 1.0).0, []);
}

#[test]
fn a_controller_that_does_not_keep_its_promises_is_left() {
    // The map never learns a side that comes into view at once.
    let explorer = || Explorer::new(options(), side_before(1.8), true);
    let (directives, choices) = watch(explorer(), &clear(), 20.0);
    assert!(directives.first().is_some_and(|(time_s, _)| *time_s > PART_S + LOOK_S), "{directives:?}");
    assert_ne!(choices[0].chosen, "cubelet");
    assert_eq!(watch(explorer(), &clear(), 20.0), (directives, choices), "the same again");
}

#[test]
fn rates_are_learnt_at_the_end_of_a_part() {
    let mut explorer = Explorer::new(options(), ExploreStrategy::Frontier, false);
    explorer.turning = Some((0.0, na::Vector3::zeros()));
    // It should have turned at 0.8 rad/s, and did not turn.
    explorer.begin_part(&belief(5.0, na::Vector3::zeros()));
    assert!((explorer.options[0].rate_rad_s - 0.4).abs() < 1e-12);
    // A part that is too short teaches nothing.
    explorer.turning = Some((5.0, na::Vector3::zeros()));
    explorer.begin_part(&belief(5.5, na::Vector3::zeros()));
    assert!((explorer.options[0].rate_rad_s - 0.4).abs() < 1e-12);
}

#[test]
fn turns_and_chances_ignore_the_estimate() {
    let names = |strategy: ExploreStrategy| -> Vec<(f64, Directive)> {
        watch(Explorer::new(options(), strategy, true), &clear(), 40.0).0
    };
    let change = |name: &str| Directive::ChangeController(name.to_owned());
    let (times, turns): (Vec<f64>, Vec<Directive>) = names(ExploreStrategy::RoundRobin).into_iter().unzip();
    assert_eq!(turns[..4], ["tumble_back", "roll_ball", "cubelet", "tumble_back"].map(change));
    assert!(times.windows(2).all(|pair| (pair[1] - pair[0] - TURN_S).abs() < 2.0 * FRAME_S), "{times:?}");
    assert_eq!(names(ExploreStrategy::Random(3)), names(ExploreStrategy::Random(3)));
    assert_ne!(names(ExploreStrategy::Random(3)), names(ExploreStrategy::Random(4)));
    // Nothing is known yet, and a single controller has no other.
    let single = Explorer::new(options()[..1].to_vec(), ExploreStrategy::RoundRobin, false);
    assert_eq!(watch(single, &clear(), 20.0).0, []);
    assert_eq!(watch(Explorer::new(options(), ExploreStrategy::Frontier, true), &clear(), 5.0).0[0].1, Directive::Stop);
}
