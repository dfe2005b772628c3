//! Controllers: by name, as files, tuned and scored.

use serde_json::Value;

use crate::workplace::{Ended, Workplace};

/// A search that takes a second.
const TUNE: &str = "hand tune --object cube70 --axis -y --generations 1 --starts 1 --duration 0.5 --scored-starts 1";

#[test]
fn a_cube_tumbles_and_the_old_option_does_the_same() {
    let workplace = Workplace::new();
    let simulate = |option: &str| -> Value {
        let line = format!("simulate --json --object cube70 --duration 8 --seed 5 {option} tumble_back");
        workplace.run(&line).json()
    };
    let outcome = simulate("--controller");
    assert_eq!(outcome["gait"], "tumble_back");
    assert!(outcome["turned_rad"].as_f64().unwrap() > 6.0, "{outcome}");
    assert_eq!(outcome, simulate("--gait"));
}

#[test]
fn controllers_are_listed_with_axis_and_objects() {
    let list = Workplace::new().run("controllers").good();
    let line = list.lines().find(|line| line.starts_with("tumble_back ")).unwrap();
    assert!(line.contains(" -y ") && line.contains("077_rubiks_cube"), "{line}");
    assert!(list.lines().any(|line| line.starts_with("bal ") && line.contains(" -z ")), "{list}");
}

#[test]
fn a_tuned_controller_is_a_file_that_other_commands_play() {
    let workplace = Workplace::new();
    let said = workplace.run(&format!("{TUNE} --out tuned.toml")).good();
    assert!(said.contains("starts alive") && said.contains("about -y"), "{said}");
    assert!(!workplace.path("tuned.toml.state").exists());
    assert!(workplace.run(&format!("{TUNE} --out tuned.toml")).error().contains("tuned.toml"));
    let again = workplace.run(&format!("{TUNE} --out again.toml")).good();
    assert_eq!(said.replace("tuned", "again"), again);
    let text = workplace.text("tuned.toml");
    assert_eq!(text, workplace.text("again.toml"));
    assert!(text.contains("made by `mambavitact hand tune --object cube70 --axis -y"), "{text}");

    workplace.run("simulate --object cube70 --duration 1 --controller tuned.toml").good();
    let score = workplace.run("hand score --object cube70 --controller tuned.toml --scored-starts 1 --json").json();
    assert_eq!((&score["axis"], &score["starts"]), (&Value::from("-y"), &Value::from(1)));
    // An object of another size is played with a warning.
    let warning = workplace.run("simulate --object large_dice --duration 0.2 --controller tuned.toml").warned();
    assert!(warning.contains("may fall"), "{warning}");
}

#[test]
fn controllers_that_do_not_fit_are_refused() {
    let workplace = Workplace::new();
    workplace.run(&format!("{TUNE} --out good.toml")).good();
    let text = workplace.text("good.toml");
    let refusal = |from: &str, to: &str| {
        assert!(text.contains(from), "{from}");
        workplace.write("bad.toml", text.replacen(from, to, 1));
        workplace.run("simulate --object cube70 --controller bad.toml").error()
    };
    assert!(refusal("rate_hz = 25", "rate_hz = 50").contains("takes 25"));
    assert!(refusal("allegro_digit", "leap").contains("allegro_digit"));
    assert!(refusal("model = \"", "model = \"0").contains("tune it again"));
    assert!(refusal("[\"left\", \"right\"]", "[\"right\"]").contains("--side right"));
    assert!(refusal("period_s = ", "period_s = nan # ").contains("not finite"));
    assert!(refusal("kind = \"gait\"", "kind = \"network\"").contains("not a controller"));
    assert!(workplace.run("simulate --object cube70 --controller none.toml").error().contains("none.toml"));
}

#[test]
fn controllers_follow_one_another_on_a_schedule() {
    let workplace = Workplace::new();
    let simulate = |controller: &str| {
        workplace.run(&format!("simulate --json --object cube70 --duration 8 --controller {controller}"))
    };
    let outcome = simulate("tumble_back:4,cubelet:4").json();
    assert_eq!((&outcome["gait"], &outcome["survived_s"]), (&"tumble_back:4,cubelet:4".into(), &8.0.into()));
    for wrong in ["tumble_back:8,cubelet", "tumble_back:1,cubelet:8", "tumble_back:8,cubelet:x"] {
        assert!(simulate(wrong).error().contains("such as tumble_back:8,cubelet:8"));
    }
    assert!(simulate("tumble_back:8,gallop:8").error().contains("gallop"));
}

#[test]
fn an_object_that_may_fall_is_refused_unless_a_controller_is_named() {
    let workplace = Workplace::new();
    // A pole of 210 mm.
    let corners = (0..8).map(|k| {
        format!("v {} {} {}\n", 0.04 * f64::from(k & 1), 0.04 * f64::from(k >> 1 & 1), 0.21 * f64::from(k >> 2))
    });
    let faces = ["1 5 7 3", "2 4 8 6", "1 2 6 5", "3 7 8 4", "1 3 4 2", "5 6 8 7"].map(|face| format!("f {face}\n"));
    workplace.write("pole.obj", corners.chain(faces).collect::<String>());
    let error = workplace.run("simulate --object pole.obj --duration 0.2");
    assert_eq!(error.code, Some(1));
    let error = error.stderr;
    assert!(error.contains("too long: 210 mm, at most 195; the nearest object that fits is"), "{error}");
    assert!(error.contains("--controller shared"), "{error}");
    workplace.run("simulate --object pole.obj --duration 0.2 --controller shared").warned();
}

#[test]
fn a_survey_plays_only_what_its_file_lacks() {
    let workplace = Workplace::new();
    let survey = |controllers: &str| {
        workplace
            .run(&format!("hand survey --object cube70 --starts 1 --out survey.jsonl --controller {controllers}"))
            .good()
    };
    assert!(survey("tumble_back").contains("1 of 1 objects turn"));
    let first = workplace.text("survey.jsonl");
    survey("tumble_back,box");
    let both = workplace.text("survey.jsonl");
    assert!(both.starts_with(&first) && both.lines().count() == 2, "{both}");
    let row: Value = serde_json::from_str(first.trim()).unwrap();
    assert!(
        row["net_rad"][0][1].as_f64().unwrap() < -6.0 && row["shape"]["mass_g"].as_f64().unwrap().round() == 200.0,
        "{row}"
    );
    workplace.write("survey.jsonl", "turned");
    assert!(workplace.run("hand survey --object cube70 --out survey.jsonl").error().contains("give another --out"));
}

#[test]
fn a_ball_is_held_in_the_air_by_its_place() {
    let workplace = Workplace::new();
    let outcome = workplace.run("simulate --json --object ball --duration 4 --seed 1 --controller air_ball").json();
    let air = &outcome["in_air"];
    assert!(air["least_height_mm"].as_f64().unwrap() >= 30.0, "{air}");
    assert_eq!((&air["lowered_at_s"], air["net_rad"].as_array().unwrap().len()), (&Value::Null, 3));
    let said = workplace.run("simulate --object ball --duration 2 --seed 1 --controller air_ball").good();
    assert!(said.contains("in the air it was at least"), "{said}");
    assert_eq!(workplace.run("simulate --json --object ball --duration 0.5").json().get("in_air"), None);
    let line =
        workplace.run("controllers").good().lines().find(|line| line.starts_with("air_ball ")).map(str::to_owned);
    assert!(line.is_some_and(|line| line.contains(" -x ")));
    let refused = workplace.run("simulate --object ball --controller cubelet:8,air_ball:8").error();
    assert!(refused.contains("play it alone"), "{refused}");
}

#[test]
fn grasps_are_a_file_from_which_a_controller_is_tuned() {
    let workplace = Workplace::new();
    // The ball has a grasp among these tries; the result is the same for any number of threads.
    let grasps = |out: &str, threads: &str| {
        let command = format!("hand grasps --object ball --tries 60 --out {out}");
        Ended::of(workplace.command(&command).env("RAYON_NUM_THREADS", threads)).good()
    };
    let said = grasps("one.toml", "1");
    assert!(said.contains("of 60 tries fingertips can carry ball"), "{said}");
    grasps("two.toml", "2");
    assert_eq!(workplace.text("one.toml"), workplace.text("two.toml"));
    let tune = |options: &str| {
        let command = "hand tune --generations 1 --starts 1 --duration 0.5 --scored-starts 1";
        workplace.run(&format!("{command} --grasp one.toml --out air.toml {options}"))
    };
    tune("--object ball --axis -x --from air_ball").good();
    assert!(["--grasp one.toml", "touching = ["].iter().all(|part| workplace.text("air.toml").contains(part)));
    let refused = tune("--object ball --axis -x --from air_ball --overwrite --only lift_,tilt").error();
    assert!(refused.contains("--only tilt: air_ball has no parameter"), "{refused}");
    assert!(tune("--object mug --axis -x --from air_ball --overwrite").error().contains("has grasps of ball"));
    assert!(tune("--object ball --axis -x --from tumble_back --overwrite").error().contains("such as air_ball"));
    let refused = workplace.run("hand grasps --object ball --controller bal --out none.toml").error();
    assert!(refused.contains("such as air_ball"), "{refused}");
}

#[test]
fn the_speed_of_the_search_is_compared_with_mujoco_alone() {
    let workplace = Workplace::new();
    let speed = workplace.run("hand speed --object cube70 --starts 1 --rounds 1 --json").json();
    let per_s = |key: &str| speed[key].as_f64().unwrap();
    assert!(per_s("search_steps_per_s") > 0.0 && per_s("bare_steps_per_s") > 0.0, "{speed}");
    // A trial of 10 s has 250 commands of 6 steps, unless the object falls.
    assert!((6..=1500).contains(&speed["steps"].as_u64().unwrap()), "{speed}");
    let said = workplace.run("hand speed --object cube70 --starts 1 --rounds 1").good();
    assert!(said.contains("MuJoCo alone"), "{said}");
    workplace.run("hand speed --starts 0").usage();
    assert!(workplace.run("hand speed --controller nothing --starts 1 --rounds 1").error().contains("nothing"));
    let refused = workplace.run("hand speed --object ball --controller air_ball --starts 1 --rounds 1").error();
    assert!(refused.contains("on the palm"), "{refused}");
}
