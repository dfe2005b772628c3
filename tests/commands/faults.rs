//! Disk full, read-only, no network, damaged downloads: one clear line and exit code 1.

use std::fs;
use std::process::Command;

use crate::workplace::{Ended, Workplace};

const LINE: &str = "generate --object cube70 --logs 1 --duration 0.4 --out";

#[test]
fn an_output_that_cannot_be_made_is_named() {
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
    if fs::write(folder.join("probe"), "").is_ok() {
        eprintln!("skipped: this user may write into read-only folders");
        return;
    }
    let said = workplace.run(&format!("{LINE} locked/set")).error();
    assert!(said.contains("locked/set") && said.contains("denied"), "{said}");
    fs::set_permissions(&folder, fs::Permissions::from_mode(0o755)).unwrap();
}

/// Runs the program in a shell that first does something, which tells `Err` where it cannot.
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

/// A limit on the size of files stands for a full disk where nobody may mount one: both make a write fail.
#[cfg(unix)]
#[test]
fn a_write_that_fails_leaves_no_log() {
    let workplace = Workplace::new();
    // 512-byte blocks: less than the depths of the camera need.
    match under(&workplace, "trap '' XFSZ && ulimit -f 60", &format!("{LINE} set")) {
        Ok(ended) => assert!(ended.error().contains("set/cube70/.00.partial")),
        Err(reason) => return eprintln!("skipped: {reason}"),
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
    // A mount in a name space of its own is gone with the command. Files that are left would be more than one line.
    let script = format!("{mount} && \"$0\" {LINE} disk/set; code=$?; find disk -type f >&2; exit $code");
    let program = workplace.command("");
    let mut shell = Command::new("unshare");
    shell.args(["--mount", "--map-root-user", "sh", "-c", &script]).arg(program.get_program());
    let Ok(output) = shell.current_dir(workplace.path("")).output() else {
        return eprintln!("skipped: there is no unshare");
    };
    let said = String::from_utf8_lossy(&output.stderr);
    if !said.contains("disk/set") {
        return eprintln!("skipped: no file system can be mounted here: {said}");
    }
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("No space left on device") && said.lines().count() == 1, "{said}");
}

#[test]
fn without_pip_or_network_a_mesh_is_not_had() {
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

    // pip is there, the index is not.
    let offline = ended("simulate --object 077_rubiks_cube", "PIP_NO_INDEX", "1");
    let said = offline.stderr.lines().last().unwrap_or_default();
    assert!(offline.code == Some(1) && said.starts_with("ERROR") && said.contains("YCB_ARCHIVE"), "{offline:?}");
    assert!(!offline.stderr.contains("Traceback"), "{offline:?}");
    assert_eq!(workplace.files("cache").len(), 0, "something was left in the cache");
    // What needs no download works.
    ended("simulate --object cube70 --duration 0.2", "PATH", "").good();
}

#[test]
fn damaged_meshes_are_not_used() {
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
fn a_folder_of_the_users_own_is_read_only_to_us() {
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
