//! Files of poses in the dialects of spreadsheets and of other programs.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a failed assumption in a test is a failed test")]

use mvt_run::report::read_trajectory;

const HEADER: &str = "time_s,x_m,y_m,z_m,qw,qx,qy,qz";
const ROWS: &str = "0.5,0.01,0.02,0.2,0.8,0,0,0.6\n0.6,0.02,0.02,0.2,0.8,0,0.6,0\n0.7,0.03,0.02,0.2,1,0,0,0\n";

/// Asserts that a file holds the poses of [`ROWS`].
fn assert_read(name: &str, text: &str) {
    let expected = read_trajectory(&format!("{HEADER}\n{ROWS}")).unwrap();
    let read = read_trajectory(text).unwrap_or_else(|error| panic!("{name}: {error}"));
    assert_eq!(read.len(), expected.len(), "{name}");
    for (a, b) in read.iter().zip(&expected) {
        assert!((a.time_s - b.time_s).abs() < 1e-9, "{name}: {} s", a.time_s);
        let difference = a.estimate.untyped().to_homogeneous() - b.estimate.untyped().to_homogeneous();
        assert!(difference.abs().max() < 1e-9, "{name}: {:?}", a.estimate);
    }
}

/// The rows with other columns and separators.
fn rewritten(separator: &str, cells: impl Fn(&[&str]) -> Vec<String>) -> String {
    let line = |line: &str| cells(&line.split(',').collect::<Vec<_>>()).join(separator) + "\n";
    ROWS.lines().map(line).collect()
}

#[test]
fn poses_are_read_in_the_dialects_of_other_programs() {
    let plain = format!("{HEADER}\n{ROWS}");
    let same = |cells: &[&str]| cells.iter().map(|cell| (*cell).to_owned()).collect::<Vec<_>>();
    let semicolons = plain.replace(',', ";");
    let tum = rewritten(" ", |cells| [0, 1, 2, 3, 5, 6, 7, 4].map(|k| cells[k].to_owned()).to_vec());
    let with_time = |factor: f64| {
        let row = move |cells: &[&str]| {
            let time = (cells[0].parse::<f64>().unwrap() * factor).round();
            [vec![time.to_string()], cells[1..].iter().map(|cell| (*cell).to_owned()).collect()].concat()
        };
        rewritten(",", row)
    };
    let quoted = rewritten(",", |cells| cells.iter().map(|cell| format!("\"{cell}\"")).collect());
    for (name, text) in [
        ("upper case", plain.replace(HEADER, &HEADER.to_uppercase())),
        ("carriage returns", plain.replace('\n', "\r")),
        ("Windows", plain.replace('\n', "\r\n")),
        ("spaces", plain.replace(',', " , ")),
        ("tabs", plain.replace(',', "\t")),
        ("semicolons", semicolons.clone()),
        ("decimal commas", semicolons.replace('.', ",")),
        ("quoted names", plain.replace(HEADER, &format!("\"{}\"", HEADER.replace(',', "\",\"")))),
        ("quoted", format!("\"{}\"\n{quoted}", HEADER.replace(',', "\",\""))),
        ("a comment first", format!("# made by a program\n\n{plain}")),
        ("comments between", plain.replace("\n0.6", "\n# half\n0.6")),
        ("an empty line of a spreadsheet", plain.replace("\n0.6", "\n,,,,,,,\n0.6")),
        ("an index", format!(",{HEADER}\n{}", rewritten(",", |cells| [vec!["7".into()], same(cells)].concat()))),
        ("a separator at the end", plain.replace('\n', ",\n")),
        ("a separator at the rows' end", format!("{HEADER}\n{}", ROWS.replace('\n', ",\n"))),
        ("exponents of Fortran", plain.replace("0.02,0.2,", "2.0D-02,2.0D-01,")),
        ("TUM with its header", format!("# timestamp tx ty tz qx qy qz qw\n{tum}")),
        ("TUM without a header", tum.replace(' ', "   ")),
        (
            "EuRoC",
            "#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []\n"
                .to_owned()
                + &with_time(1e9),
        ),
        ("EuRoC without units", format!("#timestamp,p_x,p_y,p_z,q_w,q_x,q_y,q_z\n{}", with_time(1e9))),
        (
            "milliseconds in the name",
            plain.replace(HEADER, &HEADER.replace("time_s", "time_ms")).replace(ROWS, &with_time(1e3)),
        ),
        ("a message of ROS", {
            let names = "t,pose.position.x,pose.position.y,pose.position.z,pose.orientation.w,pose.orientation.x";
            format!("{names},pose.orientation.y,pose.orientation.z\n{ROWS}")
        }),
    ] {
        assert_read(name, &text);
    }
}

#[test]
fn poses_that_cannot_be_right_are_refused() {
    let millimetres = rewritten(",", |cells| {
        let millimetre = |(k, cell): (usize, &&str)| match k {
            1..=3 => (1e3 * cell.parse::<f64>().unwrap()).to_string(),
            _ => (*cell).to_owned(),
        };
        cells.iter().enumerate().map(millimetre).collect()
    });
    let numbers = rewritten(",", |cells| cells.iter().map(|cell| (*cell).to_owned()).collect());
    for (text, expected) in [
        (
            format!("{HEADER}\n{millimetres}"),
            "line 1: the object is 202 m from the origin; give x_m, y_m and z_m in metres",
        ),
        (numbers, "line 1: the file has no header; give one with at least time_s"),
        (format!("{HEADER}\n{}", &ROWS[..ROWS.len() - 6]), "line 4: 6 values, but the header has 8 columns"),
        (format!("{HEADER}\n{ROWS}{ROWS}"), "line 5: time_s is not greater than on the line before"),
    ] {
        let said = read_trajectory(&text).unwrap_err().to_string();
        assert!(said.starts_with(expected), "{said}");
    }
    let named = format!("{}\n{millimetres}", HEADER.replace("_m", "_mm"));
    assert_read("millimetres in the names", &named);
}
