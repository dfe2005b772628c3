//! `--foxglove` of `run` and `view`.

#[cfg(feature = "foxglove")]
use std::net::IpAddr;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::Result;
use clap::Args;

/// How often a view looks whether it shall end.
const LOOK: Duration = Duration::from_millis(50);

/// Whether and where a run is shown to Foxglove. Without the feature `foxglove` there are no such options, and nobody listens.
#[derive(Debug, Clone, Args)]
pub struct FoxgloveArguments {
    /// Show the run in Foxglove while it goes on: listen on this port for a WebSocket connection, 0 for a free one [default: 8765]
    #[cfg(feature = "foxglove")]
    #[arg(long, value_name = "PORT", num_args = 0..=1, default_missing_value = "8765")]
    foxglove: Option<u16>,
    /// Address of this computer on which --foxglove listens; others than the default let other computers in, without password or encryption
    #[cfg(feature = "foxglove")]
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1", requires = "foxglove")]
    foxglove_address: IpAddr,
}

/// Shows a run to Foxglove until it is dropped.
pub struct FoxgloveView {
    #[cfg(feature = "foxglove")]
    server: crate::FoxgloveServer,
    /// The address, if it is to be said.
    #[cfg(feature = "foxglove")]
    address: Option<std::net::SocketAddr>,
}

impl FoxgloveArguments {
    /// Listens, if that was asked for. Says where as soon as there is something to show, unless it is to be `quiet`.
    ///
    /// # Errors
    /// If the port cannot be used.
    #[cfg_attr(not(feature = "foxglove"), allow(unused_variables, reason = "nothing is said"))]
    pub fn listen(&self, quiet: bool) -> Result<Option<FoxgloveView>> {
        #[cfg(feature = "foxglove")]
        if let Some(port) = self.foxglove {
            let server = crate::FoxgloveServer::listen(self.foxglove_address, port)?;
            let address = std::net::SocketAddr::new(self.foxglove_address, server.port());
            return Ok(Some(FoxgloveView { server, address: (!quiet).then_some(address) }));
        }
        Ok(None)
    }
}

impl FoxgloveView {
    /// Shows the run in a folder, whose recording has begun.
    ///
    /// # Errors
    /// If the folder holds no recording.
    #[cfg_attr(not(feature = "foxglove"), allow(unused_variables, reason = "there is no view"))]
    pub fn show(&mut self, run: &Path) -> Result<()> {
        #[cfg(feature = "foxglove")]
        self.follow(run, false)?;
        Ok(())
    }

    #[cfg(feature = "foxglove")]
    fn follow(&mut self, run: &Path, is_replayed: bool) -> Result<()> {
        self.server.follow(run, is_replayed)?;
        match self.address {
            Some(address) => mvt_run::io::print_line(&format!("Foxglove: open a connection to ws://{address}")),
            None => Ok(()),
        }
    }

    /// Ends when clients have received the rest of a run that has ended.
    pub fn finish(self) {
        #[cfg(feature = "foxglove")]
        drop(self.server);
    }

    /// Shows the run in a folder, again and again once it has ended, until `stop` is set.
    ///
    /// # Errors
    /// If the folder holds no recording.
    #[cfg_attr(not(feature = "foxglove"), allow(unused_mut, unused_variables, reason = "there is no view"))]
    pub fn watch(mut self, run: &Path, stop: &AtomicBool) -> Result<()> {
        #[cfg(feature = "foxglove")]
        self.follow(run, true)?;
        while !stop.load(Ordering::Relaxed) {
            std::thread::sleep(LOOK);
        }
        Ok(())
    }
}
