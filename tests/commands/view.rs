//! `view`: pictures and films of runs and logs, without a display.

use std::fs::{self, File};
use std::io::BufReader;

use image::codecs::gif::GifDecoder;
use image::{AnimationDecoder as _, RgbImage};

use crate::workplace::Workplace;

/// Returns the mean difference of two pictures, grey levels.
fn difference(a: &RgbImage, b: &RgbImage) -> f64 {
    assert_eq!(a.dimensions(), b.dimensions());
    let sum: u64 = a.iter().zip(b.iter()).map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
    sum as f64 / a.len() as f64
}

fn film(workplace: &Workplace, name: &str) -> Vec<RgbImage> {
    let decoder = GifDecoder::new(BufReader::new(File::open(workplace.path(name)).unwrap())).unwrap();
    let frames = decoder.into_frames().collect_frames().unwrap();
    frames.into_iter().map(|frame| image::DynamicImage::ImageRgba8(frame.into_buffer()).into_rgb8()).collect()
}

fn picture(workplace: &Workplace, arguments: &str) -> RgbImage {
    workplace.run(&format!("view {arguments} --record picture.png --overwrite")).good();
    image::open(workplace.path("picture.png")).unwrap().into_rgb8()
}

#[test]
fn a_run_is_filmed_without_a_display() {
    let workplace = Workplace::new();
    workplace.run("run --object rubiks_cube_small --duration 1 --quiet").good();
    let mut command = workplace.command("view --run out --record film.gif --size 480x320 --every 6");
    let said = command.env_remove("DISPLAY").env_remove("WAYLAND_DISPLAY").output().unwrap();
    assert!(said.status.success(), "{said:?}");
    let film = film(&workplace, "film.gif");
    assert_eq!(film.len(), 5);
    for (k, frame) in film.iter().enumerate() {
        // A GIF has fewer colours than a PNG.
        let picture = picture(&workplace, &format!("--run out --size 480x320 --frame {}", 6 * k));
        let off = difference(frame, &picture);
        assert!(off < 3.0, "frame {k} of the film differs by {off} from a picture of the same moment");
    }
    for pair in film.windows(2) {
        assert!(difference(&pair[0], &pair[1]) > 0.1, "nothing moves");
    }
    // The same options paint the same picture; other options paint others.
    let all = picture(&workplace, "--run out --size 480x320");
    assert_eq!(all, picture(&workplace, "--run out --size 480x320"));
    for other in ["--theme dark", "--layout scene", "--layout sensors", "--from top", "--show mesh", "--colour sensor"]
    {
        let other = picture(&workplace, &format!("--run out --size 480x320 {other}"));
        assert!(difference(&all, &other) > 0.02, "{other:?}");
    }
    for (arguments, words) in [
        ("--run out --record x.avi", ".gif"),
        ("--run out --record x.png --frame 30", "the last one is 29"),
        ("--run out --record x.gif --frame 3", "--frame is for a picture"),
        ("--run out --record x.gif --rate 0", "from 0.1 to 60"),
        ("--run out/recording --record x.png", "holds no recording"),
        ("--log out --record x.png", "data.pkl"),
        ("--record x.png", "--run DIR or --log LOGDIR"),
    ] {
        let said = workplace.run(&format!("view {arguments}")).error();
        assert!(said.contains(words), "{arguments}: {said}");
    }
    let no_ffmpeg = workplace.command("view --run out --record x.mp4").env("PATH", "").output().unwrap();
    let said = String::from_utf8_lossy(&no_ffmpeg.stderr).into_owned();
    assert!(!no_ffmpeg.status.success() && said.contains("ffmpeg") && said.contains(".gif"), "{said}");
    assert!(["x.avi", "x.png", "x.gif", "x.mp4"].iter().all(|name| !workplace.path(name).exists()));

    // The recording of a killed run is still shown.
    let frames = workplace.path("out/recording/frames.jsonl");
    let text = fs::read(&frames).unwrap();
    fs::write(&frames, &text[..text.len() / 2]).unwrap();
    fs::remove_file(workplace.path("out/recording/end.json")).unwrap();
    picture(&workplace, "--run out --size 480x320");
    // The recording of a later version is refused.
    workplace.write("out/recording/about.json", r#"{"version": 7}"#);
    let said = workplace.run("view --run out --record x.png").error();
    assert!(said.contains("version 7") && said.contains("use a newer one"), "{said}");
}

#[test]
fn a_raw_log_is_filmed() {
    let workplace = Workplace::new();
    workplace.run("generate --object cube70 --logs 1 --duration 0.5 --cameras side --out set").good();
    workplace.run("view --log set/cube70/00 --record film.gif --size 480x320").good();
    let film = film(&workplace, "film.gif");
    assert_eq!(film.len(), 5);
    assert!(film.windows(2).all(|pair| difference(&pair[0], &pair[1]) > 0.02), "nothing moves");
    // The recording of a run over the log shows the same images as the log.
    workplace.run("run --log set/cube70/00 --quiet").good();
    let run = picture(&workplace, "--run out --layout sensors --size 480x320 --frame 0");
    let log = picture(&workplace, "--log set/cube70/00 --layout sensors --size 480x320 --frame 0");
    let off = difference(&run, &log);
    assert!(off < 12.0, "the images of a log differ by {off} from those of a run over it");
    // The times of contact fill one of five panels for a run, and the only panel for a log.
    workplace.run("run --log set/cube70/00 --touch-depth truth --out felt --quiet").good();
    const FINGERS: [[u8; 3]; 4] = [[0, 114, 178], [230, 159, 0], [0, 158, 115], [204, 121, 167]];
    let [run, log] = [("--run felt", 768), ("--log set/cube70/00", 0)].map(|(place, left)| {
        let page = picture(&workplace, &format!("{place} --layout all --size 960x640"));
        let contacts = image::imageops::crop_imm(&page, left, 520, 960 - left, 120).to_image();
        contacts.pixels().filter(|pixel| FINGERS.contains(&pixel.0)).count() as f64
    });
    assert!(run > 50.0 && (4.0..9.0).contains(&(log / run)), "contact takes {run} pixels in a run and {log} in a log");
}
