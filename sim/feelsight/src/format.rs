//! The two layouts of a log.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::archive::ARCHIVE;

/// Layout of a log.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LogFormat {
    /// FeelSight's, which other programs read.
    #[default]
    FeelSight,
    /// A few files of an eighth of the size; docs/compact_log.md describes them.
    Compact,
}

impl LogFormat {
    /// Returns the layout of a log, by the presence of its archive.
    pub fn of(log: &Path) -> Self {
        if log.join(ARCHIVE).symlink_metadata().is_ok() { Self::Compact } else { Self::FeelSight }
    }
}

impl std::str::FromStr for LogFormat {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        match name {
            "feelsight" => Ok(Self::FeelSight),
            "compact" => Ok(Self::Compact),
            _ => Err("give feelsight or compact".to_owned()),
        }
    }
}

impl std::fmt::Display for LogFormat {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::FeelSight => "feelsight",
            Self::Compact => "compact",
        })
    }
}
