//! Paints the window's triangles on the CPU, as egui's own painters do on a graphics card: colours are multiplied and blended as sRGB
//! values, and textures are read as their options say.

use std::collections::HashMap;

use eframe::egui::epaint::{ImageData, Mesh, Primitive, Vertex};
use eframe::egui::{
    Color32, ColorImage, Context, FullOutput, Pos2, Rect, TextureFilter, TextureId, TextureOptions, TexturesDelta, pos2,
};
use egui_kittest::TestRenderer;
use image::{Rgba, RgbaImage};

/// Painter with the textures that egui has given it.
#[derive(Default)]
pub struct Painter(HashMap<TextureId, (ColorImage, TextureOptions)>);

impl TestRenderer for Painter {
    fn handle_delta(&mut self, delta: &mut TexturesDelta) {
        for (id, deltas) in delta.set.drain() {
            for delta in deltas {
                let ImageData::Color(image) = delta.image;
                match delta.pos {
                    None => drop(self.0.insert(id, (ColorImage::clone(&image), delta.options))),
                    Some([left, top]) => {
                        let (texture, _) = self.0.get_mut(&id).unwrap();
                        for (y, row) in image.pixels.chunks_exact(image.width()).enumerate() {
                            let start = (top + y) * texture.width() + left;
                            texture.pixels[start..start + row.len()].copy_from_slice(row);
                        }
                    }
                }
            }
        }
        for id in delta.free.drain() {
            self.0.remove(&id);
        }
    }

    fn render(&mut self, ctx: &Context, output: &FullOutput) -> Result<RgbaImage, String> {
        let scale = ctx.pixels_per_point();
        let size = ctx.content_rect().size() * scale;
        let mut picture = RgbaImage::new(size.x.round() as u32, size.y.round() as u32);
        for clipped in ctx.tessellate(output.shapes.clone(), scale) {
            let Primitive::Mesh(mesh) = &clipped.primitive else { return Err("a paint callback".to_owned()) };
            let (texture, options) = self.0.get(&mesh.texture_id).ok_or("an unknown texture")?;
            let clip = clipped.clip_rect * scale;
            paint(&mut picture, mesh, clip, scale, |uv| sample(texture, options.magnification, uv));
        }
        Ok(picture)
    }
}

/// Paints a mesh within a rectangle, both in points times `scale`.
fn paint(picture: &mut RgbaImage, mesh: &Mesh, clip: Rect, scale: f32, texture: impl Fn(Pos2) -> [f32; 4]) {
    let clamp = |bound: f32, most: u32| bound.round().clamp(0.0, most as f32) as u32;
    let (width, height) = picture.dimensions();
    let columns = [clamp(clip.left(), width), clamp(clip.right(), width)];
    let rows = [clamp(clip.top(), height), clamp(clip.bottom(), height)];
    for corners in mesh.indices.chunks_exact(3) {
        let corners = [0, 1, 2].map(|k| mesh.vertices[corners[k] as usize]);
        let places = corners.map(|corner| (corner.pos.to_vec2() * scale).to_pos2());
        let edges = [0, 1, 2].map(|k| Edge::new(places[(k + 1) % 3], places[(k + 2) % 3]));
        let area = edges[0].side(places[0]);
        if area == 0.0 {
            continue;
        }
        let bounds = Rect::from_points(&places);
        let range = |[low, high]: [u32; 2], from: f32, to: f32| {
            (from.floor().max(low as f32) as u32).min(high)..(to.ceil().max(0.0) as u32).clamp(low, high)
        };
        for y in range(rows, bounds.top(), bounds.bottom()) {
            for x in range(columns, bounds.left(), bounds.right()) {
                let centre = pos2(x as f32 + 0.5, y as f32 + 0.5);
                if edges.iter().all(|edge| edge.has_inside(centre, area.signum())) {
                    let weights = edges.map(|edge| edge.side(centre) / area);
                    let colour = colour(&corners, weights, &texture);
                    let pixel = picture.get_pixel_mut(x, y);
                    let kept = 1.0 - colour[3];
                    *pixel = Rgba([0, 1, 2, 3].map(|channel| {
                        (255.0 * colour[channel] + kept * f32::from(pixel[channel])).round().clamp(0.0, 255.0) as u8
                    }));
                }
            }
        }
    }
}

/// Edge of a triangle.
#[derive(Clone, Copy)]
struct Edge {
    from: Pos2,
    to: Pos2,
}

impl Edge {
    fn new(from: Pos2, to: Pos2) -> Self {
        Self { from, to }
    }

    /// Returns twice the signed area of the triangle of this edge and a point.
    fn side(self, point: Pos2) -> f32 {
        let (along, beside) = (self.to - self.from, point - self.from);
        along.x * beside.y - along.y * beside.x
    }

    /// Whether a point is on the triangle's side. A point on the edge of two triangles belongs to the one of which the edge is a top or a
    /// left edge.
    fn has_inside(self, point: Pos2, sign: f32) -> bool {
        let side = self.side(point) * sign;
        let along = (self.to - self.from) * sign;
        side > 0.0 || (side == 0.0 && (along.y < 0.0 || (along.y == 0.0 && along.x > 0.0)))
    }
}

/// Returns the colour of a point of a triangle, 0 to 1, premultiplied.
fn colour(corners: &[Vertex; 3], weights: [f32; 3], texture: impl Fn(Pos2) -> [f32; 4]) -> [f32; 4] {
    let mix = |of: &dyn Fn(&Vertex) -> f32| (0..3).map(|k| weights[k] * of(&corners[k])).sum::<f32>();
    let texel = texture(pos2(mix(&|vertex| vertex.uv.x), mix(&|vertex| vertex.uv.y)));
    [0, 1, 2, 3].map(|channel| mix(&|vertex| f32::from(vertex.color.to_array()[channel])) / 255.0 * texel[channel])
}

/// Returns the colour of a texture at a place, 0 to 1, premultiplied.
fn sample(texture: &ColorImage, filter: TextureFilter, uv: Pos2) -> [f32; 4] {
    let [width, height] = texture.size;
    let at = |x: f32, y: f32| {
        let x = x.clamp(0.0, width as f32 - 1.0) as usize;
        let y = y.clamp(0.0, height as f32 - 1.0) as usize;
        Color32::to_array(&texture.pixels[y * width + x]).map(|value| f32::from(value) / 255.0)
    };
    let (x, y) = (uv.x * width as f32, uv.y * height as f32);
    if filter == TextureFilter::Nearest {
        return at(x.floor(), y.floor());
    }
    let (left, top) = ((x - 0.5).floor(), (y - 0.5).floor());
    let (right, down) = (x - 0.5 - left, y - 0.5 - top);
    let near = [at(left, top), at(left + 1.0, top), at(left, top + 1.0), at(left + 1.0, top + 1.0)];
    let shares = [(1.0 - right) * (1.0 - down), right * (1.0 - down), (1.0 - right) * down, right * down];
    [0, 1, 2, 3].map(|channel| (0..4).map(|k| shares[k] * near[k][channel]).sum())
}
