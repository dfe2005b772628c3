//! The clock of stamps.

use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// A simulator whose clock stands for longer is silent.
const STANDS: Duration = Duration::from_secs(1);

/// Returns the time of our clock since 1970, nanoseconds.
fn computer_ns() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    i64::try_from(since.as_nanos()).unwrap_or(i64::MAX)
}

/// Clock to which stamps belong: that of the computer, or that of a simulator, which publishes it on /clock.
#[derive(Debug, Default)]
pub struct LiveClock {
    /// `None` for the computer's clock.
    simulated: Option<Mutex<SimulatedClock>>,
}

#[derive(Debug, Default)]
struct SimulatedClock {
    /// Newest reading, nanoseconds, and when it arrived.
    newest: Option<(i64, Instant)>,
}

impl LiveClock {
    /// Returns the clock of the computer, or one that is set by [`LiveClock::set`].
    pub fn new(is_simulated: bool) -> Self {
        Self { simulated: is_simulated.then(Mutex::default) }
    }

    fn newest(&self) -> Option<Option<(i64, Instant)>> {
        let simulated = self.simulated.as_ref()?;
        Some(simulated.lock().unwrap_or_else(PoisonError::into_inner).newest)
    }

    /// Returns whether it is set by a simulator.
    pub fn is_simulated(&self) -> bool {
        self.simulated.is_some()
    }

    /// Returns whether its time is known.
    pub fn is_known(&self) -> bool {
        self.newest().is_none_or(|newest| newest.is_some())
    }

    /// Returns whether it has stood still for a second.
    pub fn stands(&self) -> bool {
        self.newest().flatten().is_some_and(|(_, arrived)| arrived.elapsed() > STANDS)
    }

    /// Returns its time, nanoseconds; 0 while it is unknown.
    pub fn now_ns(&self) -> i64 {
        match self.newest() {
            None => computer_ns(),
            Some(newest) => newest.map_or(0, |(reading_ns, _)| reading_ns),
        }
    }

    /// Sets the time of a simulator, nanoseconds. Has no effect on the computer's clock.
    pub fn set(&self, reading_ns: i64) {
        if let Some(simulated) = &self.simulated {
            simulated.lock().unwrap_or_else(PoisonError::into_inner).newest = Some((reading_ns, Instant::now()));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_clock_of_a_simulator_is_what_it_says() {
        let clock = LiveClock::new(true);
        assert_eq!((clock.is_known(), clock.now_ns(), clock.stands()), (false, 0, false));
        clock.set(77);
        assert_eq!((clock.is_known(), clock.now_ns(), clock.stands()), (true, 77, false));
        let clock = LiveClock::new(false);
        clock.set(77);
        assert!(clock.is_known() && clock.now_ns() > 1_000_000_000);
    }
}
