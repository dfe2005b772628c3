//! An OBJ file with the number of a normal near 2^64 made the reader overflow.

use std::fmt::Write as _;

use crate::workplace::Workplace;

#[test]
fn a_face_with_countless_normals_is_read_without_them() {
    let workplace = Workplace::new();
    let mut text = "v 0 0 0\nv 0.08 0 0\nv 0 0.08 0\nv 0 0 0.08\nvt 0 0\nvn 0 0 1\n".to_owned();
    for [a, b, c] in [[1, 3, 2], [1, 2, 4], [1, 4, 3], [2, 3, 4]] {
        let index = "6148914691236517206";
        writeln!(text, "f {a}/{index}/{index} {b}/-9/{index} {c}//{index}").unwrap();
    }
    workplace.write("object.obj", text);
    workplace.run("simulate --object object.obj --duration 0.1").warned();
}
