//! The mesh library without a network: small archives, complete and damaged.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a failed assumption in a test is a failed test"
)]

use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use flate2::Compression;
use flate2::write::GzEncoder;
use mvt_objects::assets::{AssetsError, FileState, Library, PinnedMesh, YCB};

// SHA-256 of "abc" (FIPS 180-2, appendix B.1) and of the empty string.
const ABC: &str = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
const EMPTY: &str = "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855";
const FILES: [PinnedMesh; 2] = [PinnedMesh { name: "one", sha256: ABC }, PinnedMesh { name: "two", sha256: EMPTY }];

fn archive(folder: &Path, entries: &[(&str, &[u8])]) -> PathBuf {
    let mut tar = tar::Builder::new(GzEncoder::new(Vec::new(), Compression::default()));
    for (name, bytes) in entries {
        let mut header = tar::Header::new_gnu();
        header.set_size(bytes.len() as u64);
        header.set_mode(0o644);
        // Writes the name by hand, because the builder refuses the names that an attacker would use.
        header.as_old_mut().name[..name.len()].copy_from_slice(name.as_bytes());
        header.set_cksum();
        tar.append(&header, *bytes).unwrap();
    }
    let path = folder.join("archive.tar.gz");
    fs::write(&path, tar.into_inner().unwrap().finish().unwrap()).unwrap();
    path
}

fn good(library: &Library) -> usize {
    library.verify().iter().filter(|(_, state)| matches!(state, FileState::Good)).count()
}

fn leftovers(folder: &Path) -> Vec<String> {
    let names = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
    names.filter(|name| name != "archive.tar.gz" && name != "meshes").collect()
}

#[test]
fn an_archive_is_unpacked_verified_listed_and_cleaned() {
    let folder = tempfile::tempdir().unwrap();
    let library = Library::new(folder.path().join("meshes"), FILES.to_vec());
    assert_eq!(good(&library), 0);
    assert!(matches!(library.read("one"), Err(AssetsError::Missing { .. })));
    let path = archive(folder.path(), &[("p/one.stl", b"abc"), ("p/setup.py", b"evil"), ("p/two.stl", b"")]);
    let mut progress = Vec::new();
    library.unpack(&path, &mut |done, of| progress.push((done, of))).unwrap();
    assert_eq!(progress, [(1, 2), (2, 2)]);
    assert_eq!(library.read("one").unwrap(), b"abc");
    assert_eq!(good(&library), 2);
    assert_eq!(library.list().iter().map(|item| item.bytes).collect::<Vec<_>>(), [Some(3), Some(0)]);
    assert!(leftovers(folder.path()).is_empty());

    // Verification finds a changed file, and unpacking again replaces it.
    fs::write(library.folder().join("one.stl"), "abd").unwrap();
    assert!(matches!(library.read("one"), Err(AssetsError::WrongHash { expected: ABC, .. })));
    assert!(matches!(&library.verify()[0], ("one", FileState::Bad(AssetsError::WrongHash { .. }))));
    library.unpack(&path, &mut |_, _| {}).unwrap();
    assert_eq!(good(&library), 2);

    // The staging folder of a killed process is removed, other folders stay.
    fs::create_dir_all(folder.path().join("meshes.1234.partial")).unwrap();
    fs::create_dir_all(folder.path().join("meshes.mine")).unwrap();
    let cleaned = library.clean(&YCB_NOT_CACHED).unwrap();
    assert_eq!((cleaned.files, cleaned.bytes), (2, 3));
    assert!(!library.folder().exists());
    assert_eq!(leftovers(folder.path()), ["meshes.mine"]);
}

/// The archive of YCB, under a name that is not in any cache.
const YCB_NOT_CACHED: mvt_pinned::Archive = mvt_pinned::Archive { file: "no-such-archive.tar.gz", ..YCB };

#[test]
fn damaged_archives_leave_nothing_behind() {
    let folder = tempfile::tempdir().unwrap();
    let library = Library::new(folder.path().join("meshes"), FILES.to_vec());
    let refuse = |path: &Path| {
        let error = library.unpack(path, &mut |_, _| {}).unwrap_err();
        assert_eq!(good(&library), 0);
        assert!(!library.folder().exists() && leftovers(folder.path()).is_empty());
        error.to_string()
    };
    let path = archive(folder.path(), &[("p/one.stl", b"abc")]);
    assert!(refuse(&path).contains("it has no two.stl"));
    let path = archive(folder.path(), &[("p/one.stl", b"abd"), ("p/two.stl", b"")]);
    assert!(refuse(&path).contains(ABC));

    let path = archive(folder.path(), &[("p/one.stl", b"abc"), ("p/two.stl", b"")]);
    let whole = fs::read(&path).unwrap();
    for cut in 0..whole.len() {
        // A cut within the padding after the last file loses no data.
        fs::write(&path, &whole[..cut]).unwrap();
        if library.unpack(&path, &mut |_, _| {}).is_ok() {
            assert_eq!(good(&library), 2, "cut at {cut}");
            fs::remove_dir_all(library.folder()).unwrap();
        }
        assert!(leftovers(folder.path()).is_empty());
    }
    for at in 0..whole.len() {
        let mut bent = whole.clone();
        bent[at] ^= 0x10;
        fs::write(&path, &bent).unwrap();
        if library.unpack(&path, &mut |_, _| {}).is_ok() {
            assert_eq!(good(&library), 2, "bent at {at}");
            fs::remove_dir_all(library.folder()).unwrap();
        }
    }
}

#[test]
fn names_in_an_archive_are_never_used_as_paths() {
    let folder = tempfile::tempdir().unwrap();
    let library = Library::new(folder.path().join("inner/meshes"), FILES.to_vec());
    let entries: [(&str, &[u8]); 3] = [("../../one.stl", b"abc"), ("/two.stl", b""), ("../evil.stl", b"x")];
    let path = archive(folder.path(), &entries);
    library.unpack(&path, &mut |_, _| {}).unwrap();
    let made: Vec<_> = fs::read_dir(library.folder()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(made.len(), 2, "{made:?}");
    assert!(!folder.path().join("one.stl").exists() && !folder.path().join("evil.stl").exists());
}

#[test]
fn a_folder_that_cannot_be_written_is_named() {
    let folder = tempfile::tempdir().unwrap();
    // A file in the place of a folder stops every user. Permissions would not stop root.
    let blocked = folder.path().join("file");
    fs::File::create(&blocked).unwrap().write_all(b"x").unwrap();
    let library = Library::new(blocked.join("meshes"), FILES.to_vec());
    let path = archive(folder.path(), &[("one.stl", b"abc"), ("two.stl", b"")]);
    let error = library.unpack(&path, &mut |_, _| {}).unwrap_err();
    assert!(matches!(&error, AssetsError::Io { path, .. } if path.starts_with(&blocked)), "{error}");
}

#[test]
fn the_users_folder_may_have_either_layout_and_only_the_object_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let library = Library::read_only(folder.path().to_owned(), FILES.to_vec());
    let said = |name| library.read(name).unwrap_err().to_string();
    let named = folder.path().display().to_string();
    let missing = said("two");
    for part in ["YCB_DIR", &named, "neither two.stl nor two/google_16k/nontextured.stl"] {
        assert!(missing.contains(part), "{missing} lacks {part}");
    }
    // The file of another object is not needed.
    fs::create_dir_all(folder.path().join("two/google_16k")).unwrap();
    fs::write(folder.path().join("two/google_16k/nontextured.stl"), "").unwrap();
    assert_eq!(library.read("two").unwrap(), b"");
    fs::write(folder.path().join("one.stl"), "abc").unwrap();
    assert_eq!(library.read("one").unwrap(), b"abc");
    assert_eq!(good(&library), 2);
    fs::write(folder.path().join("one.stl"), "abd").unwrap();
    let other = said("one");
    for part in ["one.stl is not the published mesh", ABC, "YCB_DIR", "give the path of the file as the object"] {
        assert!(other.contains(part), "{other} lacks {part}");
    }
}
