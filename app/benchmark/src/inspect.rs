//! `inspect` of RGB-D sequences.

use std::path::Path;

use anyhow::Result;
use mvt_run::io::{check_named, png, print_line, write_named};
use mvt_run::progress;
use mvt_run::source::RgbdSequence;

use crate::facts::{Glance, SequenceFacts};
use crate::sheet::{SHOWN, SheetFrame, sheet};

/// Reads all frames of a sequence, prints facts about it, as JSON or in words, and writes a picture of it.
///
/// # Errors
/// If the sequence is damaged, or the picture cannot be written.
pub fn inspect(path: &Path, json: bool, picture: Option<&Path>, overwrite: bool) -> Result<()> {
    if let Some(picture) = picture {
        check_named(picture, overwrite)?;
    }
    let mut sequence = RgbdSequence::open(path)?;
    let count = sequence.len();
    let is_shown = |k: usize| (0..SHOWN).any(|place| place * count.saturating_sub(1) / (SHOWN - 1) == k);
    let bar = progress::bar(count as u64, "frames");
    let (mut glances, mut frames) = (Vec::new(), Vec::new());
    for k in 0..count {
        let frame = sequence.frame(k)?;
        let glance = Glance::of(&frame);
        if picture.is_some() && is_shown(k) {
            frames.push(SheetFrame::new(&frame, &glance));
        }
        glances.push(glance);
        bar.inc(1);
    }
    bar.finish_and_clear();
    let facts = SequenceFacts::new(&sequence, &glances);
    if let Some(picture) = picture {
        write_named(picture, &png(&sheet(&facts, &frames, &glances))?, overwrite)?;
    }
    if json { print_line(&serde_json::to_string(&facts)?) } else { print_line(&facts.to_string()) }
}
