//! A whole connection: source, publisher and record.

use std::path::Path;
use std::sync::Arc;

use anyhow::Result;
use mvt_run::report::SharedLiveRecord;

use crate::bus::Bus;
use crate::publisher::RosPublisher;
use crate::setup::RosSetup;
use crate::source::{Link, LiveOptions, RosSource};

/// A connection that is open.
pub struct LiveConnection {
    /// Its frames.
    pub source: RosSource,
    /// Publishes the results.
    pub publisher: RosPublisher,
    /// Its counts, which source and publisher update.
    pub record: SharedLiveRecord,
}

impl LiveConnection {
    /// Connects as a file states, and waits until the camera model and a depth image have arrived.
    ///
    /// # Errors
    /// If the network cannot be used, or the file does not fit the hand.
    pub fn open(setup: &RosSetup, file: &Path, options: LiveOptions<'_>) -> Result<Self> {
        let bus = Arc::new(Bus::join(setup.domain(), &setup.addresses)?);
        let link = Arc::new(Link::default());
        let publisher = RosPublisher::announce(&bus, &setup.publish, Arc::clone(&link))?;
        let record = Arc::clone(&link.record);
        let source = RosSource::open(bus, setup, file, options, link)?;
        Ok(Self { source, publisher, record })
    }
}
