//! runs.jsonl of `evaluate` began with an empty line.

use std::fs;

use crate::workplace::Workplace;

#[test]
fn every_line_is_a_run_even_after_a_line_that_was_cut_off() {
    let workplace = Workplace::new();
    let evaluate = |object: &str| {
        workplace.run(&format!(
            "evaluate --objects {object} --seeds 1 --modes pose --modalities vitac --duration 0.2 --out e"
        ))
    };
    evaluate("cube70").good();
    let path = workplace.path("e/runs.jsonl");
    let text = fs::read_to_string(&path).unwrap();
    assert!(text.starts_with('{') && text.ends_with("}\n"), "{text:?}");
    fs::write(&path, &text[..text.len() / 2]).unwrap();
    evaluate("ball").good();
    evaluate("cube70").good();
    let text = fs::read_to_string(&path).unwrap();
    let whole = text.lines().filter(|line| serde_json::from_str::<serde_json::Value>(line).is_ok()).count();
    assert_eq!((whole, text.lines().count()), (2, 3), "{text}");
}
