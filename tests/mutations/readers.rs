//! The readers: one test each.

use std::fs;
use std::path::{Path, PathBuf};

use mvt_feelsight::npz::NpzReader;
use mvt_feelsight::{Log, TouchPart, inspect, npy, pickle};
use mvt_field::field::NeuralField;
use mvt_gaits::controller_file::ControllerFile;
use mvt_mesh::Format;
use mvt_policy::Policy;
use mvt_recording::Recording;
use mvt_rgbd::RgbdRecording;
use mvt_robot::hand::{Hand, Side};
use mvt_run::config::RunConfig;
use mvt_run::input::map_obstacles;
use mvt_run::report;
use mvt_run::source::RgbdSequence;
use mvt_slam::map::Map;
use mvt_touch::network::{Architecture, Weights};
use mvt_tuning::grasp::{Grasp, GraspFile};
use safetensors::serialize;
use safetensors::tensor::{Dtype, TensorView};
use tempfile::TempDir;

use crate::originals::{
    self, copy_run, mcap_without_checksums, npz, of_run, pictures, png_with_checksums, with_and_without_seal,
    zip_with_checksums,
};
use crate::trial::{Original, check};
use crate::{sequences, small_bags, small_log};

/// Folder with one file that is written anew for each input.
struct OneFile {
    _folder: TempDir,
    path: PathBuf,
}

impl OneFile {
    fn new(name: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        Self { path: folder.path().join(name), _folder: folder }
    }

    fn with(&self, bytes: &[u8]) -> &Path {
        fs::write(&self.path, bytes).unwrap();
        &self.path
    }
}

/// Files of a folder, one of which is mutated at a time.
struct Files {
    folder: PathBuf,
    names: Vec<&'static str>,
}

impl Files {
    fn originals(&self) -> Vec<Original> {
        self.names.iter().map(|name| Original::new(fs::read(self.folder.join(name)).unwrap())).collect()
    }

    /// Reads the folder with other bytes in a file, and then puts the original back.
    fn with(&self, number: usize, bytes: &[u8], read: impl FnOnce(&Path) -> bool) -> bool {
        let path = self.folder.join(self.names[number]);
        let original = fs::read(&path).unwrap();
        fs::write(&path, bytes).unwrap();
        // Also if the reader panics.
        let result = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| read(&self.folder)));
        fs::write(&path, original).unwrap();
        result.unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    }
}

fn write_log(folder: &Path) -> PathBuf {
    let place = folder.join("00");
    small_log::write(&place, 2, &[small_log::camera("front-left", 16, 12)]);
    place
}

/// Reads all of a log; returns whether it passes an inspection.
fn read_log(place: &Path) -> bool {
    if let Ok(log) = Log::open_tolerant(place) {
        log.into_partial_frames(&[0], TouchPart::Images).for_each(drop);
    }
    inspect(place).is_ok()
}

#[test]
fn log() {
    let folder = tempfile::tempdir().unwrap();
    let names = vec![
        "data.pkl",
        "scene.json",
        "realsense/front-left/depth.npz",
        "realsense/front-left/image/0.jpg",
        "realsense/front-left/seg/1.jpg",
        "allegro/index/image/0.jpg",
        "allegro/index/depth/1.jpg",
        "allegro/index/mask/0.jpg",
    ];
    let files = Files { folder: write_log(folder.path()), names };
    check("log", &files.originals(), |number, bytes| files.with(number, bytes, read_log));
}

/// As `log`, with the images in one archive.
#[test]
fn compact_log() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("compact");
    mvt_feelsight::convert(&write_log(folder.path()), &place, mvt_feelsight::LogFormat::Compact, |_| ()).unwrap();
    let archive = fs::read(place.join("frames.zip")).unwrap();
    let files = Files { folder: place, names: vec!["frames.zip"; 2] };
    let originals = [Original::new(archive.clone()), Original { bytes: archive, finish: zip_with_checksums }];
    check("compact_log", &originals, |number, bytes| files.with(number, bytes, read_log));
}

/// An import of an export; every second input has no checksums of chunks, so that damage inside them is read.
#[test]
fn mcap() {
    let folder = tempfile::tempdir().unwrap();
    let exported = folder.path().join("log.mcap");
    mvt_exchange::export_mcap(&Log::open(&write_log(folder.path())).unwrap(), &exported, false, || ()).unwrap();
    let bytes = fs::read(exported).unwrap();
    let originals = [Original::new(bytes.clone()), Original { bytes, finish: mcap_without_checksums }];
    let file = OneFile::new("a.mcap");
    let out = folder.path().join("out");
    check("mcap", &originals, |_, bytes| {
        let imported = mvt_exchange::import_mcap(file.with(bytes), None, &out, |_, _| ()).is_ok();
        assert_eq!(out.is_dir(), imported);
        if imported {
            fs::remove_dir_all(&out).unwrap();
        }
        imported
    });
}

/// An import of an exported data set, with damage in each of its tables and in info.json.
#[test]
fn lerobot() {
    let folder = tempfile::tempdir().unwrap();
    let set = folder.path().join("set");
    mvt_exchange::export_lerobot(&[write_log(folder.path())], &[], &set, true, || ()).unwrap();
    let names = [
        "data/chunk-000/file-000.parquet",
        "meta/episodes/chunk-000/file-000.parquet",
        "meta/info.json",
        "meta/mambavitact/episode-000000/depth-0.npz",
    ];
    let files = Files { folder: set.clone(), names: names.to_vec() };
    let out = folder.path().join("out");
    check("lerobot", &files.originals(), |k, bytes| {
        files.with(k, bytes, |_| {
            let imported = mvt_exchange::import_lerobot(&set, 0, None, &out, |_, _| ()).is_ok();
            assert_eq!(out.is_dir(), imported);
            if imported {
                fs::remove_dir_all(&out).unwrap();
            }
            imported
        })
    });
}

#[test]
fn mapping() {
    let folder = tempfile::tempdir().unwrap();
    let text = "[hand]\njoints = \"/joints\"\nbase = \"palm\"\n[object]\nname = \"mug\"\n[[camera]]\nname = \"front\"\ndepth = \"/depth\"\n\
                intrinsics = { width = 64, height = 48, fx = 60, fy = 60, cx = 32, cy = 24 }\n[touch.thumb]\nimage = \"/thumb\"\nbgr = true\n";
    let file = OneFile::new("mapping.toml");
    let source = folder.path().join("empty.mcap");
    fs::write(&source, "").unwrap();
    check("mapping", &[Original::new(text.as_bytes().to_vec())], |_, bytes| {
        let refused = mvt_exchange::import_mcap(&source, Some(file.with(bytes)), &folder.path().join("out"), |_, _| ());
        matches!(refused, Err(mvt_exchange::ExchangeError::Source { .. }))
    });
}

#[test]
fn specification() {
    let text = "command = \"evaluate\"\npoints = 7\npoints_seed = 3\n[fixed]\nduration = 2.5\n[axes]\nobject = [\"cube70\", \"a\"]\n\
                seed = { from = 3, count = 5 }\nmode = { from = 1, count = 2, prefix = \"p\" }\ncamera_noise = { min = 0.5, max = 5.0 }\n\
                slam.tracker.touch_weight = { min = 1, max = 9, steps = 3 }\n";
    check("specification", &[Original::new(text.as_bytes().to_vec())], |_, bytes| {
        let Ok(spec) = mvt_sweep::SweepSpec::parse(&String::from_utf8_lossy(bytes), 100_000) else { return false };
        (0..spec.len().min(1000)).all(|number| !spec.task(number).is_empty())
    });
}

#[test]
fn plan_and_manifest() {
    let folder = tempfile::tempdir().unwrap();
    let text = "command = \"generate\"\n[axes]\nobject = [\"cube70\"]\nseed = { from = 0, count = 9 }\n";
    mvt_sweep::SweepPlan::write(&mvt_sweep::SweepSpec::parse(text, 9).unwrap(), folder.path()).unwrap();
    let task = mvt_sweep::SweepPlan::read(folder.path()).unwrap().tasks.remove(4).id;
    let store = mvt_sweep::Store::new(folder.path());
    store.prepare().unwrap();
    let number = store.begin(&task, 1).unwrap().unwrap();
    fs::write(store.workplace(&task, number).join("a.txt"), "some words").unwrap();
    store.finish(&task, number).unwrap();
    let manifest: &'static str = format!("done/{}/{task}/manifest.json", &task[..2]).leak();
    let files = Files { folder: folder.path().to_owned(), names: vec!["plan.json", "tasks.jsonl", manifest] };
    check("plan_and_manifest", &files.originals(), |number, bytes| {
        files.with(number, bytes, |place| {
            let Ok(plan) = mvt_sweep::SweepPlan::read(place) else { return false };
            let status = mvt_sweep::SweepStatus::read(&plan, true);
            status.is_ok_and(|status| status.problems.is_empty() && store.check(&task).is_ok())
        })
    });
}

#[test]
fn scene_json() {
    let folder = tempfile::tempdir().unwrap();
    let files = Files { folder: write_log(folder.path()), names: vec!["scene.json"] };
    check("scene_json", &files.originals(), |number, bytes| {
        files.with(number, bytes, |place| Log::open(place).is_ok_and(|log| log.len() == 2))
    });
}

#[test]
fn pickle_file() {
    let folder = tempfile::tempdir().unwrap();
    let mut originals = vec![Original::new(fs::read(write_log(folder.path()).join("data.pkl")).unwrap())];
    let samples = Path::new(env!("CARGO_MANIFEST_DIR")).join("sim/feelsight/tests/data");
    let protocols = (0..6).map(|protocol| samples.join(format!("numpy2-{protocol}.pkl")));
    originals.extend(protocols.map(|path| Original::new(fs::read(path).unwrap())));
    check("pickle_file", &originals, |_, bytes| pickle::from_bytes(bytes).is_ok());
}

#[test]
fn npz_file() {
    let folder = tempfile::tempdir().unwrap();
    let written = fs::read(write_log(folder.path()).join("realsense/front-left/depth.npz")).unwrap();
    let originals = [
        Original::new(written),
        // The archive around these is intact.
        Original { bytes: originals::npy("(2, 12, 16, )", 2 * 12 * 16), finish: |array| npz(&array) },
        Original { bytes: originals::npy("()", 1), finish: |array| originals::npz_scale(&array) },
    ];
    let file = OneFile::new("depth.npz");
    check("npz_file", &originals, |_, bytes| {
        let Ok(mut reader) = NpzReader::open(file.with(bytes)) else { return false };
        loop {
            match reader.read() {
                Ok(Some(_)) => {}
                other => return other.is_ok(),
            }
        }
    });
}

#[test]
fn npy_file() {
    let originals = [Original::new(originals::npy("(12, 16, )", 12 * 16)), Original::new(originals::npy("()", 1))];
    let file = OneFile::new("depth.npy");
    check("npy_file", &originals, |_, bytes| npy::read(file.with(bytes)).is_ok());
}

#[test]
fn png() {
    let file = OneFile::new("a.png");
    let finished = |bytes| Original { bytes, finish: png_with_checksums };
    let originals = pictures(image::ImageFormat::Png).into_iter().flat_map(|b| [Original::new(b.clone()), finished(b)]);
    let originals: Vec<Original> = originals.collect();
    check("png", &originals, |_, bytes| mvt_run::io::read_image(file.with(bytes)).is_ok());
}

#[test]
fn jpeg() {
    let file = OneFile::new("a.jpg");
    let originals: Vec<Original> = pictures(image::ImageFormat::Jpeg).into_iter().map(Original::new).collect();
    check("jpeg", &originals, |_, bytes| mvt_run::io::read_image(file.with(bytes)).is_ok());
}

#[test]
fn config() {
    let file = OneFile::new("config.toml");
    check("config", &[Original::new(of_run("config.toml"))], |_, bytes| {
        RunConfig::default().changed(Some(file.with(bytes)), &[]).is_ok()
    });
}

#[test]
fn controller() {
    let (file, path) = (OneFile::new("controller.toml"), "sim/gaits/assets/controllers/tumble_back.toml");
    let original = fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join(path)).unwrap();
    check("controller", &[Original::new(original)], |_, bytes| {
        ControllerFile::read(file.with(bytes), &Hand::allegro(Side::Right)).is_ok()
    });
}

#[test]
fn policy() {
    let file = OneFile::new("policy.safetensors");
    let (weight, bias) = ([0_u8; 4 * 16 * 16], [0_u8; 4 * 16]);
    let tensors = [
        ("layers.0.weight", TensorView::new(Dtype::F32, vec![16, 16], &weight).unwrap()),
        ("layers.0.bias", TensorView::new(Dtype::F32, vec![16], &bias).unwrap()),
    ];
    let hand = Hand::allegro(Side::Left);
    let names: Vec<&str> = hand.joints().iter().map(|joint| joint.name.as_str()).collect();
    let middles: Vec<f64> = hand.ranges().iter().map(|[low, high]| 0.5 * (low + high)).collect();
    let contract = format!(
        "joint_names = {names:?}\njoint_stiffness = 3.0\njoint_damping = 0.1\ndefault_joint_pos = {middles:?}\naction_scale = 0.5\n\
         observation_names = [\"joint_pos\"]\nobservation_terms_scale = 1.0\nobservation_terms_clip = [-1.0, 1.0]\n\
         observation_terms_history_length = 0\ncontrol_hz = 25\nactivation = \"elu\"\nnormaliser = \"none\"\n"
    );
    let beside = file.path.with_extension("toml");
    fs::write(&beside, &contract).unwrap();
    let originals = [serialize(tensors, None).unwrap(), contract.into_bytes()].map(Original::new);
    check("policy", &originals, |number, bytes| {
        let (changed, other) = if number == 0 { (&file.path, &beside) } else { (&beside, &file.path) };
        let kept = originals.get(1 - number).map(|original| original.bytes.clone()).unwrap();
        fs::write(other, kept).unwrap();
        fs::write(changed, bytes).unwrap();
        Policy::read(&file.path, &hand).is_ok()
    });
}

#[cfg(feature = "onnx")]
#[test]
fn onnx_policy() {
    let file = OneFile::new("policy.onnx");
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("sim/policy/tests/data");
    let originals = ["mlp.onnx", "gru.onnx"].map(|name| Original::new(fs::read(data.join(name)).unwrap()));
    check("onnx_policy", &originals, |_, bytes| Policy::read(file.with(bytes), &Hand::allegro(Side::Left)).is_ok());
}

#[test]
fn grasps() {
    let object = mvt_objects::catalogue::load("ball", &mut Vec::new()).unwrap();
    let feedback = mvt_gaits::gait::find("air_ball").unwrap().1.feedback.clone().unwrap();
    let hand = Hand::allegro(Side::Right);
    let grasp = Grasp {
        place_m: feedback.place_m,
        yaw_rad: 0.5,
        open_pose: feedback.grasp.clone(),
        touching: feedback.grasp.clone(),
        grasp: feedback.grasp,
        pads: 3.0,
        touched_beside_tips: 0.25,
    };
    let original = toml::to_string(&GraspFile::new(&object, &hand, vec![grasp.clone(), grasp])).unwrap();
    let file = OneFile::new("grasps.toml");
    check("grasps", &[Original::new(original.into_bytes())], |_, bytes| {
        GraspFile::read(file.with(bytes), &hand).is_ok()
    });
}

#[test]
fn weights() {
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("perception/touch/tests/fixtures");
    let read = |name: &str| fs::read(fixtures.join(format!("{name}.safetensors"))).unwrap();
    let originals: Vec<Original> =
        Architecture::NAMES.iter().flat_map(|name| with_and_without_seal(read(name))).collect();
    check("weights", &originals, |_, bytes| Weights::from_bytes(bytes, Path::new("weights")).is_ok());
}

#[test]
fn field() {
    let file = OneFile::new("field.safetensors");
    check("field", &with_and_without_seal(of_run("field.safetensors")), |_, bytes| {
        NeuralField::load(file.with(bytes)).is_ok()
    });
}

#[test]
fn keyframes() {
    let folder = tempfile::tempdir().unwrap();
    copy_run(folder.path());
    let files = Files { folder: folder.path().to_owned(), names: vec!["keyframes.safetensors"; 2] };
    let config = RunConfig::default().slam.map;
    check("keyframes", &with_and_without_seal(of_run("keyframes.safetensors")), |number, bytes| {
        files.with(number, bytes, |place| {
            Map::load(place, config.clone(), map_obstacles(&Hand::allegro(Side::Left))).is_ok()
        })
    });
}

#[test]
fn recording() {
    let folder = tempfile::tempdir().unwrap();
    copy_run(folder.path());
    let names = vec!["about.json", "frames.jsonl", "shapes.jsonl", "end.json", "images.bin", "shapes.bin"];
    let inner = folder.path().join("recording");
    let files = Files { folder: inner.clone(), names };
    let tables = ["about.json", "frames.jsonl", "shapes.jsonl"].map(|name| (name, fs::read(inner.join(name)).unwrap()));
    check("recording", &files.originals(), |number, bytes| {
        tables.iter().for_each(|(name, table)| fs::write(inner.join(name), table).unwrap());
        files.with(number, bytes, |_| {
            if files.names[number].ends_with(".bin") {
                originals::seal_blocks(&inner);
            }
            read_recording(folder.path())
        })
    });
}

/// Opens a recording and reads everything in it; returns whether all of it could be read.
fn read_recording(folder: &Path) -> bool {
    let Ok(recording) = Recording::open(folder) else { return false };
    let is_readable = |moment| recording.images(moment).is_ok() && recording.shape(moment).is_ok();
    let unreadable = (0..recording.moments().len()).filter(|&moment| !is_readable(moment)).count();
    unreadable == 0 && recording.warnings().is_empty() && !recording.moments().is_empty()
}

fn mesh(reader: &str, format: Format) {
    let originals: Vec<Original> = originals::meshes(format).into_iter().map(Original::new).collect();
    check(reader, &originals, |_, bytes| {
        let Ok((mesh, _)) = mvt_mesh::read_bytes(bytes, format, reader) else { return false };
        // As `score` does, and every command that takes an object.
        let is_sound = mvt_mesh::check(&mesh).is_ok() && mesh.area_m2() > 0.0;
        mvt_mesh::repair(&mesh, reader).is_ok() && is_sound
    });
}

#[test]
fn obj() {
    mesh("obj", Format::Obj);
}

#[test]
fn stl() {
    mesh("stl", Format::Stl);
}

#[test]
fn ply() {
    mesh("ply", Format::Ply);
}

/// Numbers that no run has must not reach the page.
#[test]
fn report_of_runs() {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    copy_run(&run);
    let line = serde_json::json!({
        "object": "a", "seed": 1, "cameras": "side", "mode": "slam", "modality": "vi", "variant": "full", "frames": 9, "hidden": 0.5,
        "f_score": {"5": 0.9}, "add_s_mm": {"mean": 1.5, "median": 1.0, "p95": 2.0, "final": 1.0}, "lost_frames": 1,
    });
    fs::write(folder.path().join("runs.jsonl"), format!("{line}\n").repeat(2)).unwrap();
    let names = vec!["runs.jsonl", "run/summary.json", "run/trajectory.csv", "run/config.toml", "run/mesh.ply"];
    let files = Files { folder: folder.path().to_owned(), names };
    check("report_of_runs", &files.originals(), |number, bytes| {
        files.with(number, bytes, |place| {
            let Ok(runs) = mvt_report::RunCollection::read(&[place.to_path_buf()]) else { return false };
            let choice = mvt_report::MediaChoice { films: 0, shapes: 1 };
            let (page, warnings) = mvt_report::html(&runs, Some(&runs), choice);
            for wrong in ["NaN", "\"inf", " inf"] {
                assert!(!page.contains(&format!("=\"{wrong}")) && !page.contains(&format!("L{wrong}")), "{wrong}");
            }
            runs.warnings.is_empty() && warnings.is_empty()
        })
    });
}

#[test]
fn poses() {
    let least = b"time_s,x_m,y_m,z_m,qw,qx,qy,qz\n0,0,0,0,1,0,0,0\n0.1,0,0.01,0,0.7,0.7,0,0\n";
    let originals = [Original::new(of_run("trajectory.csv")), Original::new(least.to_vec())];
    let surface = mvt_metrics::TrueSurface::new(&mesh_of_box(), 200, 0);
    check("poses", &originals, |_, bytes| {
        let text = String::from_utf8_lossy(bytes);
        report::stated_coordinates(&text);
        let Ok(rows) = report::read_trajectory(&text) else { return false };
        report::ErrorStatistics::new(&report::scored(rows, &surface), |row| Some(row.add_s?.one_directional_m));
        true
    });
}

fn mesh_of_box() -> mvt_mesh::Mesh {
    mvt_mesh::read_bytes(&originals::meshes(Format::Obj)[0], Format::Obj, "box").unwrap().0
}

/// RGB-D sequences of other programs.
#[test]
fn rgbd() {
    let stamp = "1581120424100262102";
    let owned = |name: String| -> &'static str { Box::leak(name.into_boxed_str()) };
    let cases = [
        (
            sequences::folders(),
            vec![
                "cam_K.txt",
                "annotated_poses/0000000.txt",
                owned(format!("depth/{stamp}.png")),
                owned(format!("masks/{stamp}.png")),
                owned(format!("rgb/{stamp}.png")),
            ],
        ),
        (sequences::bop(), vec!["scene_camera.json", "scene_gt.json", "rgbd.toml", "rgb/000000.jpg"]),
        (sequences::ho3d(), vec!["meta/0000.pkl", "depth/0000.png", "seg/0000.png"]),
        (sequences::tum(), vec!["rgb.txt", "depth.txt", "groundtruth.txt"]),
        (sequences::described(), vec!["rgbd.toml"]),
    ];
    for (folder, names) in &cases {
        let files = Files { folder: folder.path().to_owned(), names: names.clone() };
        check("rgbd", &files.originals(), |number, bytes| {
            files.with(number, bytes, |place| {
                RgbdRecording::open(place)
                    .is_ok_and(|recording| (0..recording.len()).all(|k| recording.frame(k).is_ok()))
            })
        });
    }
}

/// Bags with their choice of topics, and masks beside them.
#[test]
fn bags() {
    let folder = tempfile::tempdir().unwrap();
    let pixels = [0, 0, 0, 0, 0, 1, 1, 0, 0, 0, 0, 0];
    let mut messages: Vec<small_bags::Written<'_>> = Vec::new();
    for stamp_ns in [1_000_000_000, 1_033_000_000] {
        messages.extend(small_bags::frame(stamp_ns, stamp_ns));
        let mask = small_bags::image(stamp_ns, "mono8", [4, 3], 4, &pixels);
        messages.push(small_bags::Written(stamp_ns, "/mask", small_bags::IMAGE, mask));
    }
    fs::write(folder.path().join("a.mcap"), small_bags::mcap(&messages, "cdr")).unwrap();
    fs::create_dir(folder.path().join("masks")).unwrap();
    image::GrayImage::from_vec(4, 3, pixels.to_vec()).unwrap().save(folder.path().join("masks/1.png")).unwrap();
    fs::write(folder.path().join("bag.toml"), "masks = \"masks/*.png\"\nslop_s = 0.01\n").unwrap();
    let files = Files { folder: folder.path().to_owned(), names: vec!["a.mcap", "bag.toml", "masks/1.png"] };
    check("bags", &files.originals(), |number, bytes| {
        files.with(number, bytes, |place| {
            RgbdSequence::open(place).is_ok_and(|mut sequence| (0..sequence.len()).all(|k| sequence.frame(k).is_ok()))
        })
    });
}
