//! Films and shapes of chosen runs, within the size of the page.

use std::collections::BTreeMap;

use mvt_mesh::Mesh;
use mvt_recording::Recording;
use rayon::prelude::*;
use serde_json::{Value, json};

use crate::film::PageFilm;
use crate::row::ReportRow;
use crate::shape::{PageShapes, page_shape};

/// Most bytes of films and of shapes on a page.
const MOST_FILM_BYTES: usize = 7 << 20;
const MOST_SHAPE_BYTES: usize = 5 << 20;

/// Films and shapes by the number of their run on the page.
#[derive(Debug, Default)]
pub struct PageMedia {
    films: BTreeMap<usize, PageFilm>,
    shapes: BTreeMap<usize, (Value, Option<usize>)>,
    truths: Vec<(Mesh, Value)>,
}

/// The part of the page about one run.
#[derive(Default)]
struct Shown {
    film: Option<PageFilm>,
    shapes: Option<PageShapes>,
    warnings: Vec<String>,
}

impl PageMedia {
    /// Reads the films and shapes of runs: `films` and `shapes` name them by their numbers in `rows`, the most important
    /// first. Pictures that do not fit on the page are left out. Also returns the files that cannot be read, a line each.
    pub fn read(rows: &[&ReportRow], films: &[usize], shapes: &[usize]) -> (Self, Vec<String>) {
        // In the order of `shapes`, then of `films`.
        let mut numbers: Vec<usize> = shapes.iter().chain(films).copied().collect();
        let mut known = std::collections::HashSet::new();
        numbers.retain(|number| known.insert(*number));
        let shown: Vec<(usize, Shown)> = numbers
            .into_par_iter()
            .filter_map(|number| {
                let row = rows.get(number)?;
                Some((number, shown(row, films.contains(&number), shapes.contains(&number))))
            })
            .collect();
        let mut media = Self::default();
        let mut warnings = Vec::new();
        let mut bytes = [0, 0];
        for (number, Shown { film, shapes, warnings: complaints }) in shown {
            warnings.extend(complaints);
            if let Some(film) = film {
                bytes[0] += film.pictures.to_string().len();
                if bytes[0] <= MOST_FILM_BYTES {
                    media.films.insert(number, film);
                }
            }
            if let Some(PageShapes { estimate, truth }) = shapes {
                bytes[1] += estimate.to_string().len();
                let truth = truth.and_then(|truth| {
                    let known = media.truths.iter().position(|(known, _)| *known == truth);
                    known.or_else(|| {
                        // A true shape that cannot be shown is missing beside the estimate.
                        let shape = page_shape(&truth, None).ok()?;
                        bytes[1] += shape.to_string().len();
                        media.truths.push((truth, shape));
                        Some(media.truths.len() - 1)
                    })
                });
                if bytes[1] <= MOST_SHAPE_BYTES {
                    media.shapes.insert(number, (estimate, truth));
                }
            }
        }
        (media, warnings)
    }

    /// Returns the film of a run.
    pub fn film(&self, number: usize) -> Option<&PageFilm> {
        self.films.get(&number)
    }

    /// Returns all of it as the page reads it.
    pub fn data(&self) -> Value {
        let films: BTreeMap<String, &Value> =
            self.films.iter().map(|(k, film)| (k.to_string(), &film.pictures)).collect();
        let shapes: BTreeMap<String, Value> = self
            .shapes
            .iter()
            .map(|(k, (estimate, truth))| (k.to_string(), json!({"estimate": estimate, "truth": truth})))
            .collect();
        let truths: Vec<&Value> = self.truths.iter().map(|(_, shape)| shape).collect();
        json!({"films": films, "shapes": shapes, "truths": truths})
    }
}

fn shown(row: &ReportRow, has_film: bool, has_shapes: bool) -> Shown {
    let Some(folder) = &row.folder else { return Shown::default() };
    let mut shown = Shown::default();
    let mut complain = |problem: String| shown.warnings.push(format!("{}: {problem}", folder.display()));
    // Runs of other programs have no recording.
    let recording = match Recording::open(folder) {
        Ok(recording) => Some(recording),
        Err(mvt_recording::RecordingError::NoRecording(_)) => None,
        Err(error) => {
            complain(format!("its recording is left out: {error}"));
            None
        }
    };
    let film = recording.as_ref().filter(|_| has_film).map_or(Ok(None), PageFilm::new);
    let film = film.unwrap_or_else(|problem| {
        complain(format!("its film is left out: {problem}"));
        None
    });
    let shapes = if has_shapes { PageShapes::read(folder, recording.as_ref()) } else { Ok(None) };
    let shapes = shapes.unwrap_or_else(|problem| {
        complain(format!("its shape is left out: {problem}"));
        None
    });
    Shown { film, shapes, ..shown }
}
