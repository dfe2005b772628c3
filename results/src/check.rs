//! `cargo results check`: claims, values and page must agree.

use std::fs;
use std::path::PathBuf;

use anyhow::{Context as _, Result, ensure};

use crate::claims::{Claims, Verdict};
use crate::place::{CHANGES, FOLDER, MORE, PAGE, Repository};
use crate::render::{self, MOST_BYTES};
use crate::values::Values;

/// Fails with everything that is wrong.
pub fn check(repository: &Repository, claims: &Claims, values: &Values) -> Result<()> {
    let mut wrong = Vec::new();
    for measured in values.iter() {
        let id = &measured.id;
        if !claims.rows().any(|(_, row)| row.id == *id) {
            wrong.push(format!("the value {id:?} has no claim; remove it from results/values.jsonl or write a claim"));
        }
        if measured.commit.is_empty() || measured.machine.is_empty() || measured.date.is_empty() {
            wrong.push(format!("the value {id:?} lacks its commit, machine or date; measure it again"));
        }
        if measured.commit.ends_with(CHANGES) {
            wrong.push(format!("the value {id:?} belongs to no commit; commit all changes, and measure it again"));
        }
    }
    for (_, row) in claims.rows() {
        let Some(measured) = values.get(&row.id) else { continue };
        match (row.verdict(measured.value), &row.missed) {
            (Verdict::Missed, None) => {
                wrong.push(format!("{:?} misses its bar; say why with `missed` in its claim", row.id));
            }
            (Verdict::Met, Some(_)) => {
                wrong.push(format!("{:?} meets its bar; remove `missed` from its claim", row.id));
            }
            _ => {}
        }
    }
    for group in &claims.groups {
        if group.rows.iter().any(|row| values.get(&row.id).is_some()) {
            for table in group.tables.iter().filter(|table| !repository.table(&table.to).is_file()) {
                let (to, name) = (&table.to, &group.name);
                wrong.push(format!(
                    "the page links to results/{to}, which is missing; run `cargo results measure {name}`"
                ));
            }
        }
    }
    let read = |path: PathBuf| fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()));
    let found = read(repository.page())?;
    if found != render::render(claims, values) {
        wrong.push(format!("{PAGE} is stale; run `cargo results render`"));
    }
    if read(repository.table(MORE))? != render::render_more(claims, values) {
        wrong.push(format!("{FOLDER}/{MORE} is stale; run `cargo results render`"));
    }
    if found.len() > MOST_BYTES {
        wrong.push(format!("{PAGE} has {} bytes; at most {MOST_BYTES} are allowed: move rows to a table", found.len()));
    }
    ensure!(wrong.is_empty(), "{}", wrong.join("\n"));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::tests::{CLAIMS, VALUES};

    fn refusal(claims: &str, values: &str, edit: impl FnOnce(String) -> String) -> String {
        let folder = tempfile::tempdir().unwrap();
        let repository = Repository::at(folder.path());
        let (claims, values) = (Claims::parse(claims).unwrap(), Values::parse(values).unwrap());
        fs::create_dir(repository.table("")).unwrap();
        fs::write(repository.table(MORE), render::render_more(&claims, &values)).unwrap();
        fs::write(repository.page(), edit(render::render(&claims, &values))).unwrap();
        check(&repository, &claims, &values).err().map_or_else(String::new, |error| error.to_string())
    }

    #[test]
    fn claims_values_and_page_must_agree() {
        let same = |page| page;
        assert_eq!(refusal(CLAIMS, VALUES, same), "");
        assert!(refusal(CLAIMS, VALUES, |page| page.replace("1.05", "1.04")).contains("stale"));
        let unknown = VALUES.replace("good.a", "good.z");
        assert!(refusal(CLAIMS, &unknown, same).contains("has no claim"));
        assert!(refusal(CLAIMS, &VALUES.replace("M2", ""), same).contains("machine"));
        assert!(refusal(CLAIMS, &VALUES.replace("abc1234", "abc1234+changes"), same).contains("belongs to no commit"));
        assert!(refusal(&CLAIMS.replace("missed = \"The reason.\"", ""), VALUES, same).contains("say why"));
        assert!(refusal(CLAIMS, &VALUES.replace("0.5", "1.5"), same).contains("remove `missed`"));
        let with_table = CLAIMS.replace("commands = [\"true\"]\n[[group.row]]\nid = \"bad.c\"", "commands = [\"true\"]\n[[group.table]]\nfrom = \"a.md\"\nto = \"a.md\"\ntitle = \"T\"\n[[group.row]]\nid = \"bad.c\"");
        assert!(refusal(&with_table, VALUES, same).contains("missing"));
        let long = CLAIMS.replace("An introduction.", &"long ".repeat(3000));
        assert!(refusal(&long, VALUES, same).contains("bytes"));
    }

    #[test]
    fn a_missing_page_is_reported() {
        let folder = tempfile::tempdir().unwrap();
        let (claims, values) = (Claims::parse(CLAIMS).unwrap(), Values::parse(VALUES).unwrap());
        assert!(
            check(&Repository::at(folder.path()), &claims, &values).unwrap_err().to_string().contains("cannot read")
        );
    }
}
