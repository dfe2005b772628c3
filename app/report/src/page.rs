//! The page: sections in HTML and the data that its script reads.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;

use serde_json::{Value, json};

use crate::collect::RunCollection;
use crate::compare::Comparison;
use crate::encode::{escaped, json_in_script};
use crate::media::PageMedia;
use crate::metric::{ADD_S, COLUMNS, F5, HEADLINES, Metric};
use crate::plot::{self, PlotRow, run_name};
use crate::row::{ReportRow, RunKind};
use crate::statistics::{Estimate, RESAMPLES, mean};

const STYLE: &str = include_str!("../assets/style.css");
// Why: notes/decisions/viewing.md, "The shapes of a report are painted with WebGL, or by a rasteriser of ours on a plain canvas".
const SCRIPT: [&str; 2] = [include_str!("../assets/view3d.js"), include_str!("../assets/page.js")];
/// Most kinds of runs in the plots that compare them.
const MOST_KINDS: usize = 24;

/// Contents of a page.
#[derive(Debug)]
pub struct Page<'a> {
    /// The runs.
    pub runs: &'a RunCollection,
    /// Runs that they are compared with.
    pub against: Option<&'a RunCollection>,
    /// The worst runs, by their numbers in `runs`, worst first.
    pub worst: &'a [usize],
    /// Films and shapes.
    pub media: &'a PageMedia,
}

/// Names of folders in the title; a shell expands a pattern to many.
const MOST_NAMES: usize = 3;

impl Page<'_> {
    /// Writes the page as HTML.
    pub fn html(&self) -> String {
        // Why: notes/decisions/viewing.md, "A report is one file without requests".
        let title = escaped(&self.title());
        let kinds = self.runs.kinds();
        let comparison = self.against.map(|old| Comparison::new(self.runs, old).html()).unwrap_or_default();
        let worst = self.worst_section();
        // A single kind needs no table of kinds, and its figures come first.
        let sections = if kinds.len() > 1 {
            [kind_table(&kinds), comparison, worst, SHAPES.to_owned(), side_by_side(&kinds), kind_sections(&kinds)]
        } else {
            [kind_sections(&kinds), comparison, worst, SHAPES.to_owned(), events(&self.runs.rows), String::new()]
        };
        let script = SCRIPT.join("\n");
        // The policy forbids every request, whatever a name in a file contains.
        format!(
            "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>{title} - MambaViTact</title>\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"><meta name=\"color-scheme\" content=\"light dark\">\
             <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'\">\
             <style>{STYLE}</style></head><body>\n<header><h1>{title}</h1>{}</header>\n<main>\n{}{}{}</main>\n\
             <dialog id=\"film\"><p id=\"film-title\"></p><img alt=\"a moment of the run\"><div class=\"controls\"><button id=\"play\">play</button>\
             <input type=\"range\" min=\"0\" value=\"0\" aria-label=\"time\"><output></output><button id=\"close\">close</button></div></dialog>\n\
             <script type=\"application/json\" id=\"data\">{}</script>\n<script type=\"application/json\" id=\"media\">{}</script>\n<script>{script}</script>\n\
             </body></html>\n",
            self.subtitle(),
            self.warnings(),
            sections.concat(),
            self.all_runs(),
            json_in_script(&self.data()),
            json_in_script(&self.media.data()),
        )
    }

    fn title(&self) -> String {
        let names = |runs: &RunCollection| {
            let name = |path: &std::path::PathBuf| {
                let name = path.file_name().unwrap_or(path.as_os_str());
                name.to_string_lossy().into_owned()
            };
            let shown: Vec<String> = runs.folders.iter().take(MOST_NAMES).map(name).collect();
            match runs.folders.len() - shown.len() {
                0 => shown.join(", "),
                further => format!("{} and {further} more", shown.join(", ")),
            }
        };
        match self.against {
            Some(old) => format!("{} against {}", names(self.runs), names(old)),
            None => names(self.runs),
        }
    }

    fn subtitle(&self) -> String {
        let rows = &self.runs.rows;
        let objects: BTreeSet<&str> = rows.iter().map(|row| row.id.object.as_str()).collect();
        let frames: usize = rows.iter().map(|row| row.frames).sum();
        let against = self.against.map_or_else(String::new, |old| {
            format!(" A is {} runs of the first folders, B {} runs of the others.", rows.len(), old.rows.len())
        });
        format!(
            "<p class=\"faint\">{} of {} with {} frames. Report of MambaViTact {}.{against}</p>",
            counted(rows.len(), "run"),
            counted(objects.len(), "object"),
            frames,
            env!("CARGO_PKG_VERSION"),
        )
    }

    fn warnings(&self) -> String {
        let warnings = || self.runs.warnings.iter().chain(self.against.into_iter().flat_map(|old| &old.warnings));
        let count = warnings().count();
        if count == 0 {
            return String::new();
        }
        let items: String = warnings().map(|warning| format!("<li>{}</li>", escaped(warning))).collect();
        format!(
            "<details class=\"warnings\"><summary>{}</summary><ul>{items}</ul></details>\n",
            counted(count, "warning")
        )
    }

    /// The worst runs with their pictures.
    fn worst_section(&self) -> String {
        let title = if self.runs.rows.len() == 1 { "The run" } else { "Worst runs" };
        let mut html = format!("<section id=\"worst\"><h2>{title}</h2><div class=\"runs\">");
        for &number in self.worst {
            let Some(row) = self.runs.rows.get(number) else { continue };
            let _ = write!(
                html,
                "<article><h3>{}</h3><p class=\"faint\">{}</p>",
                escaped(&run_name(row)),
                escaped(&row.id.kind.name())
            );
            if let Some(film) = self.media.film(number) {
                let _ = write!(
                    html,
                    "<button class=\"picture\" data-film=\"{number}\"><img src=\"data:image/jpeg;base64,{}\" alt=\"the run at {:.1} s\"></button>",
                    film.poster, film.poster_s
                );
            } else {
                html += &plot::sparkline(row);
            }
            let figures = [&ADD_S, &HEADLINES[3], &F5, &HEADLINES[4]];
            let figures: String = figures.into_iter().map(|metric| figure(metric, row)).collect();
            let _ = write!(html, "<dl>{figures}</dl><p>{}</p>", ending(row));
            let _ = write!(
                html,
                "<p class=\"buttons\"><button data-film=\"{number}\" hidden>film</button><button data-shapes=\"{number}\" hidden>3-D</button></p></article>"
            );
        }
        html + "</div></section>\n"
    }

    fn all_runs(&self) -> String {
        let count = self.runs.rows.len() + self.against.map_or(0, |old| old.rows.len());
        format!(
            "<section id=\"all\"><h2>All runs</h2><div class=\"filters\"><input type=\"search\" placeholder=\"filter: words of object, seed, kind\" \
             aria-label=\"filter\"><output></output></div><div class=\"scroll\"><table id=\"runs\"><thead></thead><tbody></tbody></table></div>\
             <p><button id=\"more\" hidden>show all</button></p><noscript>The table of the {count} runs, the films and the shapes need JavaScript.</noscript>\
             </section>\n<section class=\"faint\"><h2>How to read this</h2><p>Intervals hold 95 %: percentiles of a bootstrap of the mean with {RESAMPLES} \
             resamples over episodes, an object with a seed. Below 5 episodes there is none. ADD-S is the mean distance of the object's points at the \
             estimated pose to the nearest at the true pose. F@5 mm is the F-score at 5 mm from 10,000 points; fine ones are from 100,000. A pose error above 10 mm at the end \
             that the tracker did not declare is an undeclared failure. p-values are two-sided and not corrected for the number of rows.</p></section>\n"
        )
    }

    /// The rows for the table that the script makes.
    fn data(&self) -> Value {
        let columns: Vec<Value> = COLUMNS.iter().map(|m| json!([m.title(), m.digits])).collect();
        let others = self.against.map(|old| old.rows.as_slice()).unwrap_or_default();
        let sweeps = [("A", self.runs.rows.as_slice()), ("B", others)];
        let rows: Vec<Value> = sweeps
            .into_iter()
            .flat_map(|(sweep, rows)| rows.iter().map(move |row| (sweep, row)))
            .map(|(sweep, row)| {
                let values: Vec<Value> = COLUMNS
                    .iter()
                    .map(|metric| (metric.of)(row).map_or(Value::Null, |v| rounded(v, metric.digits + 1)))
                    .collect();
                let RunKind { cameras, mode, modality, variant } = &row.id.kind;
                let folder = row.folder.as_ref().map(|folder| folder.display().to_string());
                let names =
                    json!([sweep, row.id.object, row.id.seed, row.id.estimator_seed, mode, modality, cameras, variant]);
                json!([names, values, row.end, u8::from(row.is_undeclared), folder, row.command])
            })
            .collect();
        json!({"columns": columns, "rows": rows, "two": self.against.is_some()})
    }
}

/// Returns a number with so many digits behind the point, which is shorter as text.
fn rounded(value: f64, digits: usize) -> Value {
    let factor = 10f64.powi(digits as i32);
    json!((value * factor).round() / factor)
}

fn counted(count: usize, noun: &str) -> String {
    format!("{count} {noun}{}", if count == 1 { "" } else { "s" })
}

fn figure(metric: &Metric, row: &ReportRow) -> String {
    let value =
        (metric.of)(row).map_or_else(|| "-".to_owned(), |value| format!("{} {}", metric.shown(value), metric.unit));
    format!("<div><dt>{}</dt><dd>{value}</dd></div>", metric.name)
}

/// What else is to say of a run.
fn ending(row: &ReportRow) -> String {
    let mut words = Vec::new();
    if row.is_undeclared {
        words.push("<strong>undeclared failure</strong>".to_owned());
    }
    if !row.end.is_empty() {
        words.push(format!("<span class=\"faint\">{}</span>", escaped(&row.end)));
    }
    if row.recovered > 0 {
        words.push(format!("found again {}", counted(row.recovered, "time")));
    }
    words.join("; ")
}

type Kinds<'a> = BTreeMap<&'a RunKind, Vec<&'a ReportRow>>;

/// Headline figures by kind of run; a click on a row shows its plots.
fn kind_table(kinds: &Kinds<'_>) -> String {
    let mut html = String::from(
        "<section id=\"kinds\"><h2>Headline figures</h2><div class=\"scroll\"><table class=\"sortable\"><thead><tr><th>kind of run</th>\
         <th class=\"n\">runs</th><th class=\"n\">hidden, %</th>",
    );
    for metric in &HEADLINES {
        let _ = write!(html, "<th class=\"n\">{}</th>", metric.title());
    }
    html += "<th class=\"n\">undeclared failures</th></tr></thead><tbody>";
    for (k, (kind, rows)) in kinds.iter().enumerate() {
        let hidden: Vec<f64> = rows.iter().filter_map(|row| row.hidden).collect();
        let hidden = if hidden.is_empty() { "-".to_owned() } else { format!("{:.0}", 100.0 * mean(&hidden)) };
        let _ = write!(
            html,
            "<tr><td><button class=\"link\" data-kind=\"{k}\">{}</button></td><td class=\"n\">{}</td><td class=\"n\">{hidden}</td>",
            escaped(&kind.name()),
            rows.len(),
        );
        for metric in &HEADLINES {
            let _ = match Estimate::new(&metric.by_episode(rows)) {
                Some(estimate) => write!(
                    html,
                    "<td class=\"n\" data-value=\"{}\">{}{}{}</td>",
                    estimate.mean,
                    metric.shown(estimate.mean),
                    interval(metric, &estimate),
                    missing(metric, rows),
                ),
                None => write!(html, "<td class=\"n\">-</td>"),
            };
        }
        let _ = write!(html, "<td class=\"n\">{}</td></tr>", rows.iter().filter(|row| row.is_undeclared).count());
    }
    html + "</tbody></table></div></section>\n"
}

fn interval(metric: &Metric, estimate: &Estimate) -> String {
    estimate.interval.map_or_else(String::new, |[low, high]| {
        format!("<small>{} to {}</small>", metric.shown(low), metric.shown(high))
    })
}

/// States how many runs lack a figure, so that no mean hides them.
fn missing(metric: &Metric, rows: &[&ReportRow]) -> String {
    let missing = rows.iter().filter(|row| (metric.of)(row).is_none()).count();
    if missing == 0 {
        String::new()
    } else {
        format!("<small class=\"worse\">without {}</small>", counted(missing, "run"))
    }
}

/// The viewer of shapes.
const SHAPES: &str = "<section id=\"shapes\" hidden><h2>Shapes</h2><div class=\"controls\"><select aria-label=\"run\"></select>\
     <button id=\"turn\">turn</button><button id=\"colours\">plain</button></div><div id=\"stage\"><canvas tabindex=\"0\" \
     aria-label=\"shapes in three dimensions; drag or use the arrow keys to turn them\"></canvas><div id=\"names\"></div></div>\
     <p class=\"scale\"><span>error</span><span>0</span><i></i><span>5 mm and more</span><span class=\"bar\"><b></b>20 mm</span></p></section>\n";

/// Plots of all kinds side by side.
fn side_by_side(kinds: &Kinds<'_>) -> String {
    let mut html = String::from("<section id=\"by-kind\"><h2>Cameras, sensors and modes</h2><div class=\"plots\">");
    for metric in [&F5, &ADD_S] {
        let shown = kinds.iter().take(MOST_KINDS).map(|(kind, rows)| plot_row(kind.name(), metric, rows));
        let rows: Vec<PlotRow> = shown.filter(|row| row.estimate.is_some()).collect();
        html += &plot::rows(&metric.title(), metric, &rows);
    }
    html += "</div>";
    if kinds.len() > MOST_KINDS {
        let _ = write!(html, "<p class=\"faint\">The plots show the first {MOST_KINDS} of {} kinds.</p>", kinds.len());
    }
    html + "</section>\n"
}

/// Figures and plots of each kind.
fn kind_sections(kinds: &Kinds<'_>) -> String {
    let title = match kinds.len() {
        1 => kinds.keys().map(|kind| escaped(&kind.name())).collect(),
        _ => "One kind of run".to_owned(),
    };
    let mut html = format!(
        "<section id=\"detail\"><h2>{title}</h2><div class=\"controls\"><select id=\"kind\" aria-label=\"kind of run\">"
    );
    // The kind with the most runs, of several that with the most to estimate from the most sensors.
    let rank =
        |(kind, rows): (&&RunKind, &Vec<&ReportRow>)| (rows.len(), kind.mode == "slam", kind.modality == "vitac");
    let most = kinds.iter().map(rank).max();
    let shown = kinds.iter().position(|kind| Some(rank(kind)) == most).unwrap_or(0);
    for (k, kind) in kinds.keys().enumerate() {
        let selected = if k == shown { " selected" } else { "" };
        let _ = write!(html, "<option value=\"{k}\"{selected}>{}</option>", escaped(&kind.name()));
    }
    html += "</select></div>";
    for (k, rows) in kinds.values().enumerate() {
        let _ = write!(html, "<div class=\"kind\" data-kind=\"{k}\"><div class=\"cards\">");
        for metric in &HEADLINES {
            html += &card(metric, rows);
        }
        let undeclared = rows.iter().filter(|row| row.is_undeclared).count();
        let _ = write!(
            html,
            "<div class=\"card\"><p>undeclared failures</p><p class=\"big\">{undeclared}</p><p class=\"faint\">of {}</p></div>",
            counted(rows.len(), "run")
        );
        html += "</div><div class=\"plots\">";
        html += &plot::over_time(rows).unwrap_or_default();
        html += &plot::against_hidden(&ADD_S, rows).unwrap_or_default();
        html += &plot::against_hidden(&F5, rows).unwrap_or_default();
        for metric in [&F5, &ADD_S] {
            html += &by_object(metric, rows);
        }
        html += "</div></div>";
    }
    html + "</section>\n"
}

fn plot_row(label: String, metric: &Metric, rows: &[&ReportRow]) -> PlotRow {
    let values = rows.iter().filter_map(|row| Some(((metric.of)(row)?, run_name(row)))).collect();
    PlotRow { label, values, estimate: Estimate::new(&metric.by_episode(rows)) }
}

fn by_object(metric: &Metric, rows: &[&ReportRow]) -> String {
    let mut objects = BTreeMap::<&str, Vec<&ReportRow>>::new();
    for row in rows {
        objects.entry(&row.id.object).or_default().push(row);
    }
    let rows: Vec<PlotRow> = objects
        .into_iter()
        .map(|(object, rows)| plot_row(object.to_owned(), metric, &rows))
        .filter(|row| row.estimate.is_some())
        .collect();
    if rows.len() < 2 { String::new() } else { plot::rows(&format!("{} by object", metric.title()), metric, &rows) }
}

fn card(metric: &Metric, rows: &[&ReportRow]) -> String {
    let Some(estimate) = Estimate::new(&metric.by_episode(rows)) else { return String::new() };
    let range = match estimate.interval {
        Some([low, high]) => format!("95 %: {} to {}", metric.shown(low), metric.shown(high)),
        None if rows.len() > 1 => counted(estimate.count, "episode"),
        None => String::new(),
    };
    format!(
        "<div class=\"card\"><p>{}</p><p class=\"big\">{}<small>{}</small></p><p class=\"faint\">{range}</p>{}</div>",
        metric.name,
        metric.shown(estimate.mean),
        metric.unit,
        missing(metric, rows),
    )
}

/// The events of a single run.
fn events(rows: &[ReportRow]) -> String {
    let [row] = rows else { return String::new() };
    if row.events.is_empty() {
        return String::new();
    }
    let items: String = row
        .events
        .iter()
        .map(|(time_s, text)| format!("<tr><td class=\"n\">{time_s:.2} s</td><td>{}</td></tr>", escaped(text)))
        .collect();
    format!("<section><h2>Events</h2><div class=\"scroll\"><table>{items}</table></div></section>\n")
}
