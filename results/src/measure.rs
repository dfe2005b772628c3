//! `cargo results measure`: runs the commands of groups, stores their values and rewrites the page.

use std::fs;
use std::io::ErrorKind;
use std::path::Path;
use std::process::Command;

use anyhow::{Context as _, Result, bail, ensure};

use crate::claims::{Claims, Group, Verdict};
use crate::extract::{self, Figure};
use crate::place::{CHANGES, PAGE, Repository, machine};
use crate::tables::{self, Origin};
use crate::values::{Measured, Values};
use crate::{print, render};

/// The inputs of a measurement.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Start {
    /// An empty scratch folder.
    Clean,
    /// The files of an interrupted measurement.
    Keep,
    /// The files of the last measurement; no command runs.
    Reread,
}

/// The name for all groups that have no values of the present commit.
const ALL: &str = "all";
/// The file of a group's folder that names the commit whose program wrote the others.
const COMMIT: &str = "commit.txt";

/// Measures groups one after the other. Each group's values are stored as soon as they are known. A group that fails does not stop the others.
pub fn measure(
    repository: &Repository,
    claims: &Claims,
    values: &mut Values,
    names: &[String],
    start: Start,
) -> Result<()> {
    let (present, date) = (repository.commit()?, repository.date()?);
    ensure!(
        !present.ends_with(CHANGES),
        "tracked files differ from the commit {present}: commit them first, so that the values belong to a commit"
    );
    let groups: Vec<&Group> = if names == [ALL] {
        let is_stale = |id: &str| values.get(id).is_none_or(|measured| measured.commit != present);
        claims.groups.iter().filter(|group| group.rows.iter().any(|row| is_stale(&row.id))).collect()
    } else {
        names.iter().map(|name| claims.group(name)).collect::<Result<_>>()?
    };
    let mut failures = Vec::new();
    for group in groups {
        let folder = repository.scratch(&group.name);
        prepare(repository, group, start)?;
        if start != Start::Reread {
            if let Err(error) = run(repository, group) {
                failures.push(format!("{}: {error:#}", group.name));
                continue;
            }
            // At the end: some commands want an empty folder.
            let path = folder.join(COMMIT);
            fs::write(&path, &present).with_context(|| format!("cannot write {}", path.display()))?;
        }
        let commit = fs::read_to_string(folder.join(COMMIT)).unwrap_or_else(|_| present.clone());
        // Files that another machine wrote come with its name.
        let machine =
            fs::read_to_string(folder.join("machine.txt")).map_or_else(|_| machine(), |text| text.trim().to_owned());
        let origin = Origin { commit: &commit, machine: &machine, date: &date };
        for row in &group.rows {
            match extract::figure(row, &folder) {
                Ok(Figure { value, error }) => {
                    let (commit, machine, date) = (commit.clone(), machine.clone(), date.clone());
                    let measured = Measured { id: row.id.clone(), value, error, commit, machine, date };
                    let verdict = if row.verdict(value) == Verdict::Missed { "  MISSED" } else { "" };
                    print(&format!("{}: {} (bar {}){verdict}", row.id, render::shown(row, &measured), row.bar()))?;
                    values.set(measured);
                }
                Err(error) => failures.push(format!("{}: {error:#}", row.id)),
            }
        }
        for table in &group.tables {
            let written = tables::copy(group, table, &folder, origin).and_then(|text| {
                let path = repository.table(&table.to);
                fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))
            });
            if let Err(error) = written {
                failures.push(format!("{}: {error:#}", table.to));
            }
        }
        values.save(&repository.values(), claims)?;
        render::write(repository, claims, values)?;
    }
    report(&failures, &format!("{PAGE} is rewritten; these keep their old values"))
}

/// Runs a group's commands and looks for its values, but stores nothing.
pub fn rehearse(repository: &Repository, group: &Group) -> Result<()> {
    prepare(repository, group, Start::Clean)?;
    run(repository, group)?;
    let folder = repository.scratch(&group.name);
    let failures: Vec<String> = group
        .rows
        .iter()
        .filter_map(|row| Some(format!("{}: {:#}", row.id, extract::figure(row, &folder).err()?)))
        .collect();
    report(&failures, &format!("group {:?} yields no value for some rows", group.name))?;
    print(&format!("group {:?} yields a value for each of its {} rows", group.name, group.rows.len()))
}

/// Fails with a list, if there is anything on it.
fn report(failures: &[String], what: &str) -> Result<()> {
    ensure!(failures.is_empty(), "{what}:\n  {}", failures.join("\n  "));
    Ok(())
}

/// Empties the scratch folder unless its files are wanted.
fn prepare(repository: &Repository, group: &Group, start: Start) -> Result<()> {
    let folder = repository.scratch(&group.name);
    match start {
        Start::Clean => remove(&folder)?,
        Start::Keep => {}
        Start::Reread => {
            ensure!(folder.is_dir(), "{} does not exist; measure without --reread first", folder.display());
        }
    }
    fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))
}

fn remove(folder: &Path) -> Result<()> {
    match fs::remove_dir_all(folder) {
        Err(error) if error.kind() != ErrorKind::NotFound => {
            Err(error).with_context(|| format!("cannot remove {}", folder.display()))
        }
        _ => Ok(()),
    }
}

/// Runs a group's commands in order and shows them.
fn run(repository: &Repository, group: &Group) -> Result<()> {
    for command in &group.commands {
        let command = Repository::expanded(command, &group.name);
        print(&format!("$ {}", command.trim()))?;
        let status = Command::new("bash")
            .args(["-euo", "pipefail", "-c", &command])
            .current_dir(repository.root())
            .status()
            .context("cannot start bash, which runs the commands")?;
        if !status.success() {
            let name = &group.name;
            bail!(
                "a command of group {name:?} failed ({status}): {command}\nAfter a repair, --keep resumes the measurement"
            );
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const CLAIMS: &str = r#"
introduction = []
[[group]]
name = "g"
title = "G"
simulated = false
minutes = 0.1
commands = ["echo '{\"a\": 1.25, \"b\": null}' > $OUT/a.json", "cp $OUT/a.json $OUT/b.json"]
[[group.table]]
from = "b.json"
to = "g.md"
title = "Table"
columns = ["a"]
[[group.row]]
id = "g.a"
claim = "Claim A"
value = { file = "a.json", field = "a" }
"#;

    fn repository(folder: &Path, claims: &str) -> (Repository, Claims) {
        fs::create_dir(folder.join("results")).unwrap();
        let git = |arguments: &[&str]| {
            let identity = ["-c", "user.name=t", "-c", "user.email=t@t", "-c", "commit.gpgsign=false"];
            let run = Command::new("git").args(identity).args(arguments).current_dir(folder).output().unwrap();
            assert!(run.status.success(), "{run:?}");
        };
        fs::write(folder.join("results/claims.toml"), claims).unwrap();
        git(&["init", "--quiet"]);
        git(&["add", "."]);
        git(&["commit", "--quiet", "-m", "Start"]);
        (Repository::at(folder), Claims::parse(claims).unwrap())
    }

    #[test]
    fn a_measurement_stores_values_tables_and_page() {
        let folder = tempfile::tempdir().unwrap();
        let (repository, claims) = repository(folder.path(), CLAIMS);
        let mut values = Values::default();
        measure(&repository, &claims, &mut values, &["g".to_owned()], Start::Clean).unwrap();
        let stored = Values::load(&repository.values()).unwrap();
        let measured = stored.get("g.a").unwrap();
        assert_eq!(measured.value, 1.25);
        assert_eq!(measured.commit.len(), 7, "its own files are no changes: {}", measured.commit);
        assert!(fs::read_to_string(folder.path().join("results/g.md")).unwrap().contains("| 1.25 |"));
        assert!(fs::read_to_string(repository.page()).unwrap().contains("Claim A"));
        crate::check::check(&repository, &claims, &stored).unwrap();
        rehearse(&repository, claims.group("g").unwrap()).unwrap();

        fs::remove_file(folder.path().join("target/results/g/b.json")).unwrap();
        let all = ["all".to_owned()];
        measure(&repository, &claims, &mut values, &all, Start::Clean).unwrap();
        assert!(!folder.path().join("target/results/g/b.json").exists(), "its values are those of the commit");
        fs::write(repository.claims(), "changed").unwrap();
        let error = measure(&repository, &claims, &mut values, &all, Start::Clean).unwrap_err();
        assert!(error.to_string().contains("commit them first"), "{error:#}");
    }

    #[test]
    fn rows_without_value_and_failing_commands_are_reported() {
        let folder = tempfile::tempdir().unwrap();
        let text = CLAIMS.replace("field = \"a\" }", "field = \"b\" }");
        let (repository, claims) = repository(folder.path(), &text);
        let names = ["g".to_owned()];
        let error = measure(&repository, &claims, &mut Values::default(), &names, Start::Clean).unwrap_err();
        assert!(format!("{error:#}").contains("g.a"), "{error:#}");
        assert!(rehearse(&repository, claims.group("g").unwrap()).is_err());
        let failing = Claims::parse(&text.replace("cp ", "false; cp ")).unwrap();
        let error = measure(&repository, &failing, &mut Values::default(), &names, Start::Clean).unwrap_err();
        assert!(format!("{error:#}").contains("failed"), "{error:#}");
        assert!(measure(&repository, &claims, &mut Values::default(), &["h".to_owned()], Start::Clean).is_err());
    }
}
