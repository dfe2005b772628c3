//! Cells of lines of tables, which may be quoted.

use std::borrow::Cow;

/// Returns the cells of a line, without the spaces around them. A cell in quotation marks may contain the separator, and a quotation mark
/// that is doubled.
pub fn split(line: &str, separator: char) -> Vec<String> {
    let (mut cells, mut cell, mut is_quoted) = (Vec::new(), String::new(), false);
    let mut signs = line.chars().peekable();
    while let Some(sign) = signs.next() {
        match sign {
            '"' if is_quoted && signs.next_if_eq(&'"').is_some() => cell.push('"'),
            '"' if is_quoted || cell.trim().is_empty() => is_quoted = !is_quoted,
            _ if sign == separator && !is_quoted => cells.push(std::mem::take(&mut cell).trim().to_owned()),
            _ => cell.push(sign),
        }
    }
    cells.push(cell.trim().to_owned());
    cells
}

/// Returns a cell as it stands in a table with commas: in quotation marks where it must.
pub fn quoted(cell: &str) -> Cow<'_, str> {
    if cell.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", cell.replace('"', "\"\"")).into()
    } else {
        cell.into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quoted_cells_are_read_as_they_were_written() {
        let cells = ["a,b", "", "say \"x\"", "1.5", "\""];
        let line = cells.map(quoted).join(",");
        assert_eq!(line, "\"a,b\",,\"say \"\"x\"\"\",1.5,\"\"\"\"");
        assert_eq!(split(&line, ','), cells);
        assert_eq!(split(" 1 ; \"2;3\" ;5\" pipe", ';'), ["1", "2;3", "5\" pipe"]);
        assert_eq!(split("", ','), [""]);
    }
}
