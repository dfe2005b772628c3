//! Hand files and models with faults: each is one line that says what to do.

#![allow(clippy::unwrap_used, reason = "a failed assumption in a test is a failed test")]

use std::fs;
use std::path::{Path, PathBuf};

use mvt_hands::{HandFile, LoadedHand};
use tempfile::TempDir;

/// Copy of the test data that a test may spoil.
struct Copy {
    folder: TempDir,
}

impl Copy {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join("meshes")).unwrap();
        for name in ["pincer.toml", "pincer.xml", "claw.toml", "claw.urdf", "meshes/wedge.stl", "meshes/block.obj"] {
            fs::copy(Path::new("tests/data").join(name), folder.path().join(name)).unwrap();
        }
        Self { folder }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Replaces text in a file.
    fn replace(self, name: &str, from: &str, to: &str) -> Self {
        let text = fs::read_to_string(self.path(name)).unwrap();
        assert!(text.contains(from), "{name} has no {from:?}");
        fs::write(self.path(name), text.replacen(from, to, 1)).unwrap();
        self
    }

    /// Returns the message about a hand file, which must be one line. Nothing may have been written.
    #[track_caller]
    fn refused(self, name: &str) -> String {
        let before = self.listing();
        let message = HandFile::load(self.path(name)).unwrap_err().to_string();
        assert!(!message.contains('\n') && !message.ends_with('.'), "{message}");
        assert_eq!(self.listing(), before);
        // Without the folder, whose name is random.
        message.replace(&format!("{}/", self.folder.path().display()), "")
    }

    #[track_caller]
    fn loaded(&self, name: &str) -> LoadedHand {
        HandFile::load(self.path(name)).unwrap()
    }

    fn listing(&self) -> Vec<PathBuf> {
        let mut names: Vec<PathBuf> =
            fs::read_dir(self.folder.path()).unwrap().map(|entry| entry.unwrap().path()).collect();
        names.sort();
        names
    }
}

/// Fails unless a message contains all the words.
#[track_caller]
fn says(message: &str, words: &[&str]) {
    for words in words {
        assert!(message.contains(words), "{message:?} does not say {words:?}");
    }
}

/// Returns the warnings, joined.
#[track_caller]
fn warned(loaded: &LoadedHand, words: &str) {
    let one_line = |warning: &String| !warning.contains('\n');
    assert!(loaded.warnings.iter().all(one_line), "{:?}", loaded.warnings);
    assert!(loaded.warnings.iter().any(|warning| warning.contains(words)), "{words:?}: {:?}", loaded.warnings);
}

#[test]
fn the_file_itself() {
    says(&HandFile::load("nowhere.toml").unwrap_err().to_string(), &["cannot read nowhere.toml"]);
    let message = Copy::new().replace("claw.toml", "[grasp]", "[graps]").refused("claw.toml");
    says(&message, &["claw.toml, line 14: ", "unknown field `graps`, expected one of", "`grasp`"]);
    let message = Copy::new().replace("claw.toml", "side = \"left\"", "side = \"west\"").refused("claw.toml");
    says(&message, &["claw.toml, line 3: ", "west", "`left`"]);
    let message = Copy::new().replace("claw.toml", "claw.urdf", "claw.stl").refused("claw.toml");
    says(&message, &["claw.stl: the model of a hand is an MJCF (.xml) or a URDF (.urdf)"]);
    let message = Copy::new().replace("claw.toml", "claw.urdf", "claw.xacro").refused("claw.toml");
    says(&message, &["`xacro hand.xacro > hand.urdf`"]);
    let message = Copy::new().replace("claw.toml", "claw.urdf", "clam.urdf").refused("claw.toml");
    says(&message, &["clam.urdf: cannot be read: No such file"]);
}

#[test]
fn unknown_names_get_a_suggestion() {
    let claw = |from: &str, to: &str| Copy::new().replace("claw.toml", from, to).refused("claw.toml");
    says(
        &claw("\"a_bend\"]", "\"a_bent\"]"),
        &["finger a: there is no moving joint \"a_bent\"; did you mean \"a_bend\"?"],
    );
    says(&claw("[joint.a_bend]", "[joint.a_bnd]"), &["there is no joint \"a_bnd\"; did you mean \"a_bend\"?"]);
    says(&claw("link = \"a_end\"", "link = \"end\""), &["pad a: there is no link \"end\"; did you mean \"a_end\"?"]);
    says(
        &claw("gel = \"b_rubber\"", "gel = \"rubber\""),
        &["pad b: there is no shape \"rubber\"; did you mean \"b_rubber\"?"],
    );
    says(
        &claw("\"a_base\", ", "\"a_base\", \"b_out\", "),
        &["finger a: joint a_base does not carry joint b_out", "base to tip"],
    );
    says(&claw("link = \"base\"\npoint_m", "link = \"basis\"\npoint_m"), &["[grasp]: there is no link \"basis\""]);
    let pincer = |from: &str, to: &str| Copy::new().replace("pincer.toml", from, to).refused("pincer.toml");
    says(
        &pincer("site = \"left_pad\"", "site = \"left_pda\""),
        &["there is no site \"left_pda\"; did you mean \"left_pad\"?"],
    );
    says(
        &pincer("link = \"palm\"", "link = \"plam\""),
        &["[base] link: there is no link \"plam\"; did you mean \"palm\"?"],
    );
    says(
        &pincer("gelsight_mini", "gelsight_maxi"),
        &["pad right: there is no sensor profile \"gelsight_maxi\"", "gelsight_mini"],
    );
    says(
        &pincer("link = \"right_tip\"", "link = \"mount\""),
        &["pad right: there is no link \"mount\"; choose one of palm, "],
    );
    says(
        &pincer("link = \"right_tip\"", "link = \"right_tip\"\nsite = \"left_pad\""),
        &["write either `link` or `site`"],
    );
}

#[test]
fn profiles() {
    let own = "fov_y_deg = 40.0\nreach_mm = 0.5\n";
    let copy = || {
        let copy = Copy::new().replace("pincer.toml", "profile = \"gelsight_mini\"", "profile = \"own.toml\"");
        fs::write(copy.path("own.toml"), own).unwrap();
        copy
    };
    let own = copy();
    let hand = own.loaded("pincer.toml").hand;
    assert_eq!(hand.pads()[1].profile.fov_y_deg, 40.0);
    assert_eq!(hand.bodies()[hand.pads()[1].body].parts, hand.pads()[1].profile.body.parts(1));
    fs::write(own.path("own.toml"), "fov_y_deg = \"wide\"\n").unwrap();
    says(&own.refused("pincer.toml"), &["pad right: ", "own.toml is no sensor profile"]);
    let own = copy();
    fs::write(own.path("own.toml"), "size_px = [0, 0]\n").unwrap();
    says(&own.refused("pincer.toml"), &["pad right: ", "own.toml: size_px must be 2 numbers, each from 32 to 1024"]);
}

#[test]
fn urdf() {
    let claw = |from: &str, to: &str| Copy::new().replace("claw.urdf", from, to).refused("claw.toml");
    says(&claw("block.obj", "black.obj"), &["claw.urdf: link b_tip: the mesh meshes/black.obj is missing"]);
    says(
        &claw("meshes/wedge.stl", "mesh/wedge.stl"),
        &["package://claw_description/mesh/wedge.stl is missing", "beside the URDF"],
    );
    let dae = Copy::new().replace("claw.urdf", "block.obj", "block.dae");
    fs::write(dae.path("meshes/block.dae"), "<COLLADA/>").unwrap();
    says(&dae.refused("claw.toml"), &["link b_tip: meshes/block.dae is no STL, OBJ or PLY; convert it"]);
    let fault = "<parent link=\"b_slider\"/><child link=\"a_end\"/>";
    says(
        &claw("<parent link=\"b_slider\"/><child link=\"b_tip\"/>", fault),
        &["link a_end hangs on two joints, a_mark and b_bend", "no loops"],
    );
    let fault = "<parent link=\"a_tip\"/><child link=\"a_knuckle\"/>";
    says(
        &claw("<parent link=\"base\"/><child link=\"a_knuckle\"/>", fault),
        &["link a_knuckle hangs on itself", "no loops"],
    );
    says(
        &claw("<parent link=\"a_knuckle\"/>", "<parent link=\"knuckle\"/>"),
        &["joint a_bend: there is no link \"knuckle\"; did"],
    );
    says(
        &claw("lower=\"-1\" upper=\"1\" ", ""),
        &["claw.toml: joint b_bend has no limits; write `range = [lower, upper]` under [joint.b_bend]"],
    );
    says(
        &claw("lower=\"-1\" upper=\"1\" ", "lower=\"-60\" upper=\"60\" "),
        &["joint b_bend has the limits -60 and 60", "degrees"],
    );
    says(
        &claw("name=\"b_bend\" type=\"revolute\"", "name=\"b_bend\" type=\"planar\""),
        &["link b_tip moves by a planar joint", "split the link"],
    );
    says(&claw("<axis xyz=\"0 2 1\"/>", "<axis xyz=\"0 0 0\"/>"), &["joint a_base: its axis is zero"]);
    says(&claw("</joint>", "</jont>"), &["claw.urdf: it is no URDF: "]);
    says(&claw("<link name=\"a_end\"/>", "<link name=\"a_tip\"/>"), &["two links are named \"a_tip\""]);
    says(&claw(" scale=\"0.001 0.001 0.001\"", ""), &["claw.urdf: the hand spans ", " m at joint angles 0", "convert"]);
    let nested = format!("<robot name=\"deep\">{}", "<a>".repeat(100_000));
    let deep = Copy::new();
    fs::write(deep.path("claw.urdf"), nested).unwrap();
    says(&deep.refused("claw.toml"), &["nested more than 64 deep"]);
}

#[test]
fn a_joint_that_mimics_another_one_can_be_held() {
    let mimic = "<limit lower=\"-1\" upper=\"1\" effort=\"1\" velocity=\"3\"/><mimic joint=\"a_base\"/>";
    let copy =
        || Copy::new().replace("claw.urdf", "<limit lower=\"-1\" upper=\"1\" effort=\"1\" velocity=\"3\"/>", mimic);
    says(
        &copy().refused("claw.toml"),
        &["mimic in joint b_bend couples b_bend and a_base", "`held_at = 0.0` under [joint.b_bend]"],
    );
    let held = copy().replace("claw.toml", "\"b_out\", \"b_bend\"", "\"b_out\"").replace(
        "claw.toml",
        "[joint.a_bend]",
        "[joint.b_bend]\nheld_at = 0.0\n[joint.a_bend]",
    );
    assert_eq!(held.loaded("claw.toml").hand.joints().len(), 3);
    let listed = copy().replace("claw.toml", "\"b_out\", \"b_bend\"", "\"b_out\"").replace(
        "claw.toml",
        "palm_centre_m",
        "joints = [\"a_base\", \"a_bend\", \"b_out\"]\npalm_centre_m",
    );
    assert_eq!(listed.loaded("claw.toml").hand.joints().len(), 3);
}

#[test]
fn mjcf() {
    let pincer = |from: &str, to: &str| Copy::new().replace("pincer.xml", from, to).refused("pincer.toml");
    says(
        &pincer("<worldbody>", "<include file=\"more.xml\"/><worldbody>"),
        &["pincer.xml: MuJoCo cannot read", "more.xml"],
    );
    says(&pincer("wedge.stl", "wedges.stl"), &["pincer.xml: MuJoCo cannot read", "wedges.stl"]);
    let slide = "type=\"slide\" axis=\"0 0 2\" pos=\"0.001 0.002 0.003\" ref=\"0.005\" range=\"-0.01 0.02\"";
    says(&pincer(slide, "type=\"ball\""), &["link left_tip moves by a ball joint", "[joint.left_slide]"]);
    let two = "<joint name=\"second\" axis=\"0 0 1\" range=\"-1 1\"/><joint name=\"right_turn\"";
    says(&pincer("<joint name=\"right_turn\"", two), &["link right_tip moves by several joints", "split the link"]);
    says(&pincer("</mujoco>", ""), &["pincer.xml: MuJoCo cannot read"]);
    says(&pincer(" scale=\"0.001 0.001 0.001\"", ""), &["pincer.xml: the hand spans ", "convert"]);
}

#[test]
fn a_mjcf_with_visual_geoms_alone_is_used_with_a_warning() {
    let copy = Copy::new().replace(
        "pincer.xml",
        "<geom density=\"800\"/>",
        "<geom density=\"800\" contype=\"0\" conaffinity=\"0\"/>",
    );
    let copy = copy.replace("pincer.xml", "size=\"0.2\"", "size=\"0.02\"");
    let loaded = copy.loaded("pincer.toml");
    warned(&loaded, "no geom collides");
    assert_eq!(loaded.hand.bodies()[0].parts.len(), 3);
    let turned = Copy::new().replace("pincer.xml", "range=\"-0.5 1.5\"", "");
    let loaded = turned.loaded("pincer.toml");
    warned(&loaded, "joint right_turn has no limits");
    assert!((loaded.hand.ranges()[2][1] - std::f64::consts::TAU).abs() < 1e-12);
}

#[test]
fn pads_that_face_into_their_link_are_reported() {
    let copy = Copy::new()
        .replace("pincer.toml", "position_m = [0.04, 0.0, -0.012]", "position_m = [0.04, 0.0, 0.024]")
        .replace("pincer.toml", "[0.7071, 0.0, -0.7071, 0.0]\nprofile", "[0.7071, 0.0, 0.7071, 0.0]\nprofile")
        .replace("pincer.toml", "replaces = true", "");
    let loaded = copy.loaded("pincer.toml");
    warned(&loaded, "the gel of pad right faces into right_tip");
    warned(&loaded, "pad right lies in 1 shapes of link right_tip");
    let far =
        Copy::new().replace("pincer.toml", "position_m = [0.04, 0.0, -0.012]", "position_m = [0.04, 0.2, -0.012]");
    warned(&far.loaded("pincer.toml"), "pad right replaces no shape of link right_tip");
    let name = Copy::new().replace(
        "pincer.toml",
        "orientation_wxyz = [0.7071, 0.0, -0.7071, 0.0]",
        "orientation_wxyz = [1, 1, 0, 0]",
    );
    says(&name.refused("pincer.toml"), &["pad right: a place needs", "1.414"]);
}

#[test]
fn cameras() {
    let pincer = |from: &str, to: &str| Copy::new().replace("pincer.toml", from, to).refused("pincer.toml");
    says(
        &pincer("fx = 300.0\nlink = \"palm\"", "fx = 300.0\nlink = \"left_tip\""),
        &["camera \"wrist\": link left_tip moves"],
    );
    says(&pincer("elevation_deg = 70.0", ""), &["camera \"above\": its pose is position_m"]);
    says(&pincer("elevation_deg = 70.0", "elevation_deg = 95.0"), &["elevation_deg is between -90 and 90"]);
    says(&pincer("name = \"wrist\"", "name = \"above\""), &["another camera has this name"]);
    says(&pincer("name = \"wrist\"", "name = \"../up\""), &["camera \"../up\": a name has letters"]);
    says(&pincer("fx = 300.0", "fy = 300.0"), &["fy, cx and cy need fx"]);
    says(&pincer("width = 320", "width = 32000"), &["16 to 8192 pixels"]);
}
