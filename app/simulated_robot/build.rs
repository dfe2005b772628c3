//! Lets programs and tests find libmujoco.

fn main() {
    mvt_mujoco_search_path::set();
}
