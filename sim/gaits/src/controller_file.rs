//! Controllers as files: a gait, with or without feedback, with the hand, rate, objects and axis that it was made for.
//!
//! A file is TOML. A file that was made for another hand, rate or model is refused, because its motion would be another
//! one; the error says what differs.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use mvt_files::input;
use mvt_objects::object::Object;
use mvt_robot::digit::profile::SensorProfile;
use mvt_robot::hand::{Hand, Side};
use serde::{Deserialize, Serialize};

use crate::axis::TurnAxis;
use crate::clock::CONTROL_HZ;
use crate::controller::Controller;
use crate::gait::{self, Gait, UnknownGait, is_left_open};
use crate::schedule::{SHORTEST_PART_S, Schedule, ScheduledGait};
use crate::shape::ObjectShape;

/// Version of the format.
pub const CONTROLLER_FORMAT: u32 = 1;
/// Hand and model in files that version 0.1 made for the Allegro. Its checksum is that of another text about the same hand.
const ALLEGRO_OF_0_1: [&str; 2] = ["allegro-digit", "5c900b98"];
/// Largest file that is read, bytes.
const LARGEST_FILE: u64 = 1 << 20;
/// Most rows of a gait's table.
const MOST_ROWS: usize = 4096;
/// Largest distances of an object's start, and of the place of a hand-over, from the grasp along an axis, metres.
const START_M: f64 = 0.15;
const PLACE_M: f64 = 0.25;

/// Input and output of a controller.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum ControllerKind {
    /// Periodic targets of the joints. It senses joint angles and nothing of the object.
    Gait,
    /// Periodic targets with feedback on the estimated place of the object, which it holds in the air.
    Feedback,
}

/// Content of a file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ControllerFile {
    /// Version of the format, [`CONTROLLER_FORMAT`].
    pub format: u32,
    /// Input and output.
    pub kind: ControllerKind,
    /// Name of the hand.
    pub hand: String,
    /// Checksum of the hand, [`hand_model`].
    pub model: String,
    /// Sides of the hand that it suits. The left hand plays the mirror image.
    pub sides: Vec<Side>,
    /// Commands per second, [`CONTROL_HZ`].
    pub rate_hz: u32,
    /// Names of the objects for which it was tuned.
    pub objects: Vec<String>,
    /// Least and greatest extent of the objects for which it was tuned, millimetres.
    pub sizes_mm: [f64; 2],
    /// The motion.
    pub gait: Gait,
}

/// Why a controller cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ControllerFileError {
    /// The name is unknown.
    #[error(transparent)]
    Name(#[from] UnknownGait),
    /// A schedule names a controller that holds the object in the air.
    #[error("{0} takes the object over in the air, which only the start of an episode does: play it alone")]
    InAir(String),
    /// The schedule cannot be understood.
    #[error(
        "{0:?} is no schedule: write CONTROLLER:SECONDS,CONTROLLER:SECONDS with {SHORTEST_PART_S} to 3600 seconds each, such as tumble_back:8,cubelet:8"
    )]
    Schedule(String),
    /// The file cannot be read, or is not a controller of this program.
    #[error("{}: {reason}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong, and what to do.
        reason: String,
    },
}

impl ControllerFile {
    /// Returns the file of a gait that was tuned for `objects` on this hand.
    pub fn new(gait: Gait, objects: &[Object], hand: &Hand) -> Self {
        let extents = || objects.iter().flat_map(Object::extents_m).map(|m| 1e3 * m);
        Self {
            format: CONTROLLER_FORMAT,
            kind: if gait.feedback.is_some() { ControllerKind::Feedback } else { ControllerKind::Gait },
            hand: hand.name().to_owned(),
            model: hand_model(hand),
            // Only the built-in hand has a mirror image.
            sides: if gait::suits(hand) { vec![Side::Left, Side::Right] } else { vec![hand.side()] },
            rate_hz: CONTROL_HZ,
            objects: objects.iter().map(|object| object.name.clone()).collect(),
            sizes_mm: [
                extents().fold(f64::INFINITY, f64::min).floor(),
                extents().fold(f64::NEG_INFINITY, f64::max).ceil(),
            ],
            gait,
        }
    }

    /// Reads a file for a hand.
    ///
    /// # Errors
    /// [`ControllerFileError::File`] if it cannot be read or does not fit this program or this hand.
    pub fn read(path: &Path, hand: &Hand) -> Result<Self, ControllerFileError> {
        let failed = |reason: String| ControllerFileError::File { path: path.to_owned(), reason };
        let text = input::read_text(path, LARGEST_FILE).map_err(|e| failed(e.to_string()))?;
        let file: Self = toml::from_str(&text)
            .map_err(|e| failed(format!("it is not a controller: {}", e.message().replace('\n', " "))))?;
        file.check(hand).map_err(failed)?;
        Ok(file)
    }

    /// Returns why it cannot move this hand.
    fn check(&self, hand: &Hand) -> Result<(), String> {
        let Self { format, sides, rate_hz, .. } = self;
        let expect = |holds: bool, reason: String| if holds { Ok(()) } else { Err(reason) };
        expect(
            *format == CONTROLLER_FORMAT,
            format!("its format is {format}; this program reads format {CONTROLLER_FORMAT}"),
        )?;
        check_hand(&self.hand, &self.model, hand)?;
        let sides: Vec<&str> = sides.iter().map(|side| if *side == Side::Left { "left" } else { "right" }).collect();
        expect(self.sides.contains(&hand.side()), format!("it was made for --side {}", sides.join(" or ")))?;
        expect(
            *rate_hz == CONTROL_HZ,
            format!("it gives {rate_hz} commands per second; this program takes {CONTROL_HZ}"),
        )?;
        self.check_gait(hand)
    }

    fn check_gait(&self, hand: &Hand) -> Result<(), String> {
        match (self.kind, &self.gait.feedback) {
            (ControllerKind::Gait, Some(_)) => {
                return Err("a gait senses nothing of the object: write kind = \"feedback\", or remove gait.feedback"
                    .to_owned());
            }
            (ControllerKind::Feedback, None) => {
                return Err("a controller of kind \"feedback\" needs the table gait.feedback".to_owned());
            }
            _ => (),
        }
        self.check_size(hand)?;
        let Gait { period_s, torque_limit_nm, gravity, start_xy_m, open_pose, table, params, .. } = &self.gait;
        let numbers = [period_s, torque_limit_nm].into_iter().chain(gravity).chain(start_xy_m).chain(&self.sizes_mm);
        let fed_back = self.gait.feedback.iter().flat_map(|feedback| feedback.numbers());
        let mut numbers = numbers.chain(open_pose).chain(table.iter().flatten()).chain(params.values()).chain(fed_back);
        if numbers.any(|number| !number.is_finite()) {
            return Err("it contains a number that is not finite".to_owned());
        }
        let within = |name: &str, value: f64, [low, high]: [f64; 2]| {
            let holds = (low..=high).contains(&value);
            if holds { Ok(()) } else { Err(format!("{name} is {value}; it must be from {low} to {high}")) }
        };
        within("gait.period_s", *period_s, [0.1, 60.0])?;
        let strongest = hand.joints().iter().map(|joint| joint.drive.torque_limit).fold(0.01, f64::max);
        within("gait.torque_limit_nm", *torque_limit_nm, [0.01, strongest])?;
        within("the strength of gait.gravity", gravity.iter().map(|g| g * g).sum::<f64>().sqrt(), [9.0, 10.5])?;
        within("the number of rows of gait.table", table.len() as f64, [1.0, MOST_ROWS as f64])?;
        let centre_m = hand.grasp_centre(&[]).map_or([0.0; 3], |centre| centre.coords().into());
        for (value, centre) in start_xy_m.iter().zip(centre_m) {
            within("gait.start_xy_m", *value, [centre - START_M, centre + START_M])?;
        }
        if let Some(feedback) = &self.gait.feedback {
            for (value, centre) in feedback.place_m.into_iter().zip(centre_m) {
                within("gait.feedback.place_m", value, [centre - PLACE_M, centre + PLACE_M])?;
            }
            within("the number of poses of gait.feedback.lowering", feedback.lowering.len() as f64, [1.0, 10.0])?;
        }
        // Tables of the hand's own tuning are rounded.
        const ROUNDING_RAD: f64 = 1e-3;
        // In the air, a joint stays at its limit although feedback moves its target, if the target lies beyond.
        const BEYOND_RAD: f64 = 1.0;
        let beyond = if self.gait.feedback.is_some() { BEYOND_RAD } else { ROUNDING_RAD };
        let ranges = gait::right_ranges(hand);
        for row in table.iter().chain([open_pose]).chain(self.gait.feedback.iter().flat_map(|f| f.poses())) {
            for (j, (angle, [low, high])) in row.iter().zip(&ranges).enumerate() {
                within(&format!("an angle of joint {j}"), *angle, [low - beyond, high + beyond])?;
            }
        }
        Ok(())
    }

    /// Compares the numbers of joint angles with the hand.
    fn check_size(&self, hand: &Hand) -> Result<(), String> {
        let Gait { open_pose, table, feedback, .. } = &self.gait;
        let rows = table.iter().map(|row| ("a row of gait.table", row.len()));
        let fed_back = feedback.iter().flat_map(|feedback| {
            let rates = [
                ("gait.feedback.gains", feedback.gains.len()),
                ("gait.feedback.damping", feedback.damping.len()),
                ("gait.feedback.lift", feedback.lift.len()),
            ];
            let poses = feedback.poses().map(|pose| ("a pose of gait.feedback", pose.len()));
            rates.into_iter().chain(poses)
        });
        let own = hand.joints().len();
        match [("gait.open_pose", open_pose.len())].into_iter().chain(rows).chain(fed_back).find(|(_, n)| *n != own) {
            Some((name, found)) => Err(format!("{name} is for {found} joints; the hand {} has {own}", hand.name())),
            None => Ok(()),
        }
    }

    /// Returns why an object is not among those for which the controller was tuned; `None` if it has their size.
    pub fn misfit(&self, object: &Object) -> Option<String> {
        let [least, most] = self.sizes_mm;
        // Objects that are a little smaller or larger behave alike.
        const MARGIN: f64 = 0.1;
        let extents = object.extents_m().map(|m| 1e3 * m);
        let fits = extents.iter().all(|mm| (least * (1.0 - MARGIN)..=most * (1.0 + MARGIN)).contains(mm));
        let [x, y, z] = extents;
        let tuned = format!("the controller was tuned for extents of {least:.0} to {most:.0} mm");
        (!fits).then(|| format!("{tuned}; {} has {x:.0} x {y:.0} x {z:.0} mm and may fall", object.name))
    }
}

/// Returns the checksum of a hand, 8 hexadecimal digits. A hand that differs moves otherwise with the same angles, whatever the profiles of
/// its touch sensors. Both sides of the built-in hand have the same.
pub fn hand_model(hand: &Hand) -> String {
    // Why: notes/decisions/simulation.md, "A controller file names the hand's checksum".
    let right = Hand::allegro(Side::Right);
    let hand = if gait::suits(hand) { &right } else { &hand.with_profile(&SensorProfile::tacto()) };
    // A description serialises always.
    let text = serde_json::to_string(hand.description()).unwrap_or_default();
    format!("{:08x}", crc32fast::hash(text.as_bytes()))
}

/// Compares the name and the model of the hand for which a file was made with a hand.
///
/// # Errors
/// The difference, and what to do.
pub fn check_hand(name: &str, model: &str, hand: &Hand) -> Result<(), String> {
    if gait::suits(hand) && [name, model] == ALLEGRO_OF_0_1 {
        return Ok(());
    }
    let (own_name, own) = (hand.name(), hand_model(hand));
    if name != own_name {
        return Err(format!("it was made for the hand {name:?}; this is the hand {own_name:?}"));
    }
    if model != own {
        return Err(format!("it was made for model {model} of the hand {name}; this is model {own}: tune it again"));
    }
    Ok(())
}

/// Controller that an episode plays.
#[derive(Debug, Clone)]
pub struct ChosenController {
    /// Name of a shipped one, the path of a file, or the text of a schedule.
    pub name: String,
    /// The motion, or the first one of a schedule. It decides the start, also that of a policy.
    pub gait: Gait,
    /// Moves the hand in place of the gait; `None` for strokes and their feedback.
    pub mover: Option<Box<dyn Controller>>,
    /// SHA-256 of the files of a policy, hexadecimal: what tells its results from those of another of the same name.
    pub policy_sha256: Option<String>,
    /// The controllers that follow one another; empty if there is only one.
    pub schedule: Schedule,
    /// Why the object may fall; `None` if it has the size for which the controller was tuned, or a gait suits it.
    pub misfit: Option<String>,
    /// The choice was left open, and the object may fall.
    pub falls: bool,
}

impl ChosenController {
    fn of_file(name: &str, file: &ControllerFile, object: &Object) -> Self {
        Self {
            name: name.to_owned(),
            gait: file.gait.clone(),
            mover: None,
            policy_sha256: None,
            schedule: Schedule::default(),
            misfit: file.misfit(object),
            falls: false,
        }
    }
}

/// Returns the controller of a name or file; for `suited` and `auto` the gait that suits the object.
///
/// # Errors
/// [`ControllerFileError`] if there is no such controller, or it does not fit this hand.
pub fn choose(text: &str, object: &Object, hand: &Hand) -> Result<ChosenController, ControllerFileError> {
    if is_policy(text) {
        let reason = "it is a policy, which can be no part of a schedule and no start of a search; name a stroke";
        return Err(ControllerFileError::File { path: PathBuf::from(text), reason: reason.to_owned() });
    }
    if let Some((name, file)) = of_rig(text, hand)? {
        return Ok(ChosenController::of_file(name, &file, object));
    }
    let file = if is_path(text) { Some(ControllerFile::read(Path::new(text), hand)?) } else { None };
    if let Some(file) = file.as_ref().or_else(|| shipped().get(text).filter(|_| gait::suits(hand))) {
        return Ok(ChosenController::of_file(text, file, object));
    }
    let (name, gait) = gait::choose(text, object, hand)?;
    let unsuited = if is_left_open(text) { ObjectShape::of(object).unsuited() } else { None };
    Ok(ChosenController {
        name: name.to_owned(),
        gait: gait.clone(),
        mover: None,
        policy_sha256: None,
        schedule: Schedule::default(),
        falls: unsuited.as_ref().is_some_and(|unsuited| unsuited.falls),
        misfit: unsuited.map(|unsuited| format!("{} is {}", object.name, unsuited.reason)),
    })
}

/// Returns the controller as [`choose`], or the controllers of a schedule such as `tumble_back:8,cubelet:8`: names or files
/// with the seconds that they play.
///
/// # Errors
/// [`ControllerFileError`] if there is no such controller, one does not fit this hand, or the text is no schedule.
pub fn choose_all(text: &str, object: &Object, hand: &Hand) -> Result<ChosenController, ControllerFileError> {
    if !text.contains(',') {
        return choose(text, object, hand);
    }
    let part = |part: &str| {
        let invalid = || ControllerFileError::Schedule(text.to_owned());
        let (name, seconds) = part.rsplit_once(':').ok_or_else(invalid)?;
        let duration_s: f64 = seconds.parse().map_err(|_| invalid())?;
        if !(SHORTEST_PART_S..=3600.0).contains(&duration_s) {
            return Err(invalid());
        }
        let chosen = choose(name, object, hand)?;
        if chosen.gait.feedback.is_some() {
            return Err(ControllerFileError::InAir(chosen.name));
        }
        Ok((chosen, duration_s))
    };
    let parts = text.split(',').map(part).collect::<Result<Vec<_>, _>>()?;
    let scheduled = |(chosen, duration_s): &(ChosenController, f64)| ScheduledGait {
        gait: chosen.gait.clone(),
        duration_s: *duration_s,
    };
    let schedule = Schedule::new(parts.iter().map(scheduled).collect());
    let misfit = parts.iter().find_map(|(chosen, _)| chosen.misfit.clone());
    let gait = schedule.gait_after(0).ok_or_else(|| ControllerFileError::Schedule(text.to_owned()))?.clone();
    let falls = parts.iter().any(|(chosen, _)| chosen.falls);
    Ok(ChosenController { name: text.to_owned(), gait, mover: None, policy_sha256: None, schedule, misfit, falls })
}

/// Returns whether this names a file: it ends in .toml, contains a slash, or names a policy.
pub fn is_path(text: &str) -> bool {
    text.ends_with(".toml") || text.contains('/') || is_policy(text)
}

/// Name of the learnt policy that the program carries.
pub const CORRECTED: &str = "corrected";

/// Returns whether this names a learnt policy, which the crate `mvt-policy` reads: a file, or [`CORRECTED`].
pub fn is_policy(text: &str) -> bool {
    text == CORRECTED || [".onnx", ".safetensors"].iter().any(|end| text.ends_with(end))
}

/// Returns the shipped controllers that are files, by name.
pub fn shipped() -> &'static BTreeMap<String, ControllerFile> {
    static FILES: LazyLock<BTreeMap<String, ControllerFile>> = LazyLock::new(|| {
        let parse = |(name, text): &(&str, &str)| Some(((*name).to_owned(), toml::from_str(text).ok()?));
        // A test parses and checks them.
        gait::CONTROLLER_FILES.iter().filter_map(parse).collect()
    });
    &FILES
}

/// Returns the shipped controllers of a hand that is not the Allegro, by name.
fn shipped_of(hand: &str) -> Vec<(&'static str, ControllerFile)> {
    let of_hand = gait::RIG_CONTROLLERS.iter().filter(|(owner, ..)| *owner == hand);
    // A test parses them.
    of_hand.filter_map(|(_, name, text)| Some((*name, toml::from_str(text).ok()?))).collect()
}

/// Returns the shipped controller of this name, or the one that suits every object, for a hand that is not the Allegro. `None` if none is shipped for this hand.
fn of_rig(name: &str, hand: &Hand) -> Result<Option<(&'static str, ControllerFile)>, ControllerFileError> {
    let files = if is_path(name) || gait::suits(hand) { Vec::new() } else { shipped_of(hand.name()) };
    if files.is_empty() {
        return Ok(None);
    }
    let names = files.iter().map(|(name, _)| *name).collect::<Vec<_>>().join(", ");
    let unknown = || UnknownGait::OfHand { hand: hand.name().to_owned(), name: name.to_owned(), names };
    let (name, file) = files.into_iter().find(|(known, _)| *known == name || is_left_open(name)).ok_or_else(unknown)?;
    file.check(hand).map_err(|reason| ControllerFileError::File { path: PathBuf::from(name), reason })?;
    Ok(Some((name, file)))
}

/// Returns a line for each shipped controller: name, axis and purpose.
pub fn list() -> Vec<(String, TurnAxis, String)> {
    let sizes = |file: &ControllerFile| {
        let [least, most] = file.sizes_mm;
        format!("{least:.0} to {most:.0} mm ({}); ", file.objects.join(", "))
    };
    let line = |(name, gait): (&String, &Gait)| {
        let sizes = shipped().get(name).map(sizes).unwrap_or_default();
        (name.clone(), gait.axis, sizes + &gait.description)
    };
    let of_rig = |(hand, name, text): &(&str, &str, &str)| {
        let file: ControllerFile = toml::from_str(text).ok()?;
        let purpose = format!("{hand}: {}{}", sizes(&file), file.gait.description);
        Some(((*name).to_owned(), file.gait.axis, purpose))
    };
    gait::shipped().iter().map(line).chain(gait::RIG_CONTROLLERS.iter().filter_map(of_rig)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;

    fn object(name: &str) -> Object {
        mvt_objects::catalogue::load(name, &mut Vec::new()).unwrap()
    }

    fn left() -> Arc<Hand> {
        Hand::allegro(Side::Left)
    }

    fn file() -> ControllerFile {
        ControllerFile::new(gait::find("bal").unwrap().1.clone(), &[object("cube70")], &left())
    }

    fn refusal(change: impl FnOnce(&mut ControllerFile)) -> String {
        let mut file = file();
        change(&mut file);
        // Through text, as from a file.
        let file: ControllerFile = toml::from_str(&toml::to_string(&file).unwrap()).unwrap();
        file.check(&left()).unwrap_err()
    }

    #[test]
    fn shipped_files_fit_this_hand() {
        assert_eq!(shipped().len(), gait::CONTROLLER_FILES.len());
        for (name, file) in shipped() {
            assert_eq!(file.check(&left()), Ok(()), "{name}");
            assert_eq!(file.check(&Hand::allegro(Side::Right)), Ok(()), "{name}");
            assert_eq!((file.hand.as_str(), file.model.as_str()), ("allegro_digit", &*hand_model(&left())), "{name}");
            assert_eq!(gait::find(name).unwrap().1, &file.gait);
        }
        assert_eq!(list().len(), gait::shipped().len() + gait::RIG_CONTROLLERS.len());
    }

    #[test]
    fn a_file_comes_back_bit_for_bit() {
        let text = toml::to_string(&file()).unwrap();
        assert_eq!(toml::from_str::<ControllerFile>(&text).unwrap(), file());
    }

    #[test]
    fn what_does_not_fit_is_refused_with_the_reason() {
        assert_eq!(file().check(&left()), Ok(()));
        assert!(refusal(|f| f.format = 9).contains("format 1"));
        assert!(refusal(|f| f.hand = "leap".to_owned()).contains("\"allegro_digit\""));
        assert!(refusal(|f| f.sides = vec![Side::Right]).contains("--side right"));
        assert!(refusal(|f| f.rate_hz = 50).contains("takes 25"));
        assert!(refusal(|f| f.model = "00000000".to_owned()).contains("tune it again"));
        assert!(refusal(|f| f.gait.table[3][5] = f64::NAN).contains("not finite"));
        assert!(refusal(|f| f.gait.period_s = f64::INFINITY).contains("not finite"));
        assert!(refusal(|f| f.gait.period_s = 0.0).contains("gait.period_s is 0"));
        assert!(refusal(|f| f.gait.torque_limit_nm = 3.0).contains("torque_limit_nm"));
        assert!(refusal(|f| f.gait.table[0][0] = 2.0).contains("joint 0"));
        assert!(refusal(|f| f.gait.table.clear()).contains("rows"));
        assert!(refusal(|f| f.gait.gravity = [0.0; 3]).contains("gravity"));
        assert!(refusal(|f| f.gait.start_xy_m[1] = 70.0).contains("start_xy_m"));
        let short = refusal(|f| _ = f.gait.table[2].pop());
        assert_eq!(short, "a row of gait.table is for 15 joints; the hand allegro_digit has 16");
        assert!(refusal(|f| f.gait.open_pose.push(0.0)).starts_with("gait.open_pose is for 17 joints"));
    }

    #[test]
    fn files_of_version_0_1_are_read_for_the_built_in_hand_alone() {
        let [name, model] = ALLEGRO_OF_0_1.map(str::to_owned);
        let old = ControllerFile { hand: name, model, ..file() };
        assert_eq!(old.check(&left()), Ok(()));
        let newer = ControllerFile { model: "5c900b99".to_owned(), ..old.clone() };
        assert!(newer.check(&left()).unwrap_err().contains("allegro-digit"));
        let mut description = left().description().clone();
        description.joints[3].drive.damping = 0.2;
        let other = Hand::new(description).unwrap();
        assert!(old.check(&other).unwrap_err().contains("made for the hand"));
        assert!(file().check(&other).unwrap_err().contains("tune it again"));
    }

    #[test]
    fn another_hand_plays_files_that_were_made_for_it_and_nothing_that_is_shipped() {
        let mut description = Hand::allegro(Side::Right).description().clone();
        // The index finger alone.
        description.bodies.truncate(6);
        (description.name, description.apart) = ("pointer".to_owned(), Vec::new());
        description.joints.truncate(4);
        description.pads.truncate(1);
        let hand = Hand::new(description).unwrap();
        let mut gait = gait::find("bal").unwrap().1.clone();
        gait.table.iter_mut().chain([&mut gait.open_pose]).for_each(|row| row.truncate(4));
        let own = ControllerFile::new(gait, &[object("cube70")], &hand);
        assert_eq!((own.check(&hand), own.sides.len()), (Ok(()), 1));
        assert!(own.check(&left()).unwrap_err().contains("pointer"));
        for name in ["auto", "bal", "air_ball", "bal:8,low:8"] {
            let refused = choose_all(name, &object("cube70"), &hand).unwrap_err().to_string();
            assert!(refused.contains("pointer has no shipped gaits"), "{name}: {refused}");
        }
    }

    #[test]
    fn kind_and_content_must_agree() {
        let in_air = || shipped()["air_ball"].clone();
        assert_eq!((in_air().kind, in_air().check(&left())), (ControllerKind::Feedback, Ok(())));
        let refusal = |change: fn(&mut ControllerFile)| {
            let mut file = in_air();
            change(&mut file);
            file.check(&left()).unwrap_err()
        };
        assert!(refusal(|f| f.kind = ControllerKind::Gait).contains("kind = \"feedback\""));
        assert!(refusal(|f| f.gait.feedback = None).contains("needs the table gait.feedback"));
        assert!(refusal(|f| f.gait.feedback.as_mut().unwrap().gains[3][1] = f64::NAN).contains("not finite"));
        assert!(refusal(|f| f.gait.feedback.as_mut().unwrap().lowering[0][0] = 2.0).contains("joint 0"));
        assert!(refusal(|f| f.gait.feedback.as_mut().unwrap().lowering.clear()).contains("lowering"));
        assert!(refusal(|f| f.gait.feedback.as_mut().unwrap().place_m[2] = 1.0).contains("place_m"));
        assert!(refusal(|f| f.gait.feedback.as_mut().unwrap().grasp.clear()).contains("for 0 joints"));
        assert!(refusal(|f| _ = f.gait.feedback.as_mut().unwrap().lift.pop()).contains("gait.feedback.lift is for 15"));
        // A controller that wants the true place has no kind.
        let teacher = toml::to_string(&in_air()).unwrap().replace("kind = \"feedback\"", "kind = \"teacher\"");
        let error = toml::from_str::<ControllerFile>(&teacher).unwrap_err();
        assert!(error.message().contains("teacher") && error.message().contains("feedback"), "{error}");
    }

    #[test]
    fn the_air_is_no_part_of_a_schedule() {
        let error = choose_all("cubelet:8,air_ball:8", &object("cube70"), &left()).unwrap_err();
        assert!(error.to_string().starts_with("air_ball takes the object over in the air"), "{error}");
    }

    #[test]
    fn objects_of_another_size_are_named() {
        assert_eq!(file().misfit(&object("cube70")), None);
        assert!(file().misfit(&object("large_dice")).unwrap().contains("may fall"));
    }

    #[test]
    fn names_and_files_are_told_apart() {
        assert!(is_path("bal.toml") && is_path("./bal") && !is_path("bal"));
        let error = choose("gallop", &object("cube70"), &left()).unwrap_err();
        assert!(error.to_string().contains("bal, "));
        let error = choose("none/such.toml", &object("cube70"), &left()).unwrap_err();
        assert!(error.to_string().starts_with("none/such.toml: "));
        let chosen = choose("auto", &object("cube70"), &left()).unwrap();
        assert_eq!(chosen.gait, *gait::find(&chosen.name).unwrap().1);
    }
}
