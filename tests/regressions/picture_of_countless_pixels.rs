//! A picture of some bytes that promised 12,000 x 12,000 pixels took memory for all of them.

use crate::workplace::Workplace;

/// Returns the header of a PNG picture, and an empty chunk of pixels.
fn png(side: u32) -> Vec<u8> {
    let mut bytes = b"\x89PNG\r\n\x1a\n".to_vec();
    let header = [&side.to_be_bytes()[..], &side.to_be_bytes(), &[8, 2, 0, 0, 0]].concat();
    for (name, data) in [(b"IHDR", header.as_slice()), (b"IDAT", &[])] {
        let chunk = [name, data].concat();
        bytes.extend((data.len() as u32).to_be_bytes());
        bytes.extend(&chunk);
        bytes.extend(crc32fast::hash(&chunk).to_be_bytes());
    }
    bytes
}

#[test]
fn a_picture_is_refused_before_memory_is_taken() {
    let workplace = Workplace::new();
    workplace.write("background.png", png(12_000));
    let said =
        workplace.run("generate --object cube70 --logs 1 --duration 0.1 --background background.png --out set").error();
    assert!(said.contains("background.png is not a readable image: Memory limit exceeded"), "{said}");
}
