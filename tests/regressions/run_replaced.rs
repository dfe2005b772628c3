//! A second run replaced the results of the first, also those that it resumed.

use crate::workplace::{Workplace, assert_same};

#[test]
fn an_earlier_run_is_moved_and_never_replaced() {
    let workplace = Workplace::new();
    workplace.run("run --object cube70 --duration 0.4 --quiet").good();
    let first = workplace.files("out");
    let said = workplace.run("run --object cube70 --duration 0.2 --resume out --out out --quiet").warned();
    assert!(said.contains("out.1"), "{said}");
    assert_same(&first, &workplace.files("out.1"));
    let second = workplace.files("out");
    workplace.run("run --object cube70 --duration 0.2 --quiet").warned();
    assert_same(&first, &workplace.files("out.1"));
    assert_same(&second, &workplace.files("out.2"));
    // The moved run can be read.
    workplace.run("score --run out.1").good();
    workplace.run("run --object cube70 --duration 0.2 --resume out.1 --out again --quiet").good();
}
