//! A full disk, a read-only folder, no network and damaged downloads lead to one clear line and exit code 1.

use std::fs;
use std::process::Command;

use crate::workplace::{Ended, Workplace, skip};

const LINE: &str = "generate --object cube70 --logs 1 --duration 0.4 --out";

#[test]
fn a_folder_that_cannot_be_made_is_named() {
    let workplace = Workplace::new();
    workplace.write("file", "");
    assert!(workplace.run(&format!("{LINE} file/set")).error().contains("file/set"));
    assert!(workplace.run(&format!("{LINE} file")).error().contains("file"));
    assert_eq!(fs::read(workplace.path("file")).unwrap(), b"");
}

#[cfg(unix)]
#[test]
fn a_read_only_folder_is_named() {
    use std::os::unix::fs::PermissionsExt as _;
    let workplace = Workplace::new();
    let folder = workplace.path("locked");
    fs::create_dir(&folder).unwrap();
    fs::set_permissions(&folder, fs::Permissions::from_mode(0o555)).unwrap();
    let is_root = fs::write(folder.join("probe"), "").is_ok();
    let ended = if is_root {
        let _ = fs::remove_file(folder.join("probe"));
        // Root may write into read-only folders unless it gives up these capabilities.
        const WITHOUT: &str = "-dac_override,-dac_read_search";
        let mut command = Command::new("setpriv");
        command.args(["--bounding-set", WITHOUT, "--inh-caps", WITHOUT]).arg(workplace.command("").get_program());
        command.args(format!("{LINE} locked/set").split_whitespace()).current_dir(workplace.path(""));
        if Command::new("setpriv").args(["--bounding-set", WITHOUT, "true"]).status().is_ok_and(|it| it.success()) {
            Ended::of(&mut command)
        } else {
            return skip("root may write into read-only folders, and setpriv does not work here");
        }
    } else {
        workplace.run(&format!("{LINE} locked/set"))
    };
    let said = ended.error();
    assert!(said.contains("locked/set") && said.contains("denied"), "{said}");
    fs::set_permissions(&folder, fs::Permissions::from_mode(0o755)).unwrap();
}

/// Runs the program in a shell after another command; returns `Err` if that command fails.
#[cfg(unix)]
fn under(workplace: &Workplace, before: &str, arguments: &str) -> Result<Ended, String> {
    const NOT_POSSIBLE: i32 = 77;
    let script = format!("{{ {before}; }} >/dev/null 2>&1 || exit {NOT_POSSIBLE}; exec \"$0\" {arguments}");
    let program = workplace.command("");
    let mut shell = Command::new("sh");
    shell.arg("-c").arg(script).arg(program.get_program()).current_dir(workplace.path(""));
    let ended = Ended::of(&mut shell);
    if ended.code == Some(NOT_POSSIBLE) { Err(format!("`{before}` is not possible here")) } else { Ok(ended) }
}

/// A limit on the size of files makes a write fail as a full disk does, also where no disk can be mounted.
#[cfg(unix)]
#[test]
fn a_write_that_fails_leaves_no_log() {
    let workplace = Workplace::new();
    // 512-byte blocks: less than the depths of the camera need.
    match under(&workplace, "trap '' XFSZ && ulimit -f 60", &format!("{LINE} set")) {
        Ok(ended) => assert!(ended.error().contains("set/cube70/.00.partial")),
        Err(reason) => return skip(&reason),
    }
    assert_eq!(workplace.files("set").len(), 0);
    workplace.run(&format!("{LINE} set")).good();
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_leaves_no_log() {
    let workplace = Workplace::new();
    fs::create_dir(workplace.path("disk")).unwrap();
    let mount = "mount -t tmpfs -o size=600k tmpfs disk";
    // The mount ends with the command, because it has its own name space. `find` prints a line for each file that is
    // left.
    let script =
        format!("{mount} && \"$0\" {LINE} disk/set; code=$?; find disk -type f ! -name .mambavitact >&2; exit $code");
    let program = workplace.command("");
    let mut shell = Command::new("unshare");
    shell.args(["--mount", "--map-root-user", "sh", "-c", &script]).arg(program.get_program());
    let Ok(output) = shell.current_dir(workplace.path("")).output() else {
        return skip("the command unshare is missing");
    };
    let said = String::from_utf8_lossy(&output.stderr);
    if !said.contains("disk/set") {
        return skip(&format!("no file system can be mounted here: {said}"));
    }
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("No space left on device") && said.lines().count() == 1, "{said}");
}

#[test]
fn without_pip_or_network_the_missing_meshes_are_explained() {
    let workplace = Workplace::new();
    fs::create_dir(workplace.path("cache")).unwrap();
    let ended = |arguments: &str, name: &str, value: &str| {
        let mut command = workplace.command(arguments);
        Ended::of(command.env("XDG_CACHE_HOME", workplace.path("cache")).env(name, value))
    };
    for arguments in
        ["simulate --object 077_rubiks_cube", "generate --object 077_rubiks_cube --out set", "assets fetch"]
    {
        let said = ended(arguments, "PATH", "").error();
        assert!(said.contains("pip") && said.contains("YCB_ARCHIVE"), "{said}");
    }
    assert_eq!(workplace.files("set").len(), 0);
    let said = ended("assets verify", "PATH", "").error();
    assert!(said.contains("78 of 78 meshes are missing") && said.contains("assets fetch"), "{said}");

    // pip is installed, but its index cannot be reached.
    let offline = ended("simulate --object 077_rubiks_cube", "PIP_NO_INDEX", "1");
    let said = offline.stderr.lines().last().unwrap_or_default();
    assert!(offline.code == Some(1) && said.starts_with("ERROR") && said.contains("YCB_ARCHIVE"), "{offline:?}");
    assert!(!offline.stderr.contains("Traceback"), "{offline:?}");
    assert_eq!(workplace.files("cache").len(), 0, "the cache contains files");
    // Objects without a download work.
    ended("simulate --object cube70 --duration 0.2", "PATH", "").good();
}

#[test]
fn damaged_meshes_are_refused() {
    let workplace = Workplace::new();
    fs::create_dir_all(workplace.path("cache/mambavitact/ycb")).unwrap();
    let mesh = "cache/mambavitact/ycb/077_rubiks_cube.stl";
    workplace.write(mesh, "solid nonsense");
    let ended = |arguments: &str| {
        Ended::of(workplace.command(arguments).env("XDG_CACHE_HOME", workplace.path("cache")).env("PATH", ""))
    };
    let said = ended("simulate --object 077_rubiks_cube").error();
    for part in ["077_rubiks_cube.stl", "SHA-256", "expected 33e4f6da", "assets fetch"] {
        assert!(said.contains(part), "{said} lacks {part}");
    }
    let verified = ended("assets verify");
    assert_eq!(verified.code, Some(1));
    assert!(verified.stderr.contains("77 of 78 meshes are missing and 1 are damaged"), "{verified:?}");
    ended("assets clean").good();
    assert!(!workplace.path(mesh).exists());

    workplace.write("archive.tar.gz", "not the archive");
    let with_archive = |arguments: &str| {
        let mut command = workplace.command(arguments);
        command.env("XDG_CACHE_HOME", workplace.path("cache")).env("YCB_ARCHIVE", workplace.path("archive.tar.gz"));
        Ended::of(&mut command)
    };
    let said = with_archive("assets fetch").error();
    assert!(said.contains("archive.tar.gz") && said.contains("SHA-256"), "{said}");
    assert!(workplace.path("archive.tar.gz").exists());
}

#[test]
fn the_users_own_folder_of_meshes_is_never_changed() {
    let workplace = Workplace::new();
    fs::create_dir(workplace.path("mine")).unwrap();
    workplace.write("mine/077_rubiks_cube.stl", "solid nonsense");
    workplace.write("mine/other.stl", "solid other");
    let ended =
        |arguments: &str, folder: &str| Ended::of(workplace.command(arguments).env("YCB_DIR", workplace.path(folder)));
    for (folder, arguments) in [
        ("mine", "simulate --object 077_rubiks_cube"),
        ("mine", "simulate --object 013_apple"),
        ("mine", "assets fetch"),
        ("mine", "assets clean"),
        ("nowhere", "simulate --object 013_apple"),
    ] {
        let said = ended(arguments, folder).error();
        assert!(said.contains("YCB_DIR") && said.contains(folder), "{arguments}: {said}");
    }
    assert_eq!(workplace.files("mine").len(), 2);
    assert!(!workplace.path("nowhere").exists());
}
