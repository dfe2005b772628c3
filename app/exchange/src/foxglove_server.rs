//! A run over WebSocket, for Foxglove, rerun's and other programs that show it while it goes on.

// Why: notes/decisions/viewing.md, "Foxglove reads the recording, not the run".

use std::collections::BTreeMap;
use std::io;
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use ::foxglove::websocket::{ChannelView, Client, ServerListener};
use ::foxglove::{Context, PartialMetadata, RawChannel, Schema, WebSocketServerHandle};
use anyhow::{Context as _, Result};
use mvt_recording::Recording;

use crate::error::ExchangeError;
use crate::run_messages::RunMessages;
use crate::schema::MessageType;
use crate::writer::{Channel, MessageSink};

/// Messages that wait for a client, some 20 MB of images and points: what a slower one does not take is dropped.
const WAITING: usize = 64;
/// How often the recording is looked at.
const LOOK: Duration = Duration::from_millis(20);
/// A run that is so many frames ahead is followed without images.
const BEHIND: usize = 15;
/// How long clients have time to take the last messages, and to say goodbye.
const GRACE: Duration = Duration::from_millis(300);
/// Pause before a finished run begins again.
const PAUSE: Duration = Duration::from_secs(2);

/// Message with its channel and its time, nanoseconds.
type Sent = (Arc<RawChannel>, Vec<u8>, u64);

/// What clients receive when they subscribe: the newest message of each channel, by its topic.
#[derive(Default)]
struct Newest(Mutex<BTreeMap<String, Sent>>);

impl Newest {
    fn lock(&self) -> MutexGuard<'_, BTreeMap<String, Sent>> {
        // A message is replaced whole.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl ServerListener for Newest {
    fn on_subscribe(&self, client: Client, channel: ChannelView<'_>) {
        // Meshes and calibrations come seldom.
        if let Some((channel, message, time_ns)) = self.lock().get(channel.topic()) {
            channel.log_with_meta_to_sink(message, PartialMetadata::with_log_time(*time_ns), client.sink_id());
        }
    }
}

/// The channels of a run as programs that watch see them.
struct Watched {
    context: Arc<Context>,
    channels: Vec<Arc<RawChannel>>,
    newest: Arc<Newest>,
}

impl MessageSink for Watched {
    fn channel(&mut self, topic: &str, of: &'static MessageType) -> io::Result<Channel> {
        let schema = Schema::new(of.full_name(), "protobuf", of.descriptor_set());
        let builder = self.context.channel_builder(topic).schema(schema).message_encoding("protobuf");
        self.channels.push(builder.build_raw().map_err(io::Error::other)?);
        Ok(Channel((self.channels.len() - 1) as u16))
    }

    fn push(&mut self, Channel(number): Channel, time_ns: u64, data: &[u8]) -> io::Result<()> {
        let Some(channel) = self.channels.get(usize::from(number)) else { return Ok(()) };
        // Whoever subscribes meanwhile receives the message once or twice, and not never.
        self.newest.lock().insert(channel.topic().to_owned(), (Arc::clone(channel), data.to_vec(), time_ns));
        channel.log_with_meta(data, PartialMetadata::with_log_time(time_ns));
        Ok(())
    }
}

/// Server to which Foxglove connects. It reads the recording of a run on a thread of its own, so that neither it nor a slow client ever
/// holds up the run.
pub struct FoxgloveServer {
    context: Arc<Context>,
    newest: Arc<Newest>,
    /// `None` after the end.
    server: Option<WebSocketServerHandle>,
    follower: Option<JoinHandle<()>>,
    /// Asks the follower to end as soon as it has sent all.
    ends: Arc<AtomicBool>,
}

impl FoxgloveServer {
    /// Listens on an address and a port; with port 0 on any that is free.
    ///
    /// # Errors
    /// If the port is in use or not allowed.
    pub fn listen(address: IpAddr, port: u16) -> Result<Self> {
        if !address.is_loopback() {
            tracing::warn!(
                "Foxglove at {address}: whoever reaches this address sees the run, without password or encryption"
            );
        }
        let (context, newest) = (Context::new(), Arc::new(Newest::default()));
        let server = context.websocket_server().name("mambavitact").bind(address.to_string(), port);
        let listener: Arc<dyn ServerListener> = newest.clone();
        let server = server.message_backlog_size(WAITING).listener(listener).start_blocking();
        let server = server.with_context(|| {
            format!(
                "--foxglove cannot listen on {address}, port {port}: give another port, or end the program that uses it"
            )
        })?;
        Ok(Self { context, newest, server: Some(server), follower: None, ends: Arc::default() })
    }

    /// Returns the port.
    pub fn port(&self) -> u16 {
        self.server.as_ref().map_or(0, WebSocketServerHandle::port)
    }

    /// Serves the run in a folder as it comes while it goes on. `is_replayed` says whether one that has ended is played at its own pace, again
    /// and again.
    ///
    /// # Errors
    /// If the folder holds no recording.
    pub fn follow(&mut self, run: &Path, is_replayed: bool) -> Result<()> {
        let recording = Recording::open(run)?;
        let mut sink =
            Watched { context: Arc::clone(&self.context), channels: Vec::new(), newest: Arc::clone(&self.newest) };
        let messages = RunMessages::new(&mut sink, &recording)?;
        let follower = Follower { recording, messages, sink, run: run.to_owned(), ends: Arc::clone(&self.ends) };
        let thread = std::thread::Builder::new().name("foxglove".to_owned());
        self.follower = Some(thread.spawn(move || follower.run(is_replayed)).context("cannot start a thread")?);
        Ok(())
    }
}

impl Drop for FoxgloveServer {
    /// Sends the rest of a run that has ended, and says goodbye to the clients.
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
        if let Some(thread) = self.follower.take() {
            let _ = thread.join();
        }
        let Some(server) = self.server.take() else { return };
        if server.client_count() > 0 {
            // The library drops what waits for a client when it stops.
            std::thread::sleep(GRACE);
        }
        // A client that does not read would be waited for without end.
        let (sender, stopped) = std::sync::mpsc::channel();
        let _ = std::thread::spawn(move || {
            server.stop().wait_blocking();
            let _ = sender.send(());
        });
        let _ = stopped.recv_timeout(GRACE);
    }
}

/// Sends the messages of a run.
struct Follower {
    recording: Recording,
    messages: RunMessages,
    sink: Watched,
    run: PathBuf,
    ends: Arc<AtomicBool>,
}

impl Follower {
    fn run(mut self, is_replayed: bool) {
        if let Err(reason) = self.follow(is_replayed) {
            tracing::warn!("Foxglove shows no more of {}: {reason}", self.run.display());
        }
    }

    fn is_over(&self) -> bool {
        self.ends.load(Ordering::Relaxed)
    }

    fn follow(&mut self, is_replayed: bool) -> Result<(), ExchangeError> {
        if self.recording.is_growing() || !is_replayed {
            self.follow_growing()?;
        }
        while is_replayed && !self.is_over() {
            self.play()?;
        }
        Ok(())
    }

    /// Sends what comes until the run or the server ends.
    fn follow_growing(&mut self) -> Result<(), ExchangeError> {
        let io = |reason| ExchangeError::Io { path: self.run.clone(), reason };
        let mut next = 0;
        loop {
            // Before the recording is read, so that nothing of a run that ends now is missed.
            let is_last = self.is_over() || !self.recording.is_growing();
            let has_news = self.recording.refresh()?;
            let count = self.recording.moments().len();
            if count < next {
                // Another run has begun in the folder.
                self.messages.rewind();
                next = 0;
            }
            while next < count {
                let with_images = count - next <= BEHIND;
                self.messages.moment(&self.recording, next, with_images, &mut self.sink, &io)?;
                next += 1;
            }
            if has_news && let Some(newest) = count.checked_sub(1) {
                self.messages.news(&self.recording, newest, &mut self.sink, &io)?;
            }
            if is_last {
                return Ok(());
            }
            std::thread::sleep(LOOK);
        }
    }

    /// Sends a run that has ended, at its own pace.
    fn play(&mut self) -> Result<(), ExchangeError> {
        let io = |reason| ExchangeError::Io { path: self.run.clone(), reason };
        self.messages.rewind();
        let begun = Instant::now();
        let first_s = self.recording.moments().first().map_or(0.0, |moment| moment.row.time_s);
        for number in 0..self.recording.moments().len() {
            let due_s = self.recording.moments().get(number).map_or(0.0, |moment| moment.row.time_s) - first_s;
            self.wait_until(begun + Duration::from_secs_f64(due_s.clamp(0.0, 86_400.0)));
            if self.is_over() {
                return Ok(());
            }
            self.messages.moment(&self.recording, number, true, &mut self.sink, &io)?;
        }
        self.wait_until(Instant::now() + PAUSE);
        Ok(())
    }

    fn wait_until(&self, due: Instant) {
        while !self.is_over() && Instant::now() < due {
            std::thread::sleep(LOOK.min(due.saturating_duration_since(Instant::now())));
        }
    }
}
