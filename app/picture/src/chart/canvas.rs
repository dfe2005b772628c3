//! The two surfaces on which charts are drawn: images and SVG.

use std::fmt::Write as _;

use image::{Rgb, RgbImage};

use crate::draw::blend;
use crate::text;

/// Which end of a text stands at its position.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Anchor {
    Start,
    Middle,
    End,
}

/// Shapes of a chart. Positions are in pixels, columns to the right and rows downwards.
pub trait Canvas {
    /// Draws a rectangle of left, upper, right and lower edge.
    fn rectangle(&mut self, edges: [f32; 4], colour: Rgb<u8>, opacity: f32);

    /// Draws a line through points.
    fn polyline(&mut self, points: &[(f32, f32)], colour: Rgb<u8>);

    /// Draws a text; `at` is its anchor and its upper edge.
    fn text(&mut self, at: (f32, f32), anchor: Anchor, size: f32, colour: Rgb<u8>, text: &str);
}

impl Canvas for RgbImage {
    fn rectangle(&mut self, [left, top, right, bottom]: [f32; 4], colour: Rgb<u8>, opacity: f32) {
        // The casts clamp.
        let [left, top, right, bottom] = [left, top, right, bottom].map(|edge| edge.round() as u32);
        for y in top..bottom.min(self.height()) {
            for x in left..right.min(self.width()) {
                blend(self, x, y, colour, opacity);
            }
        }
    }

    /// Two pixels wide, smooth between rows.
    fn polyline(&mut self, points: &[(f32, f32)], colour: Rgb<u8>) {
        for pair in points.windows(2) {
            let [(x0, y0), (x1, y1)] = [pair[0], pair[1]];
            let steps = (x1 - x0).abs().max((y1 - y0).abs()).ceil().max(1.0) as u32;
            for k in 0..=steps.min(4096) {
                let along = k as f32 / steps as f32;
                let (x, y) = (x0 + (x1 - x0) * along, y0 + (y1 - y0) * along);
                let (column, row) = (x as u32, y as u32);
                blend(self, column, row, colour, 1.0 - y.fract());
                blend(self, column, row.saturating_add(1), colour, 1.0);
                blend(self, column, row.saturating_add(2), colour, y.fract());
            }
        }
    }

    fn text(&mut self, (x, y): (f32, f32), anchor: Anchor, size: f32, colour: Rgb<u8>, text: &str) {
        let width = text::width(size, text) as f32;
        let left = match anchor {
            Anchor::Start => x,
            Anchor::Middle => x - 0.5 * width,
            Anchor::End => x - width,
        };
        text::write(self, (left as u32, y as u32), size, colour, text);
    }
}

/// SVG document that is being written.
pub struct SvgCanvas {
    text: String,
}

impl SvgCanvas {
    /// Begins a document of this width and height.
    pub fn new(width: f32, height: f32) -> Self {
        let text = format!(
            "<svg width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} {height}\" \
             xmlns=\"http://www.w3.org/2000/svg\" font-family=\"sans-serif\">\n"
        );
        Self { text }
    }

    /// Returns the document.
    pub fn finish(self) -> String {
        self.text + "</svg>\n"
    }
}

impl Canvas for SvgCanvas {
    fn rectangle(&mut self, [left, top, right, bottom]: [f32; 4], Rgb([r, g, b]): Rgb<u8>, opacity: f32) {
        let (width, height) = ((right - left).max(0.0), (bottom - top).max(0.0));
        let _ = writeln!(
            self.text,
            "<rect x=\"{left:.1}\" y=\"{top:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" \
             fill=\"#{r:02x}{g:02x}{b:02x}\" fill-opacity=\"{opacity}\"/>"
        );
    }

    fn polyline(&mut self, points: &[(f32, f32)], Rgb([r, g, b]): Rgb<u8>) {
        self.text.push_str("<polyline points=\"");
        for (x, y) in points {
            let _ = write!(self.text, "{x:.1},{y:.1} ");
        }
        let _ = writeln!(self.text, "\" fill=\"none\" stroke=\"#{r:02x}{g:02x}{b:02x}\" stroke-width=\"2\"/>");
    }

    fn text(&mut self, (x, y): (f32, f32), anchor: Anchor, size: f32, Rgb([r, g, b]): Rgb<u8>, text: &str) {
        let anchor = match anchor {
            Anchor::Start => "start",
            Anchor::Middle => "middle",
            Anchor::End => "end",
        };
        let text = text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
        let _ = writeln!(
            self.text,
            "<text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"{anchor}\" font-size=\"{size}\" \
             fill=\"#{r:02x}{g:02x}{b:02x}\">{text}</text>",
            y + 0.85 * size
        );
    }
}
