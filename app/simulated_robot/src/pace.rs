//! The pace of a simulated robot: in real time, or slower.

use std::time::{Duration, Instant};

/// Lag that a computer catches up without a word.
const LAG: Duration = Duration::from_millis(50);

/// Keeps simulated time at a pace.
#[derive(Debug)]
pub(crate) struct Pace {
    begun: Instant,
    /// When simulated time 0 was, or would have been if nothing had been late.
    zero: Instant,
    speed: f64,
    /// Whether time that was lost is given up; otherwise it is caught up.
    gives_way: bool,
    simulated_s: f64,
    lag: Duration,
}

impl Pace {
    /// Starts at simulated time 0, with so many simulated seconds per second.
    pub fn new(speed: f64, gives_way: bool) -> Self {
        let now = Instant::now();
        Self { begun: now, zero: now, speed, gives_way, simulated_s: 0.0, lag: Duration::ZERO }
    }

    /// Waits until a simulated time.
    pub fn wait(&mut self, simulated_s: f64) {
        self.simulated_s = simulated_s;
        let due = self.zero + Duration::from_secs_f64(simulated_s / self.speed);
        let now = Instant::now();
        self.lag = now.saturating_duration_since(due);
        std::thread::sleep(due.saturating_duration_since(now));
        if self.gives_way && self.lag > LAG {
            self.zero += self.lag;
        }
    }

    /// Returns how late simulated time is; small lags do not count.
    pub fn lag(&self) -> Duration {
        if self.lag > LAG { self.lag } else { Duration::ZERO }
    }

    /// Returns the simulated seconds per second so far.
    pub fn reached(&self) -> f64 {
        self.simulated_s / self.begun.elapsed().as_secs_f64().max(1e-9)
    }
}
