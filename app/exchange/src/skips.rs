//! Parts of a source that are not used, counted by place and reason.

/// Different reasons that are kept of a topic or column.
const MOST: usize = 8;

#[derive(Debug)]
struct Skip {
    topic: String,
    reason: String,
    count: usize,
    /// Place of the first one.
    first: String,
}

/// Parts of a source that are not used.
#[derive(Debug, Default)]
pub(crate) struct Skips(Vec<Skip>);

impl Skips {
    /// Counts a part that is not used. `place` names it within its topic or column.
    pub fn add(&mut self, topic: &str, place: String, reason: String) {
        let of_topic = || self.0.iter().filter(|skip| skip.topic == topic);
        let known = self.0.iter().position(|skip| skip.topic == topic && skip.reason == reason);
        let reason = if known.is_none() && of_topic().count() >= MOST { "other defects".to_owned() } else { reason };
        match self.0.iter_mut().find(|skip| skip.topic == topic && skip.reason == reason) {
            Some(skip) => skip.count += 1,
            None => self.0.push(Skip { topic: topic.to_owned(), reason, count: 1, first: place }),
        }
    }

    /// Returns the number of skipped parts of a topic or column.
    pub fn count(&self, topic: &str) -> usize {
        self.0.iter().filter(|skip| skip.topic == topic).map(|skip| skip.count).sum()
    }

    /// Returns the first defect of a topic or column, with its place.
    pub fn first(&self, topic: &str) -> Option<String> {
        let skip = self.0.iter().find(|skip| skip.topic == topic)?;
        Some(format!("{}: {}", skip.first, skip.reason))
    }

    /// Returns a sentence for each topic and reason.
    pub fn notes(&self) -> impl Iterator<Item = String> {
        self.0.iter().map(|Skip { topic, reason, count, first }| {
            let times = if *count == 1 { "once".to_owned() } else { format!("{count} times, first") };
            format!("{topic}: skipped {times} at {first}: {reason}")
        })
    }
}
