//! Messages of MuJoCo.

use std::sync::Once;

use mujoco_rs::prelude::*;

/// Sends MuJoCo's messages to `tracing` instead of to a file in the working folder. Every use of MuJoCo calls it first.
pub fn route() {
    static ROUTED: Once = Once::new();
    ROUTED.call_once(|| {
        // SAFETY: every use of MuJoCo in this workspace comes after this call, which runs once.
        unsafe {
            set_log_handler(|message| match message.level() {
                MjtLogLevel::mjLOG_DEBUG | MjtLogLevel::mjLOG_INFO => tracing::debug!("MuJoCo: {}", message.subject()),
                MjtLogLevel::mjLOG_WARNING => tracing::warn!("MuJoCo: {}", message.subject()),
                MjtLogLevel::mjLOG_ERROR => tracing::error!("MuJoCo: {}", message.subject()),
            });
        }
    });
}
