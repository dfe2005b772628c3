//! Thread for work that takes longer than a frame of the window. It serves the newest request and drops older ones that
//! it has not begun.

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;

use eframe::egui::Context;

/// Work of a thread.
pub trait Work: Send + 'static {
    /// Description of the work.
    type Request: Send + Clone + PartialEq + 'static;
    /// Result of the work.
    type Output: Send + 'static;

    /// Serves a request.
    fn run(&mut self, request: Self::Request) -> Self::Output;

    /// Called when there is no request. Returns after how long it should be called again, if at all, and whether to
    /// wake the window.
    fn idle(&mut self) -> (Option<Duration>, bool) {
        (None, false)
    }
}

// Why: notes/decisions/viewing.md, "The newest order, never a queue".
/// Handle of a thread that serves the newest request.
pub struct LatestWorker<W: Work> {
    channel: Arc<Channel<W>>,
    last: Option<W::Request>,
}

struct Channel<W: Work> {
    state: Mutex<State<W>>,
    changed: Condvar,
}

struct State<W: Work> {
    request: Option<W::Request>,
    output: Option<W::Output>,
    is_working: bool,
    is_closed: bool,
}

impl<W: Work> Channel<W> {
    fn state(&self) -> MutexGuard<'_, State<W>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<W: Work> LatestWorker<W> {
    /// Starts a thread, which calls `create` first. It wakes the window when there is an output.
    pub fn new(ctx: Context, create: impl FnOnce() -> W + Send + 'static) -> Self {
        let state = State { request: None, output: None, is_working: false, is_closed: false };
        let channel = Arc::new(Channel { state: Mutex::new(state), changed: Condvar::new() });
        let worker = Arc::clone(&channel);
        thread::spawn(move || serve(&worker, create(), &ctx));
        Self { channel, last: None }
    }

    /// Requests work, unless it equals the last request.
    pub fn request(&mut self, request: W::Request) {
        if self.last.as_ref() != Some(&request) {
            self.last = Some(request.clone());
            self.channel.state().request = Some(request);
            self.channel.changed.notify_all();
        }
    }

    /// Takes the newest output.
    pub fn take(&self) -> Option<W::Output> {
        self.channel.state().output.take()
    }

    /// Whether a request is waiting or being served, or an output was not taken.
    pub fn is_busy(&self) -> bool {
        let state = self.channel.state();
        state.request.is_some() || state.is_working || state.output.is_some()
    }
}

impl<W: Work> Drop for LatestWorker<W> {
    fn drop(&mut self) {
        self.channel.state().is_closed = true;
        self.channel.changed.notify_all();
    }
}

/// Delay of a repaint. One repaint serves all outputs within this time; without a delay egui repaints twice.
const SOON: Duration = Duration::from_millis(5);

fn serve<W: Work>(channel: &Channel<W>, mut work: W, ctx: &Context) {
    // A run in another process comes first: this thread, and those that it starts, get a lower priority.
    #[cfg(target_os = "linux")]
    let _ = rustix::process::nice(5);
    let mut state = channel.state();
    loop {
        if state.is_closed {
            return;
        }
        if let Some(request) = state.request.take() {
            state.is_working = true;
            drop(state);
            let output = work.run(request);
            state = channel.state();
            state.is_working = false;
            state.output = Some(output);
            ctx.request_repaint_after(SOON);
            continue;
        }
        drop(state);
        let (again, has_news) = work.idle();
        if has_news {
            ctx.request_repaint_after(SOON);
        }
        state = channel.state();
        if state.request.is_none() && !state.is_closed {
            state = match again {
                Some(delay) => {
                    channel.changed.wait_timeout(state, delay).map_or_else(|broken| broken.into_inner().0, |(s, _)| s)
                }
                None => channel.changed.wait(state).unwrap_or_else(PoisonError::into_inner),
            };
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc;
    use std::time::Instant;

    use super::*;

    /// Reports when it begins and waits for permission to go on.
    struct Slow {
        begun: mpsc::Sender<u32>,
        go: mpsc::Receiver<()>,
    }

    impl Work for Slow {
        type Request = u32;
        type Output = u32;

        fn run(&mut self, request: u32) -> u32 {
            self.begun.send(request).unwrap();
            self.go.recv().unwrap();
            10 * request
        }
    }

    #[test]
    fn requests_that_were_not_begun_are_dropped() {
        let (begun_sender, begun) = mpsc::channel();
        let (go_sender, go) = mpsc::channel();
        let mut worker = LatestWorker::new(Context::default(), || Slow { begun: begun_sender, go });
        worker.request(1);
        assert_eq!(begun.recv().unwrap(), 1);
        (2..=5).for_each(|request| worker.request(request));
        go_sender.send(()).unwrap();
        assert_eq!(begun.recv().unwrap(), 5);
        assert_eq!(worker.take(), Some(10));
        go_sender.send(()).unwrap();
        let deadline = Instant::now() + Duration::from_secs(60);
        let output = loop {
            match worker.take() {
                None if Instant::now() < deadline => thread::sleep(Duration::from_millis(1)),
                output => break output,
            }
        };
        assert_eq!(output, Some(50));
        // An equal request is ignored.
        worker.request(5);
        assert!(!worker.is_busy());
    }
}
