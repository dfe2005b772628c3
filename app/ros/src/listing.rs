//! Topics of a network with their types and rates.

use std::net::IpAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use crate::bus::{Bus, Delivery, Inlet, LiveTopic, Waiter};
use crate::error::LiveError;

/// Messages of a topic that wait to be counted; the rates of larger bursts are counted by the numbers of the messages.
const WAITING: usize = 16;

/// Topic with its rate.
#[derive(Debug, Clone, PartialEq)]
pub struct TopicRate {
    /// The topic.
    pub topic: LiveTopic,
    /// Messages per second, of those that were lost, too; `None` if fewer than two arrived.
    pub hz: Option<f64>,
    /// Bytes of the newest message.
    pub bytes: usize,
}

/// A topic whose messages are counted.
struct Counted {
    topic: LiveTopic,
    inlet: Inlet,
    count: u64,
    first: Option<Instant>,
    last: Option<Instant>,
    bytes: usize,
}

impl Counted {
    fn rate(self) -> TopicRate {
        let span_s = self.first.zip(self.last).map_or(0.0, |(first, last)| (last - first).as_secs_f64());
        let intervals = (self.count + self.inlet.lost()).saturating_sub(1);
        let hz = (span_s > 0.0 && intervals > 0).then(|| intervals as f64 / span_s);
        TopicRate { topic: self.topic, hz, bytes: self.bytes }
    }
}

/// Listens for a while, and returns all topics that have publishers, by name.
///
/// # Errors
/// [`LiveError`] if the network cannot be used.
pub fn list_topics(
    domain: u16,
    addresses: &[IpAddr],
    duration: Duration,
    stop: &AtomicBool,
) -> Result<Vec<TopicRate>, LiveError> {
    let bus = Bus::join(domain, addresses)?;
    let mut waiter = Waiter::new()?;
    let mut counted: Vec<Counted> = Vec::new();
    let begun = Instant::now();
    while begun.elapsed() < duration && !stop.load(Ordering::Relaxed) {
        for topic in bus.topics() {
            if counted.iter().any(|known| known.topic.name == topic.name) {
                continue;
            }
            let Some(type_name) = topic.types.first() else { continue };
            let delivery = Delivery { reliable: false, latched: false, depth: WAITING };
            let mut inlet = bus.listen(&topic.name, type_name, delivery)?;
            waiter.add(&mut inlet)?;
            counted.push(Counted { topic, inlet, count: 0, first: None, last: None, bytes: 0 });
        }
        waiter.wait(Duration::from_millis(20));
        for of in &mut counted {
            while let Some(message) = of.inlet.take() {
                let now = Instant::now();
                of.count += 1;
                of.first.get_or_insert(now);
                of.last = Some(now);
                of.bytes = message.len();
            }
        }
    }
    let now = bus.topics();
    let mut rates: Vec<TopicRate> = counted.into_iter().map(Counted::rate).collect();
    for rate in &mut rates {
        // Publishers that were found later.
        if let Some(topic) = now.iter().find(|topic| topic.name == rate.topic.name) {
            rate.topic = topic.clone();
        }
    }
    rates.sort_by(|a, b| a.topic.name.cmp(&b.topic.name));
    Ok(rates)
}
