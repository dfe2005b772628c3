//! Reasons that a hand cannot be read.

use std::path::{Path, PathBuf};

use mvt_pinned::FetchError;
use mvt_robot::digit::profile::ProfileError;
use mvt_robot::hand::{HandError, Side};

/// Reason that a hand file cannot be used. Each message is one line and says what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum HandFileError {
    /// A file cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Reason of the operating system.
        source: std::io::Error,
    },
    /// The file is not a hand file.
    #[error("{}, line {line}: {reason}", path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// Line of the fault, from 1.
        line: usize,
        /// Reason of the parser.
        reason: String,
    },
    /// The hand file contradicts itself or its model.
    #[error("{}: {reason}", path.display())]
    Content {
        /// The hand file.
        path: PathBuf,
        /// What is wrong, and what to do.
        reason: String,
    },
    /// The MJCF or URDF cannot be used.
    #[error("{}: {reason}", path.display())]
    Model {
        /// The MJCF or URDF.
        path: PathBuf,
        /// What is wrong, and what to do.
        reason: String,
    },
    /// A sensor profile cannot be used.
    #[error("{}: pad {pad}: {}", path.display(), one_line(&source.to_string()))]
    Profile {
        /// The hand file.
        path: PathBuf,
        /// The pad.
        pad: String,
        /// What is wrong with its profile.
        source: Box<ProfileError>,
    },
    /// The result is not a hand.
    #[error("{}: {source}", path.display())]
    Hand {
        /// The hand file.
        path: PathBuf,
        /// What is wrong.
        source: HandError,
    },
    /// There is no hand of this name, and it is not a file.
    #[error("there is no rig {name:?}: choose {known}, or give the path of a hand file that ends in .toml")]
    Unknown {
        /// The unknown name.
        name: String,
        /// The names that exist, separated by commas.
        known: String,
    },
    /// The hand has another side.
    #[error("{hand} is a {} hand, and --side {} asks for another; leave --side out, or name a file of that hand", side.name(), asked.name())]
    Side {
        /// Name of the hand.
        hand: String,
        /// Its side.
        side: Side,
        /// The side that was asked for.
        asked: Side,
    },
    /// The files of a shipped hand cannot be fetched.
    #[error(transparent)]
    Fetch(#[from] FetchError),
}

impl HandFileError {
    /// Adds the path of the hand file to a reason.
    pub(crate) fn content(path: &Path) -> impl Fn(String) -> Self {
        let path = path.to_owned();
        move |reason| Self::Content { path: path.clone(), reason: one_line(&reason) }
    }

    /// Adds the path of the model to a reason.
    pub(crate) fn model(path: &Path) -> impl Fn(String) -> Self {
        let path = path.to_owned();
        move |reason| Self::Model { path: path.clone(), reason: one_line(&reason) }
    }
}

/// Joins the lines of a message.
pub(crate) fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Returns a message about a name that does not exist, with the nearest of those that do.
pub(crate) fn unknown<'a>(what: &str, name: &str, known: impl Iterator<Item = &'a str>) -> String {
    // More names than this do not fit on a line.
    const LISTED: usize = 12;
    let known: Vec<&str> = known.collect();
    let nearest = known
        .iter()
        .map(|known| (strsim::damerau_levenshtein(&name.to_lowercase(), &known.to_lowercase()), known))
        .min_by_key(|(distance, _)| *distance)
        // A name that shares less than half of its letters is no help.
        .filter(|(distance, known)| 2 * distance <= known.chars().count().max(name.chars().count()));
    let advice = match (nearest, known.as_slice()) {
        (_, []) => "it has none".to_owned(),
        (Some((_, nearest)), _) => format!("did you mean {nearest:?}?"),
        (None, _) if known.len() <= LISTED => format!("choose one of {}", known.join(", ")),
        (None, _) => format!("choose one of {}, ...", known[..LISTED].join(", ")),
    };
    format!("there is no {what} {name:?}; {advice}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_name_is_suggested() {
        let known = || ["if_mcp", "if_rot", "th_cmc"].into_iter();
        assert_eq!(unknown("joint", "if_mpc", known()), "there is no joint \"if_mpc\"; did you mean \"if_mcp\"?");
        assert_eq!(
            unknown("joint", "knee", known()),
            "there is no joint \"knee\"; choose one of if_mcp, if_rot, th_cmc"
        );
        assert_eq!(unknown("site", "x", [].into_iter()), "there is no site \"x\"; it has none");
    }

    #[test]
    fn messages_are_one_line() {
        assert_eq!(one_line(" XML Error:\n  no file \n"), "XML Error: no file");
    }
}
