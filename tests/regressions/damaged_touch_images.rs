//! `touch predict` read a cut JPEG as a press of 3.6 mm, stopped at files of macOS, and wrote names with commas as two columns.

use image::ImageFormat;

use crate::workplace::{Workplace, others_data};

#[test]
fn damaged_images_and_files_of_desktops_are_left_out() {
    let Some(data) = others_data("real_digit") else { return };
    let image = |name: &str| image::open(data.join(format!("dd/{name}.png"))).unwrap().into_rgb8();
    let workplace = Workplace::new();
    std::fs::create_dir(workplace.path("in")).unwrap();
    image("untouched").save(workplace.path("untouched.png")).unwrap();
    let mut jpeg = std::io::Cursor::new(Vec::new());
    image("000_img").write_to(&mut jpeg, ImageFormat::Jpeg).unwrap();
    let jpeg = jpeg.into_inner();
    workplace.write("in/a,b \"c\"_img.jpg", &jpeg);
    workplace.write("in/cut_img.jpg", &jpeg[..jpeg.len() / 2]);
    workplace.write("in/pointer_img.jpg", "version https://git-lfs.github.com/spec/v1\noid sha256:4d\nsize 12\n");
    for name in ["in/._cut_img.jpg", "in/.DS_Store", "in/Thumbs.db"] {
        workplace.write(name, "\0\x05\x16\x07");
    }
    let said = workplace.run("touch predict --images in --untouched untouched.png --out out").warned();
    assert!(said.contains("cut_img.jpg") && said.contains("cut or damaged") && said.contains("is skipped"), "{said}");
    assert!(said.contains("pointer_img.jpg") && said.contains("git lfs pull") && !said.contains("._cut"), "{said}");
    let table = std::fs::read_to_string(workplace.path("out/predictions.csv")).unwrap();
    let lines: Vec<&str> = table.lines().collect();
    assert_eq!(lines.len(), 2, "{table}");
    assert!(lines[1].starts_with("\"a,b \"\"c\"\"\","), "{table}");
    assert_eq!(lines[1].rsplit(',').count(), 8, "{table}");

    // Nothing is left to predict from.
    let said = workplace.run("touch predict --images in/cut_img.jpg --untouched untouched.png --out none").error();
    assert!(said.contains("in/cut_img.jpg") && said.contains("cut or damaged"), "{said}");
}
