//! The network of ROS 2: topics by their names, messages as bytes.

use std::collections::BTreeMap;
use std::net::IpAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use rustdds::bytes::Bytes;
use rustdds::dds::WriteError;
use rustdds::no_key::{DataWriter, Decode, DefaultDecoder, DeserializerAdapter, SerializerAdapter, SimpleDataReader};
use rustdds::policy::{Durability, History, Reliability, ResourceLimits};
use rustdds::{
    DomainParticipant, DomainParticipantBuilder, GUID, Publisher, QosPolicies, QosPolicyBuilder,
    RepresentationIdentifier, Subscriber, TopicKind, mio1,
};

use crate::error::LiveError;

/// Bytes of the buffer of the system, below which images of 640 x 480 pixels are lost.
const LEAST_BUFFER: u64 = 1 << 20;
/// How long a writer waits for a slow receiver, milliseconds.
const BLOCKING_MS: i64 = 2;
/// So many times it does with a message, if the receiver took the one before.
const PATIENCE: usize = 50;

/// Topic as the network shows it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LiveTopic {
    /// Name, with a slash.
    pub name: String,
    /// Types that its publishers state, such as `sensor_msgs/msg/Image`.
    pub types: Vec<String>,
    /// Number of publishers.
    pub publishers: usize,
    /// Whether all publishers send again what was lost.
    pub is_reliable: bool,
}

/// How messages of a topic are delivered.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Delivery {
    /// Whether what was lost is sent again.
    pub reliable: bool,
    /// Whether those who come later receive the last message, as for static transforms.
    pub latched: bool,
    /// Messages that are kept until they are read.
    pub depth: usize,
}

impl Delivery {
    fn policies(self) -> QosPolicies {
        let Self { reliable, latched, depth } = self;
        let depth = i32::try_from(depth).unwrap_or(i32::MAX);
        let max_blocking_time = rustdds::Duration::from_millis(BLOCKING_MS);
        QosPolicyBuilder::new()
            .reliability(if reliable { Reliability::Reliable { max_blocking_time } } else { Reliability::BestEffort })
            .durability(if latched { Durability::TransientLocal } else { Durability::Volatile })
            .history(History::KeepLast { depth })
            // The library enforces these, not the depth of the history.
            .resource_limits(ResourceLimits {
                max_samples: depth,
                max_instances: depth,
                max_samples_per_instance: depth,
            })
            .build()
    }
}

/// Returns the name of a topic of ROS in DDS.
fn dds_topic(name: &str) -> String {
    format!("rt{name}")
}

/// Returns the name of a type of ROS in DDS.
fn dds_type(name: &str) -> String {
    match name.split_once("/msg/") {
        Some((package, message)) => format!("{package}::msg::dds_::{message}_"),
        None => name.to_owned(),
    }
}

/// Returns the name in ROS of a type in DDS; others keep their names.
fn ros_type(name: &str) -> String {
    let parts = name.split_once("::msg::dds_::").and_then(|(package, rest)| Some((package, rest.strip_suffix('_')?)));
    parts.map_or_else(|| name.to_owned(), |(package, message)| format!("{package}/msg/{message}"))
}

/// Message as bytes, with the four bytes that name its encoding.
#[derive(Debug)]
struct Message(Vec<u8>);

/// Passes bytes on.
struct AsBytes;

#[derive(Debug, Clone, Copy)]
struct Copying;

impl DeserializerAdapter<Message> for AsBytes {
    type Error = std::io::Error;
    type Decoded = Message;

    fn supported_encodings() -> &'static [RepresentationIdentifier] {
        &[RepresentationIdentifier::CDR_LE, RepresentationIdentifier::CDR_BE]
    }

    fn transform_decoded(decoded: Message) -> Message {
        decoded
    }
}

impl DefaultDecoder<Message> for AsBytes {
    type Decoder = Copying;
    const DECODER: Copying = Copying;
}

impl Decode<'_, Message> for Copying {
    type Error = std::io::Error;

    fn decode_bytes(self, body: &[u8], encoding: RepresentationIdentifier) -> Result<Message, std::io::Error> {
        let mut message = Vec::with_capacity(4 + body.len());
        message.extend([0, u8::from(encoding == RepresentationIdentifier::CDR_LE), 0, 0]);
        message.extend(body);
        Ok(Message(message))
    }
}

impl SerializerAdapter<Message> for AsBytes {
    type Error = std::io::Error;

    fn output_encoding() -> RepresentationIdentifier {
        RepresentationIdentifier::CDR_LE
    }

    fn to_bytes(Message(message): &Message) -> Result<Bytes, std::io::Error> {
        Ok(Bytes::copy_from_slice(message.get(4..).unwrap_or_default()))
    }
}

/// Membership in a domain of the network.
pub struct Bus {
    participant: DomainParticipant,
    subscriber: Subscriber,
    publisher: Publisher,
}

impl Bus {
    /// Joins a domain over the network cards of these addresses; without any, over all.
    ///
    /// # Errors
    /// [`LiveError`] if the network cannot be used.
    pub fn join(domain: u16, addresses: &[IpAddr]) -> Result<Self, LiveError> {
        let mut builder = DomainParticipantBuilder::new(domain);
        if !addresses.is_empty() {
            builder = builder.with_only_networks(addresses.iter().copied());
        }
        let participant = builder.build().map_err(LiveError::network(format!("cannot join domain {domain}")))?;
        let policies = QosPolicyBuilder::new().build();
        let subscriber = participant.create_subscriber(&policies).map_err(LiveError::network("cannot subscribe"))?;
        let publisher = participant.create_publisher(&policies).map_err(LiveError::network("cannot publish"))?;
        Ok(Self { participant, subscriber, publisher })
    }

    /// Returns a sentence if the buffer of the system is too small for images.
    pub fn buffer_note() -> Option<String> {
        let text = std::fs::read_to_string("/proc/sys/net/core/rmem_max").ok()?;
        let bytes: u64 = text.trim().parse().ok()?;
        (bytes < LEAST_BUFFER).then(|| {
            format!(
                "the system receives at most {bytes} bytes at once, so that images are lost: `sudo sysctl -w net.core.rmem_max=8388608`, or reliable = true"
            )
        })
    }

    /// Returns the topics that have publishers now, by name. Publishers are found within about a second.
    pub fn topics(&self) -> Vec<LiveTopic> {
        let mut topics = BTreeMap::<String, LiveTopic>::new();
        for writer in self.participant.discovered_writers() {
            let of = writer.publication_topic_data;
            let Some(name) = of.topic_name.strip_prefix("rt").filter(|name| name.starts_with('/')) else { continue };
            let topic = topics.entry(name.to_owned()).or_insert_with(|| LiveTopic {
                name: name.to_owned(),
                types: Vec::new(),
                publishers: 0,
                is_reliable: true,
            });
            topic.publishers += 1;
            // Publishers need not state what is the default of theirs.
            topic.is_reliable &= of.reliability != Some(Reliability::BestEffort);
            let type_name = ros_type(&of.type_name);
            if !topic.types.contains(&type_name) {
                topic.types.push(type_name);
            }
        }
        topics.into_values().collect()
    }

    /// Returns how many subscribers a topic has now. They are found within about a second.
    pub fn listeners(&self, name: &str) -> usize {
        let wanted = dds_topic(name);
        let readers = self.participant.discovered_readers();
        readers.iter().filter(|reader| reader.subscription_topic_data.topic_name == wanted).count()
    }

    fn topic(&self, name: &str, type_name: &str, delivery: Delivery) -> Result<rustdds::Topic, LiveError> {
        self.participant
            .create_topic(dds_topic(name), dds_type(type_name), &delivery.policies(), TopicKind::NoKey)
            .map_err(LiveError::network(format!("cannot open {name}")))
    }

    /// Subscribes to a topic of a type.
    ///
    /// # Errors
    /// [`LiveError`] if the network cannot be used.
    pub fn listen(&self, name: &str, type_name: &str, delivery: Delivery) -> Result<Inlet, LiveError> {
        let topic = self.topic(name, type_name, delivery)?;
        let reader = self.subscriber.create_simple_datareader_no_key(&topic, Some(delivery.policies()));
        let reader = reader.map_err(LiveError::network(format!("cannot subscribe to {name}")))?;
        Ok(Inlet { reader, newest: BTreeMap::new(), last: None, is_mixed: false, lost: 0 })
    }

    /// Prepares to publish on a topic of a type.
    ///
    /// # Errors
    /// [`LiveError`] if the network cannot be used.
    pub fn speak(&self, name: &str, type_name: &str, delivery: Delivery) -> Result<Outlet, LiveError> {
        let topic = self.topic(name, type_name, delivery)?;
        let writer = self.publisher.create_datawriter_no_key(&topic, Some(delivery.policies()));
        let writer = writer.map_err(LiveError::network(format!("cannot publish {name}")))?;
        Ok(Outlet { writer, is_stuck: AtomicBool::new(false) })
    }
}

/// A subscription.
pub struct Inlet {
    reader: SimpleDataReader<Message, AsBytes>,
    /// The newest number of each publisher's messages.
    newest: BTreeMap<GUID, i64>,
    /// Publisher of the newest message.
    last: Option<GUID>,
    is_mixed: bool,
    lost: u64,
}

impl Inlet {
    /// Returns the next message that arrived, if there is one.
    pub fn take(&mut self) -> Option<Vec<u8>> {
        // Otherwise later arrivals are not announced.
        self.reader.drain_read_notifications();
        loop {
            match self.reader.try_take_one() {
                Ok(Some(change)) => {
                    let number = i64::from(change.sequence_number);
                    let newest = self.newest.insert(change.writer_guid, number);
                    let last = self.last.replace(change.writer_guid);
                    self.is_mixed |= newest.is_some() && last != Some(change.writer_guid);
                    self.lost += newest.map_or(0, |newest| (number - newest - 1).max(0) as u64);
                    return Some(change.into_value().0);
                }
                Ok(None) => return None,
                // A message of an unknown encoding; the next one may be readable.
                Err(rustdds::dds::ReadError::Deserialization { .. }) => self.lost += 1,
                Err(_) => return None,
            }
        }
    }

    /// Returns how many messages publishers numbered that never arrived.
    pub fn lost(&self) -> u64 {
        self.lost
    }

    /// Returns whether messages of several publishers have come in turn, and not those of one after those of another.
    pub fn is_mixed(&self) -> bool {
        self.is_mixed
    }

    /// Returns how many publishers have delivered.
    pub fn publishers(&self) -> usize {
        self.newest.len()
    }
}

/// Waits for messages of several subscriptions.
pub struct Waiter {
    poll: mio1::Poll,
    events: mio1::Events,
    count: usize,
}

impl Waiter {
    /// Starts without subscriptions.
    ///
    /// # Errors
    /// [`LiveError`] if the system has no room.
    pub fn new() -> Result<Self, LiveError> {
        let poll = mio1::Poll::new().map_err(LiveError::network("cannot wait for messages"))?;
        Ok(Self { poll, events: mio1::Events::with_capacity(64), count: 0 })
    }

    /// Adds a subscription.
    ///
    /// # Errors
    /// [`LiveError`] if the system has no room.
    pub fn add(&mut self, inlet: &mut Inlet) -> Result<(), LiveError> {
        let token = mio1::Token(self.count);
        self.count += 1;
        let registered = self.poll.registry().register(&mut inlet.reader, token, mio1::Interest::READABLE);
        registered.map_err(LiveError::network("cannot wait for messages"))
    }

    /// Waits until a message arrives, or the time is over.
    pub fn wait(&mut self, most: Duration) {
        // An interrupted wait is over early.
        let _ = self.poll.poll(&mut self.events, Some(most));
    }
}

/// A publication.
pub struct Outlet {
    writer: DataWriter<Message, AsBytes>,
    /// Whether a receiver did not take the last message in time.
    is_stuck: AtomicBool,
}

impl Outlet {
    /// Publishes a message; returns whether the library took it. A slow receiver is waited for, but one that was killed only once.
    pub fn send(&self, message: Vec<u8>) -> bool {
        let tries = if self.is_stuck.load(Ordering::Relaxed) { 1 } else { PATIENCE };
        let mut message = Message(message);
        for _ in 0..tries {
            match self.writer.write(message, None) {
                Ok(()) => {
                    self.is_stuck.store(false, Ordering::Relaxed);
                    return true;
                }
                Err(WriteError::WouldBlock { data }) => message = data,
                Err(_) => return false,
            }
        }
        self.is_stuck.store(true, Ordering::Relaxed);
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_types_lead_there_and_back() {
        assert_eq!(dds_type("sensor_msgs/msg/Image"), "sensor_msgs::msg::dds_::Image_");
        assert_eq!(ros_type("sensor_msgs::msg::dds_::Image_"), "sensor_msgs/msg/Image");
        assert_eq!((dds_type("x"), ros_type("x")), ("x".to_owned(), "x".to_owned()));
    }
}
