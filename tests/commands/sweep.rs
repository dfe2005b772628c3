//! `sweep`: shards that are killed, tasks that fail, and results that equal those of one process to the byte.

use std::fs;
use std::path::Path;
use std::process::{Child, Stdio};

use crate::workplace::{Workplace, assert_same};

const SPEC: &str = "command = \"generate\"\n[fixed]\nduration = 0.2\nformat = \"compact\"\n[axes]\nobject = [\"cube70\", \"large_dice\"]\n\
                    seed = { from = 3, count = 3 }\n";

fn planned(spec: &str) -> Workplace {
    let workplace = Workplace::new();
    workplace.write("spec.toml", spec);
    assert!(workplace.run("sweep plan spec.toml --out s").good().contains("tasks of"));
    workplace
}

/// Names below a folder of the sweep, without unfinished files.
fn names(workplace: &Workplace, folder: &str) -> Vec<String> {
    let Ok(entries) = fs::read_dir(workplace.path(folder)) else { return Vec::new() };
    let name = |entry: std::io::Result<fs::DirEntry>| Some(entry.ok()?.file_name().to_str()?.to_owned());
    entries.filter_map(name).filter(|name| !name.starts_with('.')).collect()
}

fn results(workplace: &Workplace) -> Vec<String> {
    let parts = names(workplace, "s/done");
    parts
        .iter()
        .flat_map(|part| {
            names(workplace, &format!("s/done/{part}")).into_iter().map(move |id| format!("s/done/{part}/{id}"))
        })
        .collect()
}

/// Starts a shard as job `index` of an array of three.
fn job(workplace: &Workplace, index: u64) -> Child {
    let mut command = workplace.command("sweep run s --retries 100");
    for (end, value) in [("ID", index), ("COUNT", 3), ("MIN", 0), ("MAX", 2)] {
        command.env(format!("SLURM_ARRAY_TASK_{end}"), value.to_string());
    }
    command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
}

#[test]
fn a_killed_array_merges_to_the_bytes_of_one_process() {
    let workplace = planned(SPEC);
    let mut kills = 0;
    for round in 0..4 {
        let mut jobs: Vec<Child> = (0..3).map(|index| job(&workplace, index)).collect();
        // In the last rounds two processes do the same shard.
        jobs.extend((round > 1).then(|| job(&workplace, 0)));
        let before = results(&workplace).len();
        // Some are killed at their first file, some after a result.
        let has_come = || match round % 2 {
            0 => !names(&workplace, "s/partial").is_empty(),
            _ => results(&workplace).len() > before || before == 6,
        };
        while !has_come() && jobs.iter_mut().any(|job| job.try_wait().unwrap().is_none()) {
            std::thread::yield_now();
        }
        for mut job in jobs {
            job.kill().unwrap();
            kills += usize::from(!job.wait().unwrap().success());
        }
    }
    assert!(kills >= 3, "only {kills} processes were killed before they were done");
    for index in 0..3 {
        assert!(job(&workplace, index).wait().unwrap().success());
    }
    assert_eq!(
        workplace.run("sweep status s --check").good(),
        "6 tasks of generate: 6 done, 0 set aside, 0 begun, 0 waiting\n"
    );
    assert!(names(&workplace, "s/partial").is_empty() && names(&workplace, "s/attempts").is_empty());
    workplace.run("sweep merge s --out merged").good();
    // One process on one machine, and the command `generate` itself.
    workplace.run("sweep plan spec.toml --out t").good();
    workplace.run("sweep run t --jobs 2").good();
    workplace.run("sweep merge t --out alone").good();
    assert_same(&workplace.files("alone"), &workplace.files("merged"));
    workplace
        .run("generate --object cube70 --object large_dice --logs 3 --seed 3 --duration 0.2 --format compact --out set")
        .good();
    let mut logs = workplace.files("merged");
    let index = String::from_utf8(logs.remove(Path::new("sweep.jsonl")).unwrap()).unwrap();
    assert!(index.lines().count() == 6 && index.contains("\"log\":\"large_dice/02\""), "{index}");
    assert_same(&workplace.files("set"), &logs);
    // Finished tasks are not done again.
    let said = workplace.run("sweep run s").good();
    assert!(said.starts_with("shard 0/1: 0 tasks done, 6 were done before"), "{said}");
}

#[test]
fn a_failed_task_is_set_aside_with_its_reason() {
    let workplace = Workplace::new();
    workplace.write("broken.obj", "v 0 0\n");
    workplace.write("spec.toml", SPEC.replace("\"large_dice\"", "\"broken.obj\"").replace("count = 3", "count = 1"));
    workplace.run("sweep plan spec.toml --out s").good();
    let ended = workplace.run("sweep run s --retries 1");
    assert_eq!(ended.code, Some(1), "{ended:?}");
    assert_eq!(ended.stderr.matches("of 2: ").count(), 2, "each attempt is reported: {ended:?}");
    assert!(ended.stderr.contains("1 tasks are set aside"), "{ended:?}");
    let status = workplace.run("sweep status s").good();
    assert!(
        status.starts_with("2 tasks of generate: 1 done, 1 set aside, 0 begun, 0 waiting\nset aside: "),
        "{status}"
    );
    assert!(status.contains("object=broken.obj") && status.contains("broken.obj"), "{status}");
    let json = workplace.run("sweep status s --json").json();
    assert_eq!((&json["done"], &json["set_aside"]), (&1.into(), &1.into()));
    let said = workplace.run("sweep merge s --out m").error();
    assert!(said.contains("1 of 2 tasks have no result") && said.contains("--partial"), "{said}");
    assert!(!workplace.path("m").exists());
    assert_eq!(workplace.run("sweep merge s --out m --partial").good(), "1 results in m\n");
    assert_eq!(workplace.logs("m"), ["m/cube70/00"]);
    workplace.run("inspect m/cube70/00").good();
    assert_eq!(workplace.run("sweep retry s").good(), "1 tasks wait again\n");
    assert!(workplace.run("sweep status s").good().contains("1 waiting"));
    // Another file of that name is another task.
    workplace.write("broken.obj", "v 0 0 0\n");
    let said = workplace.run("sweep run s").error();
    assert!(said.contains("was changed after it was planned"), "{said}");
}

#[test]
fn results_that_do_not_fit_are_found_and_done_again() {
    let workplace = planned(&SPEC.replace(", \"large_dice\"", "").replace("count = 3", "count = 2"));
    workplace.run("sweep run s").good();
    let first = results(&workplace).remove(0);
    let whole = workplace.files(&first);
    let frames = format!("{first}/log/frames.zip");
    let mut bytes = fs::read(workplace.path(&frames)).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    workplace.write(&frames, &bytes);
    let status = workplace.run("sweep status s --check").good();
    assert!(status.contains("frames.zip does not fit its manifest") && status.lines().count() == 2, "{status}");
    assert!(workplace.run("sweep merge s --out m").error().contains("frames.zip does not fit its manifest"));
    fs::remove_file(workplace.path(&frames)).unwrap();
    assert!(workplace.run("sweep merge s --out m --partial").error().contains("frames.zip is missing"));
    assert!(workplace.run("sweep retry s --damaged").warned().contains("frames.zip is missing"));
    workplace.run("sweep run s").good();
    assert_same(&whole, &workplace.files(&first));
    assert_eq!(names(&workplace, "s/damaged").len(), 1);
    // A plan of another version, and one that was changed.
    let plan = workplace.text("s/plan.json");
    let version = format!("\"{}\"", env!("CARGO_PKG_VERSION"));
    workplace.write("s/plan.json", plan.replace(&version, "\"0.0.1\""));
    let said = workplace.run("sweep status s").good();
    assert!(said.contains("problem: the plan is of version 0.0.1"), "{said}");
    for command in ["sweep run s", "sweep merge s --out m"] {
        assert!(workplace.run(command).error().contains("version 0.0.1"), "{command}");
    }
    workplace.write("s/plan.json", plan);
    let tasks = workplace.text("s/tasks.jsonl");
    workplace.write("s/tasks.jsonl", tasks.replace("0.2", "0.3"));
    for command in ["sweep run s", "sweep merge s --out m"] {
        assert!(workplace.run(command).error().contains("tasks.jsonl was changed after it was planned"), "{command}");
    }
}

#[test]
fn mistakes_in_a_specification_are_named() {
    let workplace = Workplace::new();
    let said = |spec: &str| {
        workplace.write("spec.toml", spec);
        workplace.run("sweep plan spec.toml --out s").error()
    };
    for (from, to, words) in [
        ("count = 3", "count = 500000", "lead to 1000000 tasks, more than 100000"),
        ("[fixed]", "[fixed]\nspeed = 3", "speed"),
        ("\"cube70\"", "\"cube71\"", "cube71"),
        ("[\"cube70\", \"large_dice\"]", "[]", "axis object is empty"),
        ("0.2", "-0.2", "duration"),
        ("\"compact\"", "\"tiny\"", "tiny"),
        ("object = [\"cube70\", \"large_dice\"]\n", "", "object is missing"),
        ("[axes]", "[axes]\ncameras = [\"side\", \"below\"]", "below"),
        ("[axes]", "[axes]\ngait = [\"stroll\"]", "stroll"),
        ("\"generate\"", "\"evaluate\"", "format"),
    ] {
        let said = said(&SPEC.replace(from, to));
        assert!(said.contains(words) && said.contains("spec.toml"), "{words}: {said}");
    }
    assert!(!workplace.path("s").exists());
    workplace.write("spec.toml", SPEC);
    workplace.run("sweep plan spec.toml --out s").good();
    // The same plan again is no mistake, another one is.
    workplace.run("sweep plan spec.toml --out s").good();
    assert!(said(&SPEC.replace("0.2", "0.3")).contains("holds the plan of other tasks"));
    assert!(workplace.run("sweep run nowhere").error().contains("holds no plan"));
    assert!(workplace.run("sweep run s --shard 3/3").usage().contains("0 to N - 1"));
}

#[test]
fn runs_are_tasks_and_merge_to_tables() {
    let spec = "command = \"evaluate\"\n[fixed]\nduration = 0.3\ntouch_depth = \"truth\"\nslam.scan.camera_hits = 60\n[axes]\n\
                object = [\"rubiks_cube_small\"]\nmode = [\"slam\", \"pose\"]\n";
    let workplace = planned(spec);
    for shard in ["0/2", "1/2"] {
        workplace.run(&format!("sweep run s --shard {shard}")).good();
    }
    workplace.run("sweep merge s --out m").good();
    workplace.run("sweep plan spec.toml --out t").good();
    workplace.run("sweep run t").good();
    workplace.run("sweep merge t --out n").good();
    assert_same(&workplace.files("n"), &workplace.files("m"));
    let lines = workplace.text("m/runs.jsonl");
    let modes: Vec<serde_json::Value> = lines.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!((&modes[0]["mode"], &modes[1]["mode"]), (&"slam".into(), &"pose".into()));
    // They are the runs of `evaluate`, but for the clock.
    let set = "--set slam.scan.camera_hits=60";
    let line =
        "evaluate --objects rubiks_cube_small --seeds 1 --modalities vitac --duration 0.3 --touch-depth truth --out e";
    workplace.run(&format!("{line} {set}")).good();
    let evaluated = workplace.text("e/runs.jsonl");
    for mut other in evaluated.lines().map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap()) {
        other["frames_per_second"] = serde_json::Value::Null;
        assert!(modes.contains(&other), "{other}\n{lines}");
    }
}

/// A job as Slurm starts it: the script that `sweep slurm` prints, with stand-ins for sbatch and scontrol.
#[cfg(unix)]
#[test]
fn a_warned_job_finishes_its_task_and_is_queued_again() {
    use std::os::unix::fs::PermissionsExt as _;

    let workplace = planned(&SPEC.replace("count = 3", "count = 10"));
    fs::create_dir(workplace.path("bin")).unwrap();
    for (name, script) in [
        ("sbatch", "#!/bin/sh\necho \"$@\" >> sbatch.txt; echo 17\n"),
        ("scontrol", "#!/bin/sh\necho \"$@\" >> scontrol.txt\n"),
    ] {
        workplace.write(&format!("bin/{name}"), script);
        fs::set_permissions(workplace.path(&format!("bin/{name}")), fs::Permissions::from_mode(0o755)).unwrap();
    }
    let path = format!("{}:{}", workplace.path("bin").display(), std::env::var("PATH").unwrap());
    let script = workplace.run("sweep slurm s --shards 1").good();
    assert!(script.starts_with("#!/bin/bash\n#SBATCH") && script.contains("#SBATCH --array=0-0"), "{script}");
    assert!(!workplace.path("s/slurm.sh").exists());
    let ended = workplace.command("sweep slurm s --shards 1 --submit").env("PATH", &path).output().unwrap();
    assert!(String::from_utf8(ended.stdout).unwrap().starts_with("job 17, array 0-0\n"));
    assert_eq!(workplace.text("s/slurm.sh"), script);
    assert!(workplace.path("s/logs").is_dir() && workplace.path("sbatch.txt").exists());

    let job = |signal: Option<&str>| {
        let mut job = std::process::Command::new("bash")
            .arg(workplace.path("s/slurm.sh"))
            .env("PATH", &path)
            .env("SLURM_ARRAY_JOB_ID", "17")
            .env("SLURM_ARRAY_TASK_ID", "0")
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        while signal.is_some() && results(&workplace).is_empty() && job.try_wait().unwrap().is_none() {
            std::thread::yield_now();
        }
        if let Some(signal) = signal {
            crate::workplace::signal(&job, signal);
        }
        job.wait().unwrap().success()
    };
    assert!(!job(Some("USR1")));
    let done = results(&workplace).len();
    assert!((1..20).contains(&done), "{done}");
    // The task in hand was finished.
    assert!(names(&workplace, "s/partial").is_empty() && names(&workplace, "s/attempts").is_empty());
    assert_eq!(workplace.text("scontrol.txt"), "requeue 17_0\n");
    assert!(job(None));
    assert_eq!(results(&workplace).len(), 20);
}
