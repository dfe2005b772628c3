//! `report`: pages of runs and of tables, and input that is neither. `.ci/report` opens such pages in a browser.

use std::fs;

use crate::workplace::Workplace;

/// A run and a table of `evaluate`, short.
fn workplace() -> Workplace {
    let workplace = Workplace::new();
    workplace.run("run --object cube70 --duration 0.5 --quiet --out sweep/run").good();
    workplace
        .run("evaluate --objects ball --seeds 2 --modes slam --modalities vitac,vi --duration 0.3 --out sweep/table")
        .good();
    workplace
}

fn page(workplace: &Workplace, name: &str) -> String {
    String::from_utf8(fs::read(workplace.path(name)).unwrap()).unwrap()
}

#[test]
fn runs_and_tables_are_one_page() {
    let workplace = workplace();
    let said = workplace.run("report sweep --out a.html").good();
    assert!(said.starts_with("5 runs, ") && said.contains("next: open a.html"), "{said}");
    let html = page(&workplace, "a.html");
    for expected in [
        "slam · vitac · side",
        "slam · vi · side",
        "cube70, seed 0",
        "<svg",
        "data:image/jpeg;base64,",
        "\"estimate\":",
    ] {
        assert!(html.contains(expected), "{expected}");
    }
    // Nothing is requested from elsewhere.
    for address in ["http:", "https:", "src=\"/", "href=", "url("] {
        assert!(!html.contains(address), "{address}");
    }
    // The same runs give the same bytes, with any number of threads.
    let mut command = workplace.command("report sweep --out b.html");
    assert!(command.env("RAYON_NUM_THREADS", "1").status().unwrap().success());
    assert!(page(&workplace, "b.html") == html, "the page depends on the number of threads");
    assert!(workplace.run("report sweep --out a.html").error().contains("--overwrite"));
    workplace.run("report sweep --out a.html --overwrite --films 0 --shapes 0").good();
    assert!(page(&workplace, "a.html").len() < html.len() / 3);

    let said = workplace.run("report sweep/table --against sweep --out c.html").good();
    assert!(said.starts_with("9 runs, "), "{said}");
    let html = page(&workplace, "c.html");
    assert!(html.contains("4 pairs of runs") && html.contains("B 1;"), "the pairs are missing");
}

#[test]
fn what_is_no_run_is_named() {
    let workplace = Workplace::new();
    fs::create_dir(workplace.path("empty")).unwrap();
    for (folder, words) in
        [("empty", "empty contains no run"), ("none", "cannot read none"), ("file", "cannot read file")]
    {
        workplace.write("file", "");
        let error = workplace.run(&format!("report {folder}")).error();
        assert!(error.contains(words), "{error}");
    }
    assert!(workplace.run("report").usage().contains("<DIR>"));

    // Runs that were cut off, damaged or never began, beside one that is whole.
    workplace.run("run --object cube70 --duration 0.3 --quiet --out all/whole").good();
    let files = [
        "summary.json",
        "trajectory.csv",
        "mesh.ply",
        "recording/about.json",
        "recording/frames.jsonl",
        "recording/images.bin",
    ];
    for (k, damaged) in files.into_iter().enumerate() {
        let folder = workplace.path(&format!("all/{k}"));
        fs::create_dir_all(folder.join("recording")).unwrap();
        for (path, mut bytes) in workplace.files("all/whole") {
            if path.to_str() == Some("summary.json") {
                // Another run, which is not left out as a copy.
                let text = String::from_utf8(bytes).unwrap();
                bytes = text.replacen("\"seed\": 0", &format!("\"seed\": {}", k + 1), 1).into_bytes();
            }
            if path.to_str() == Some(damaged) {
                bytes.truncate(bytes.len() / 2);
            }
            fs::write(folder.join(path), bytes).unwrap();
        }
    }
    for (name, complete) in [("interrupted", "\"complete\": false"), ("nan", "\"complete\": NaN")] {
        fs::create_dir_all(workplace.path(&format!("all/{name}"))).unwrap();
        let summary = page(&workplace, "all/whole/summary.json").replace("\"complete\": true", complete);
        workplace.write(&format!("all/{name}/summary.json"), summary);
    }
    fs::create_dir_all(workplace.path("all/begun/recording")).unwrap();
    let warned = workplace.run("report all --films 9").warned();
    for expected in [
        "all/0 is skipped: summary.json",
        "all/1/trajectory.csv",
        "its shape is left out",
        "its recording is left out",
        "all/nan is skipped",
        "all/begun is skipped",
        "did not come to their end",
    ] {
        assert!(warned.contains(expected), "{expected}: {warned}");
    }
    assert!(page(&workplace, "report.html").contains("interrupted"));
}
