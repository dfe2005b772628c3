//! Results that nobody reads, or that cannot be written.

use std::process::Stdio;

use crate::workplace::Workplace;

#[test]
fn a_closed_pipe_ends_a_command_without_a_word() {
    let workplace = Workplace::new();
    workplace.run("run --object cube70 --duration 0.2 --quiet").good();
    for line in
        ["--help", "assets list", "completions bash", "score --run out", "simulate --object cube70 --duration 0.1"]
    {
        let mut child = workplace.command(line).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        // Before the program writes, as `head` may do.
        drop(child.stdout.take());
        let ended = child.wait_with_output().unwrap();
        assert!(ended.status.success() && ended.stderr.is_empty(), "{line}: {ended:?}");
    }
}

#[cfg(target_os = "linux")]
#[test]
fn a_result_that_cannot_be_written_is_an_error_in_words() {
    let workplace = Workplace::new();
    let full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
    let child = workplace.command("assets list").stdout(full).stderr(Stdio::piped()).spawn().unwrap();
    let ended = child.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&ended.stderr);
    assert_eq!(said, "ERROR cannot write to standard output: No space left on device\n");
    assert_eq!(ended.status.code(), Some(1));
}
