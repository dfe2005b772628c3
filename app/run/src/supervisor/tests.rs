use mvt_frames::Isometry;

use super::*;

const GAITS: [&str; 3] = ["cubelet", "shared", "bal"];
const FRAME_S: f64 = 1.0 / 30.0;

/// An object that stays in its place, turns at the right rate and is observed more and more.
fn turning(time_s: f64) -> Belief {
    let yaw = 0.8 * time_s;
    Belief {
        time_s,
        pose: Isometry::from_parts([0.0, 0.0, 0.05], [(yaw / 2.0).cos(), 0.0, 0.0, (yaw / 2.0).sin()]),
        centre_m: [-0.02, 0.01],
        turned_rad: Vector3::z() * yaw,
        confidence: 0.9,
        deviation_m: 0.001,
        lost: false,
        unobserved: (-time_s / 20.0).exp(),
    }
}

/// Returns all directives but `Continue` with their times.
fn watch(goal: Goal, seconds: f64, believe: impl Fn(f64) -> Belief) -> Vec<(f64, Directive)> {
    let mut supervisor = Supervisor::new(goal, Vector3::z(), &GAITS, SupervisorRules::default());
    let times = (0..(seconds / FRAME_S) as usize).map(|k| k as f64 * FRAME_S);
    times
        .map(|time_s| (time_s, supervisor.decide(&believe(time_s))))
        .filter(|(_, directive)| *directive != Directive::Continue)
        .collect()
}

fn first(directives: &[(f64, Directive)], about_s: f64) -> Directive {
    assert!((directives[0].0 - about_s).abs() < 2.5 * FRAME_S, "{:?}", directives[0]);
    directives[0].1.clone()
}

#[test]
fn a_goal_orientation_is_held_and_then_ends_the_episode() {
    // The object turns until the fingers hold it.
    let side = Placement::parse_list("side").unwrap().remove(0);
    let show = |text: &str| text.parse::<Goal>().unwrap().facing(TurnAxis::PlusZ, &side);
    // The camera `side` is at an azimuth of 90 degrees.
    for (goal, at_rad) in
        [(Goal::Pose(1.5), 1.5), (show("show=30/20"), TAU / 6.0), (show("show=150/-10"), TAU * 5.0 / 6.0)]
    {
        let mut supervisor = Supervisor::new(goal, Vector3::z(), &GAITS, SupervisorRules::default());
        let (mut yaw, mut held, mut stopped_s) = (0.0_f64, 0, None);
        for k in 0..600 {
            let time_s = f64::from(k) * FRAME_S;
            let pose = Isometry::from_parts([0.0, 0.0, 0.05], [(yaw / 2.0).cos(), 0.0, 0.0, (yaw / 2.0).sin()]);
            match supervisor.decide(&Belief { pose, ..turning(time_s) }) {
                Directive::Hold => held += 1,
                Directive::Stop => stopped_s = stopped_s.or(Some(time_s)),
                _ => yaw += 0.8 * FRAME_S,
            }
            if stopped_s.is_some() {
                break;
            }
        }
        assert!((yaw - at_rad).abs() < 0.2, "{goal}: {yaw}");
        assert!((58..=62).contains(&held) && stopped_s.is_some(), "{goal}: {held}");
    }
}

#[test]
fn an_object_that_leaves_its_goal_is_turned_on() {
    let mut supervisor = Supervisor::new(Goal::Pose(1.0), Vector3::z(), &GAITS, SupervisorRules::default());
    let mut directives = Vec::new();
    for (k, yaw) in [0.0_f64, 0.9, 1.1, 1.3, 1.5].into_iter().enumerate() {
        let pose = Isometry::from_parts([0.0, 0.0, 0.05], [(yaw / 2.0).cos(), 0.0, 0.0, (yaw / 2.0).sin()]);
        directives.push(supervisor.decide(&Belief { pose, ..turning(k as f64 * FRAME_S) }));
    }
    let [hold, go] = [Directive::Hold, Directive::Continue];
    assert_eq!(directives, [go.clone(), hold.clone(), hold, go.clone(), go]);
    // An estimate that is not trusted holds nothing.
    let mut supervisor = Supervisor::new(Goal::Pose(1e-3), Vector3::z(), &GAITS, SupervisorRules::default());
    assert_eq!(supervisor.decide(&Belief { confidence: 0.3, ..turning(0.0) }), Directive::Continue);
}

#[test]
fn goals() {
    let parse = |text: &str| text.parse::<Goal>();
    assert_eq!(parse("turn=360deg"), Ok(Goal::Turn(TAU)));
    assert_eq!(parse("turn=2rev"), Ok(Goal::Turn(2.0 * TAU)));
    assert_eq!(parse("turn=1.5rad"), Ok(Goal::Turn(1.5)));
    assert_eq!(parse("coverage=0.9"), Ok(Goal::Coverage(0.9)));
    assert_eq!(parse("pose=90deg"), Ok(Goal::Pose(TAU / 4.0)));
    assert_eq!(parse("show=180/-30").unwrap().to_string(), "show=180/-30");
    assert_eq!(parse("time"), Ok(Goal::Time));
    assert_eq!(parse("explored").map(|goal| goal.to_string()), Ok("explored".to_owned()));
    for text in ["show=180", "show=0/91", "show=NaN/0", "show=side"] {
        assert_eq!(parse(text), Err(GoalError::Side(text.to_owned())));
    }
    for text in
        ["pose=90", "turn=360", "turn=-1rev", "turn=deg", "turn=NaNdeg", "turn=infrad", "coverage=1.1", "coverage=0"]
    {
        assert_eq!(parse(text), Err(GoalError::Amount(text.to_owned())));
    }
    for text in ["", "spin=3rev", "time=3", "turn", "Time"] {
        let error = parse(text).unwrap_err().to_string();
        assert!(error.contains("the goals are turn=360deg") && error.contains("explored and time"), "{error}");
    }
}

#[test]
fn an_episode_that_goes_well_is_left_alone() {
    assert_eq!(watch(Goal::Time, 40.0, turning), []);
}

#[test]
fn stops_at_the_goal() {
    assert_eq!(first(&watch(Goal::Turn(TAU), 20.0, turning), TAU / 0.8), Directive::Stop);
    assert_eq!(first(&watch(Goal::Coverage(0.5), 20.0, turning), 20.0 * 2f64.ln()), Directive::Stop);
    // A guess does not end the episode.
    let unsure = |time_s| Belief { confidence: 0.4, ..turning(time_s) };
    assert_eq!(watch(Goal::Turn(TAU), 20.0, unsure), []);
    let drifted = |time_s| Belief { deviation_m: 0.006, ..turning(time_s) };
    assert_eq!(watch(Goal::Turn(TAU), 20.0, drifted), []);
    let lost = |time_s| Belief { lost: time_s > 5.0, ..turning(time_s) };
    assert!(watch(Goal::Turn(TAU), 20.0, lost).iter().all(|(_, d)| *d == Directive::Regrasp));
}

#[test]
fn regrasps_when_lost_for_long_and_not_all_the_time() {
    let lost = |from: f64, to: f64| move |time_s| Belief { lost: (from..to).contains(&time_s), ..turning(time_s) };
    assert_eq!(watch(Goal::Time, 20.0, lost(5.0, 5.9)), []);
    let directives = watch(Goal::Time, 20.0, lost(5.0, 10.0));
    assert_eq!(first(&directives, 6.0), Directive::Regrasp);
    assert_eq!(directives.len(), 2, "again after it has settled: {directives:?}");
    assert!(directives[1].0 - directives[0].0 >= SupervisorRules::default().settle_s);
}

#[test]
fn regrasps_when_nothing_moves() {
    let stuck = |time_s: f64| Belief { time_s, ..turning(time_s.min(3.0)) };
    assert_eq!(first(&watch(Goal::Time, 9.0, stuck), 7.0), Directive::Regrasp);
    let rocking = |time_s: f64| Belief { pose: turning((4.0 * time_s).sin()).pose, ..turning(time_s) };
    assert_eq!(watch(Goal::Time, 20.0, rocking), []);
}

#[test]
fn pushes_a_drifted_object_until_it_is_back() {
    // 16 mm off from 2 s on, back by 4 s.
    let offset = |time_s: f64| match time_s {
        t if t < 2.0 => 0.0,
        t => (0.016 - 0.008 * (t - 2.0)).max(0.0),
    };
    let drifting = |time_s| Belief { centre_m: [-0.02, 0.01 + offset(time_s)], ..turning(time_s) };
    let directives = watch(Goal::Time, 12.0, drifting);
    let Directive::Recentre { offset_m } = first(&directives, 2.0) else { panic!("{:?}", directives[0]) };
    assert!(offset_m[0].abs() < 1e-12 && (offset_m[1] - 0.016).abs() < 1e-3, "{offset_m:?}");
    let (last, _) = directives[directives.len() - 1];
    assert!((last - 3.5).abs() < 2.0 * FRAME_S, "{last}");
    assert!(directives.iter().all(|(_, d)| matches!(d, Directive::Recentre { .. })));
}

#[test]
fn pushes_end_even_without_success() {
    let off = |time_s| Belief { centre_m: [if time_s > 3.0 { 0.0 } else { -0.02 }, 0.01], ..turning(time_s) };
    let pushes: Vec<f64> = watch(Goal::Time, 12.0, off).iter().map(|(time_s, _)| *time_s).collect();
    let pauses: Vec<f64> = pushes.windows(2).map(|w| w[1] - w[0]).filter(|gap| *gap > 2.0 * FRAME_S).collect();
    assert_eq!(pauses.len(), 1, "{pauses:?}");
    assert!((pauses[0] - SupervisorRules::default().settle_s).abs() < 3.0 * FRAME_S);
}

#[test]
fn tries_the_gaits_in_turn_when_turning_is_slow() {
    let slow = |time_s: f64| Belief { turned_rad: Vector3::z() * 0.1 * time_s, ..turning(time_s) };
    let directives = watch(Goal::Time, 26.0, slow);
    assert_eq!(first(&directives, 6.0), Directive::SwitchGait("shared".to_owned()));
    let names: Vec<Directive> = directives.iter().map(|(_, d)| d.clone()).collect();
    assert_eq!(names, ["shared", "bal", "cubelet", "shared"].map(|name| Directive::SwitchGait(name.to_owned())));
}

#[test]
fn tries_another_gait_when_nothing_new_is_seen_and_that_is_the_goal() {
    let blind = |time_s: f64| Belief { unobserved: turning(time_s.min(4.0)).unobserved, ..turning(time_s) };
    assert_eq!(watch(Goal::Time, 20.0, blind), []);
    assert_eq!(watch(Goal::Coverage(0.99), 11.0, blind)[0].1, Directive::SwitchGait("shared".to_owned()));
}

#[test]
fn broken_and_old_beliefs_change_nothing() {
    let mut supervisor = Supervisor::new(Goal::Turn(1.0), Vector3::z(), &GAITS, SupervisorRules::default());
    assert_eq!(supervisor.decide(&turning(1.0)), Directive::Continue);
    for broken in [
        Belief { turned_rad: Vector3::z() * f64::INFINITY, ..turning(1.1) },
        Belief { centre_m: [f64::NAN, 0.0], ..turning(2.0) },
        Belief { pose: Isometry::translation(f64::NAN, 0.0, 0.0), ..turning(2.0) },
        Belief { turned_rad: Vector3::z() * 2.0, ..turning(0.9) },
    ] {
        assert_eq!(supervisor.decide(&broken), Directive::Continue, "{broken:?}");
    }
    assert_eq!(supervisor.decide(&turning(2.0)), Directive::Stop);
}

#[test]
fn a_turn_about_another_axis_is_no_progress() {
    let mut supervisor = Supervisor::new(Goal::Turn(1.0), -Vector3::y(), &GAITS, SupervisorRules::default());
    let mut tumbled = supervisor.clone();
    for k in 0..150 {
        let belief = turning(f64::from(k) * FRAME_S);
        assert_eq!(supervisor.decide(&belief), Directive::Continue);
        let belief = Belief { turned_rad: -Vector3::y() * belief.turned_rad.norm(), ..belief };
        let stops = tumbled.decide(&belief) == Directive::Stop;
        assert_eq!(stops, belief.turned_rad.norm() >= 1.0);
    }
}

#[test]
fn a_single_gait_is_kept() {
    let mut supervisor = Supervisor::new(Goal::Time, Vector3::z(), &["bal"], SupervisorRules::default());
    for k in 0..600 {
        let belief = Belief { turned_rad: Vector3::zeros(), ..turning(f64::from(k) * FRAME_S) };
        assert_eq!(supervisor.decide(&belief), Directive::Continue);
    }
}
