//! Names of the files in a recording's folder.

pub const ABOUT: &str = "about.json";
pub const RUNNING: &str = "running";
pub const FRAMES: &str = "frames.jsonl";
pub const IMAGES: &str = "images.bin";
pub const SHAPES: &str = "shapes.jsonl";
pub const MESHES: &str = "shapes.bin";
pub const EVENTS: &str = "events.jsonl";
pub const END: &str = "end.json";
