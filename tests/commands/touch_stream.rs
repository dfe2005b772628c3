//! `touch predict` on videos and cameras, which ffmpeg decodes.

use std::io::{BufRead as _, BufReader};
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use serde_json::Value;

use crate::workplace::{Ended, Workplace, others_data, signal, skip};

const FRAMES: usize = 14;

/// Images of a real sensor.
fn sensor() -> Option<PathBuf> {
    Some(others_data("real_digit")?.join("dd"))
}

/// Returns a workplace with two videos of a sensor without loss: `touched.mkv`, of which the times between frames grow, and `whole.mkv` of the
/// sensor on its side, which shows it untouched ten times before. Returns `None` where there is no ffmpeg,
/// or no sensor.
fn videos() -> Option<(Workplace, PathBuf)> {
    let sensor = sensor()?;
    let workplace = Workplace::new();
    std::fs::create_dir(workplace.path("in")).unwrap();
    for number in 0..10 + FRAMES {
        let name = number.checked_sub(10).map_or_else(|| "untouched.png".into(), |k| format!("{k:03}_img.png"));
        std::fs::copy(sensor.join(name), workplace.path(&format!("in/{number:03}.png"))).unwrap();
    }
    for (name, first, change) in [("touched.mkv", "10", "setpts=N*N/30/TB"), ("whole.mkv", "0", "transpose=clock")] {
        let mut ffmpeg = Command::new("ffmpeg");
        ffmpeg.current_dir(workplace.path("")).args(["-nostdin", "-loglevel", "error", "-start_number", first]);
        let Ok(ended) = ffmpeg.args(["-i", "in/%03d.png", "-vf", change, "-c:v", "ffv1", name]).output() else {
            skip("ffmpeg is not installed");
            return None;
        };
        assert!(ended.status.success(), "{ended:?}");
    }
    Some((workplace, sensor))
}

/// Returns a command whose `ffmpeg` is a script, in which FFMPEG stands for the real one.
pub fn with_ffmpeg(workplace: &Workplace, arguments: &str, script: &str) -> Command {
    let path = std::env::var("PATH").unwrap();
    let real = path.split(':').map(|folder| Path::new(folder).join("ffmpeg")).find(|file| file.exists()).unwrap();
    std::fs::create_dir_all(workplace.path("bin")).unwrap();
    let file = workplace.path("bin/ffmpeg");
    std::fs::write(&file, format!("#!/bin/sh\n{}\n", script.replace("FFMPEG", &real.display().to_string()))).unwrap();
    std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o755)).unwrap();
    let mut command = workplace.command(arguments);
    command.env("PATH", format!("{}:{path}", workplace.path("bin").display()));
    command
}

/// Returns the figures of each line, without the name of the frame.
fn figures<'a>(lines: impl IntoIterator<Item = &'a Value>) -> Vec<[f64; 4]> {
    let keys = ["area_mm2", "deepest_mm", "volume_mm3", "plausibility"];
    lines.into_iter().map(|line| keys.map(|key| line[key].as_f64().unwrap())).collect()
}

fn lines(text: &str) -> Vec<Value> {
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

#[test]
fn frames_of_a_video_are_read_as_images_are() {
    let Some((workplace, sensor)) = videos() else { return };
    let mut images = workplace.command("touch predict --json --out images");
    images.arg("--images").arg(&sensor).arg("--untouched").arg(sensor.join("untouched.png"));
    let images = Ended::of(&mut images).json();
    let images = images.as_array().unwrap();
    std::fs::copy(sensor.join("untouched.png"), workplace.path("untouched.png")).unwrap();
    let of_video =
        lines(&workplace.run("touch predict --video touched.mkv --untouched untouched.png --json --out video").good());
    assert_eq!((of_video.len(), &of_video[3]["id"]), (FRAMES, &Value::from("000003")));
    assert_eq!(figures(&of_video), figures(images));
    for name in ["contact.png", "indentation_mm.npy", "picture.png"] {
        let read = |id: &str| std::fs::read(workplace.path(&format!("{id}_{name}"))).unwrap();
        assert!(read("video/000013") == read("images/013"), "{name} differs");
    }
    let table = workplace.text("video/predictions.csv");
    assert_eq!(table.lines().count(), 1 + FRAMES);

    // The first frames show no contact, and their median is the untouched image.
    let ended = workplace.run("touch predict --video whole.mkv --json");
    let of_whole = lines(&ended.stdout);
    let said = ended.warned();
    assert!(said.contains("first 10 frames") && said.contains("turned by 270 degrees"), "{said}");
    assert!(figures(&of_whole[..10]).iter().all(|[area_mm2, ..]| *area_mm2 == 0.0));
    assert_eq!(figures(&of_whole[10..]), figures(images));
    let few = workplace.run("touch predict --video touched.mkv --untouched untouched.png --frames 3").good();
    assert!(few.starts_with("3 of 3 frames show contact"), "{few}");
}

#[test]
fn what_is_no_video_and_what_ends_early_is_said() {
    let Some((workplace, sensor)) = videos() else { return };
    std::fs::copy(sensor.join("untouched.png"), workplace.path("untouched.png")).unwrap();
    let video = std::fs::read(workplace.path("touched.mkv")).unwrap();
    workplace.write("cut.mkv", &video[..video.len() * 3 / 5]);
    let said = workplace.run("touch predict --video cut.mkv --untouched untouched.png --out out").warned();
    assert!(said.contains("cut.mkv is damaged or cut off") && said.lines().count() == 1, "{said}");
    let table = workplace.text("out/predictions.csv");
    assert!((6..FRAMES).contains(&table.lines().count()), "{table}");

    workplace.write("words.mp4", "no video");
    let error = |arguments: &str| workplace.run(&format!("touch predict {arguments}")).error();
    assert!(error("--video words.mp4").contains("words.mp4 is no video that ffmpeg can read: Invalid data"));
    assert!(error("--video nowhere.mp4").contains("cannot read the video nowhere.mp4"));
    assert!(error("--camera /dev/video99").contains("connect it"));
    let silent = Ended::of(&mut with_ffmpeg(&workplace, "touch predict --video words.mp4", "exit 0")).error();
    assert!(silent.contains("it has no frames"), "{silent}");
    let mut missing = workplace.command("touch predict --video touched.mkv");
    let missing = Ended::of(missing.env("PATH", "")).error();
    assert!(missing.contains("cannot start ffmpeg") && missing.contains("install it"), "{missing}");
    for arguments in ["", "--video a.mkv --camera /dev/video0", "--images in --frames 3 --out out", "--images in"] {
        workplace.run(&format!("touch predict {arguments}")).usage();
    }
}

/// A camera is played by a script in the place of ffmpeg.
#[test]
fn a_camera_is_read_until_it_is_unplugged_or_left() {
    let Some((workplace, sensor)) = videos() else { return };
    std::fs::copy(sensor.join("untouched.png"), workplace.path("untouched.png")).unwrap();
    let camera = "touch predict --camera /dev/null --untouched untouched.png --json --out out";
    let play = "FFMPEG -nostdin -loglevel error -i touched.mkv -vf settb=1/60,setpts=N -r 60 -f image2pipe -c:v ppm -";
    let unplugged = format!("echo \"$@\" > asked\n{play}\necho /dev/null: No such device >&2; exit 1");
    let ended = Ended::of(&mut with_ffmpeg(&workplace, camera, &unplugged));
    assert_eq!((ended.code, lines(&ended.stdout).len()), (Some(1), FRAMES));
    let reason = "the camera /dev/null was lost after 14 frames: No such device; connect it again";
    assert!(ended.stderr.contains(reason), "{}", ended.stderr);
    assert!(workplace.path("out/predictions.csv").exists(), "the frames before are kept");
    let asked = workplace.text("asked");
    assert!(asked.contains("-f v4l2 -video_size 320x240 -framerate 60 -i /dev/null"), "{asked}");
    let absent = "echo \"$@\" > asked\necho /dev/null: Device or resource busy >&2; exit 1";
    let mini = format!("{camera} --profile gelsight_mini");
    let absent = Ended::of(&mut with_ffmpeg(&workplace, &mini, absent)).error();
    assert!(absent.contains("cannot read the camera /dev/null: Device or resource busy"), "{absent}");
    let asked = workplace.text("asked");
    assert!(asked.contains("-video_size 320x240 -framerate 25 -i"), "{asked}");

    // A camera that delivers for ever ends with an interrupt.
    let endless = format!("while {play}; do :; done");
    let mut running = with_ffmpeg(&workplace, camera, &endless).stdout(Stdio::piped()).spawn().unwrap();
    let mut output = BufReader::new(running.stdout.take().unwrap()).lines();
    let first: Vec<String> = output.by_ref().take(2 * FRAMES).map(Result::unwrap).collect();
    signal(&running, "INT");
    assert!(output.all(|line| line.is_ok()));
    assert_eq!(running.wait().unwrap().code(), Some(0));
    let first = lines(&first.join("\n"));
    assert_eq!(figures(&first[..FRAMES]), figures(&first[FRAMES..]));
}
