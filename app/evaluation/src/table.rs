//! Runs as Markdown tables.

use std::fmt::Write as _;

use super::{Errors, FULL, Line};

/// The runs that a row of a table averages: cameras, mode, modality, variant.
type Group<'a> = (&'a str, &'a str, &'a str, &'a str);

/// The means over objects and seeds with the worst run of each kind, then the means of each object.
pub fn tables(lines: &[Line]) -> String {
    let mut text =
        format!("| cameras | mode | modality | variant | {HEAD} | worst run (ADD-S mean) |\n|---|---|---|---|");
    text += &"---|".repeat(COLUMNS + 1);
    let mut groups: Vec<Group<'_>> = lines.iter().map(group).collect();
    groups.sort_unstable();
    groups.dedup();
    for &of in &groups {
        let kind: Vec<&Line> = lines.iter().filter(|line| group(line) == of).collect();
        let mean_mm = |line: &Line| line.add_s_mm.map_or(f64::INFINITY, |e| e.mean);
        let worst = kind.iter().max_by(|a, b| mean_mm(a).total_cmp(&mean_mm(b)));
        let worst = worst.map_or_else(String::new, |line| {
            format!("{} seed {}: {:.2} mm", line.key.object, line.key.seed, mean_mm(line))
        });
        let (cameras, mode, modality, variant) = of;
        let _ = write!(text, "\n| {cameras} | {mode} | {modality} | {variant} | {} | {worst} |", means(&kind));
    }
    let mut objects: Vec<&str> = lines.iter().map(|line| line.key.object.as_str()).collect();
    objects.sort_unstable();
    objects.dedup();
    let _ = write!(
        text,
        "\n\n| object | cameras | mode | modality | {HEAD} |\n|---|---|---|---|{}",
        "---|".repeat(COLUMNS)
    );
    for object in objects {
        for &of in groups.iter().filter(|(.., variant)| *variant == FULL) {
            let kind: Vec<&Line> = lines.iter().filter(|line| line.key.object == object && group(line) == of).collect();
            if !kind.is_empty() {
                let (cameras, mode, modality, _) = of;
                let _ = write!(text, "\n| {object} | {cameras} | {mode} | {modality} | {} |", means(&kind));
            }
        }
    }
    text.push('\n');
    text
}

/// The means of each kind of run in columns that fit a terminal.
pub fn summary(lines: &[Line]) -> String {
    let mut groups: Vec<Group<'_>> = lines.iter().map(group).collect();
    groups.sort_unstable();
    groups.dedup();
    let name = |(cameras, mode, modality, variant): Group<'_>| match variant {
        FULL => format!("{cameras} {mode} {modality}"),
        variant => format!("{cameras} {mode} {modality}, {variant} = 0"),
    };
    let width = groups.iter().map(|&of| name(of).chars().count()).max().unwrap_or(0).max(4);
    let mut text = format!("{:width$}  runs    F@2    F@5  ADD-S mm  ADD mm  angle °  lost  frames/s", "runs of");
    for &of in &groups {
        let kind: Vec<&Line> = lines.iter().filter(|line| group(line) == of).collect();
        let mean = |value: &dyn Fn(&Line) -> Option<f64>| {
            let values: Option<Vec<f64>> = kind.iter().map(|line| value(line)).collect();
            values.map(|values| values.iter().sum::<f64>() / values.len().max(1) as f64)
        };
        let shown =
            |value: Option<f64>, digits: usize| value.map_or_else(|| "-".to_owned(), |v| format!("{v:.digits$}"));
        let _ = write!(
            text,
            "\n{:width$}  {:4}  {:>5}  {:>5}  {:>8}  {:>6}  {:>7}  {:>4}  {:>8}",
            name(of),
            kind.len(),
            shown(mean(&|line| line.f_score.get(&2).copied()), 3),
            shown(mean(&|line| line.f_score.get(&5).copied()), 3),
            shown(mean(&|line| line.add_s_mm.map(|errors| errors.mean)), 2),
            shown(mean(&|line| line.add_mm.map(|errors| errors.mean)), 2),
            shown(mean(&|line| line.rotation_deg.map(|errors| errors.mean)), 1),
            shown(mean(&|line| Some(line.lost_frames as f64)), 1),
            shown(mean(&|line| line.frames_per_second), 1),
        );
    }
    text
}

fn group(line: &Line) -> Group<'_> {
    (&line.key.cameras, line.key.mode.name(), line.key.modality.name(), &line.key.variant)
}

const COLUMNS: usize = 18;
const HEAD: &str = "runs | hidden | F@1 | F@2 | F@5 | fine F@1 | F@2 | F@5 | ADD-S mean | median | p95 | final | worst final | ADD mean | rotation mean, degrees | lost frames | \
                    undeclared failures | frames/s";

fn means(lines: &[&Line]) -> String {
    let n = lines.len().max(1) as f64;
    let mean = |of: &dyn Fn(&Line) -> Option<f64>| {
        let values: Vec<f64> = lines.iter().filter_map(|line| of(line)).collect();
        // A run without a value is not passed over: where one lacks it, there is no mean.
        if values.len() == lines.len() && !values.is_empty() {
            Some(values.iter().sum::<f64>() / values.len() as f64)
        } else {
            None
        }
    };
    let shown = |value: Option<f64>, digits: usize| value.map_or_else(|| "-".to_owned(), |v| format!("{v:.digits$}"));
    let mut cells = vec![lines.len().to_string()];
    cells.push(mean(&|line| line.hidden).map_or_else(|| "-".to_owned(), |share| format!("{:.0} %", 100.0 * share)));
    for mm in [1, 2, 5] {
        cells.push(shown(mean(&|line| line.f_score.get(&mm).copied()), 3));
    }
    for mm in [1, 2, 5] {
        cells.push(shown(mean(&|line| line.f_score_fine.get(&mm).copied()), 3));
    }
    let errors: [fn(&Errors) -> f64; 4] = [|e| e.mean, |e| e.median, |e| e.p95, |e| e.last];
    for of in errors {
        cells.push(shown(mean(&|line| line.add_s_mm.as_ref().map(of)), 2));
    }
    let last_mm = lines.iter().map(|line| line.add_s_mm.map_or(f64::INFINITY, |e| e.last));
    cells.push(format!("{:.2}", last_mm.fold(0.0, f64::max)));
    cells.push(shown(mean(&|line| line.add_mm.map(|errors| errors.mean)), 2));
    cells.push(shown(mean(&|line| line.rotation_deg.map(|errors| errors.mean)), 1));
    cells.push(format!("{:.1}", lines.iter().map(|line| line.lost_frames as f64).sum::<f64>() / n));
    cells.push(lines.iter().filter(|line| line.undeclared).count().to_string());
    cells.push(shown(mean(&|line| line.frames_per_second), 1));
    cells.join(" | ")
}
