//! The repository's files, and Rust code without its comments, texts and tests.

use std::path::{Path, PathBuf};
use std::process::Command;

/// The folder of the workspace.
pub fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Files that git tracks or would track, relative to the root, sorted.
pub fn files() -> Vec<PathBuf> {
    let listed = |arguments: &[&str]| {
        let output = Command::new("git").arg("ls-files").args(arguments).current_dir(root()).output().unwrap();
        assert!(output.status.success(), "git ls-files: {}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    };
    let text = listed(&["-z", "--cached", "--others", "--exclude-standard"]);
    let mut files: Vec<PathBuf> = text.split_terminator('\0').map(PathBuf::from).collect();
    files.retain(|file| root().join(file).is_file());
    files.sort();
    files.dedup();
    files
}

/// Rust files below a folder, relative to the root.
pub fn rust_files(below: &Path) -> Vec<PathBuf> {
    let is_rust = |file: &PathBuf| file.starts_with(below) && file.extension().is_some_and(|ending| ending == "rs");
    files().into_iter().filter(is_rust).collect()
}

/// Whether all of a file below `src` is test code: `tests.rs` and the files of its submodules.
pub fn is_test_file(file: &Path) -> bool {
    file.iter().any(|part| part == "tests" || part == "tests.rs")
}

/// The code of a file below `src`, line by line as in the file: comments, the contents of texts, and test modules are blanks.
pub fn code(file: &Path) -> String {
    if is_test_file(file) { String::new() } else { without_tests(&blanked(&read(file))) }
}

/// The text of a file.
pub fn read(file: &Path) -> String {
    std::fs::read_to_string(root().join(file)).unwrap_or_else(|error| panic!("{}: {error}", file.display()))
}

/// Rust code in which comments and the contents of texts and characters are blanks.
pub fn blanked(text: &str) -> String {
    let source: Vec<char> = text.chars().collect();
    let mut out = String::with_capacity(text.len());
    let mut at = 0;
    while at < source.len() {
        let end = token_end(&source, at);
        let kept = end == at + 1;
        out.extend(source[at..end].iter().map(|&c| if kept || c == '\n' { c } else { ' ' }));
        at = end;
    }
    out
}

/// Where the comment, text or character ends that begins at a place; the next place if none begins there.
fn token_end(source: &[char], at: usize) -> usize {
    let is = |place: usize, wanted: &str| wanted.chars().enumerate().all(|(k, c)| source.get(place + k) == Some(&c));
    let find = |from: usize, wanted: &str| (from..source.len()).find(|&k| is(k, wanted)).unwrap_or(source.len());
    let previous = at.checked_sub(1).map(|k| source[k]);
    let after_name = previous.is_some_and(|c| c.is_alphanumeric() || c == '_');
    if is(at, "//") {
        return find(at, "\n");
    }
    if is(at, "/*") {
        let (mut depth, mut k) = (0, at);
        while k < source.len() {
            match () {
                () if is(k, "/*") => (depth, k) = (depth + 1, k + 2),
                () if is(k, "*/") => (depth, k) = (depth - 1, k + 2),
                () => k += 1,
            }
            if depth == 0 {
                break;
            }
        }
        return k;
    }
    // r"...", r#"..."#, br"...", but not the end of a name.
    let prefix = usize::from(is(at, "b"));
    if is(at + prefix, "r") && !after_name {
        let hashes = source[at + prefix + 1..].iter().take_while(|&&c| c == '#').count();
        let quote = at + prefix + 1 + hashes;
        if is(quote, "\"") {
            let ending = format!("\"{}", "#".repeat(hashes));
            return (find(quote + 1, &ending) + ending.len()).min(source.len());
        }
    }
    if is(at, "\"") {
        let mut k = at + 1;
        while k < source.len() && source[k] != '"' {
            k += if source[k] == '\\' { 2 } else { 1 };
        }
        return (k + 1).min(source.len());
    }
    // A character, not a lifetime.
    if is(at, "'\\") {
        return (find(at + 3, "'") + 1).min(source.len());
    }
    if is(at, "'") && source.get(at + 2) == Some(&'\'') {
        return at + 3;
    }
    at + 1
}

/// Blanked code in which items under `#[cfg(test)]` are blanks, too.
pub fn without_tests(code: &str) -> String {
    const MARK: &str = "#[cfg(test)]";
    let mut out = code.to_owned();
    while let Some(start) = out.find(MARK) {
        let end = item_end(&out, start + MARK.len());
        let blanks: String = out[start..end].chars().map(|c| if c == '\n' { '\n' } else { ' ' }).collect();
        out.replace_range(start..end, &blanks);
    }
    out
}

/// The end of the item after a place: of its body in braces, or its semicolon.
fn item_end(code: &str, from: usize) -> usize {
    let (mut braces, mut brackets) = (0, 0);
    for (k, c) in code[from..].char_indices() {
        match c {
            '{' => braces += 1,
            '}' => braces -= 1,
            '[' | '(' => brackets += 1,
            ']' | ')' => brackets -= 1,
            _ => {}
        }
        if braces == 0 && brackets == 0 && (c == '}' || c == ';') {
            return from + k + c.len_utf8();
        }
    }
    code.len()
}

#[test]
fn comments_texts_and_tests_are_blanks() {
    let text = "let a = \"x // y\"; // z.unwrap()\nlet b = r#\"\"panic!\"#; /* \"a /* */ */ let c: &'a u8 = &b'\"';\n\
                #[cfg(test)]\n#[allow(dead_code)]\nmod tests { fn f() { 1 } }\nfn g() {}\n";
    let code = without_tests(&blanked(text));
    assert_eq!(code.split_whitespace().collect::<String>(), "leta=;letb=;letc:&'au8=&b;fng(){}");
    assert_eq!(code.lines().count(), text.lines().count());
}
