//! `run --foxglove` and `view --foxglove` with a client that speaks the protocol itself.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::{BufRead as _, BufReader};
use std::net::{TcpListener, TcpStream};
use std::process::{Child, Stdio};

use mvt_bag::mcap::{McapError, McapRecord, scan};
use serde_json::{Value, json};
use tungstenite::{ClientRequestBuilder, Message, WebSocket};

use crate::workplace::{Workplace, signal};

/// Contents of messages by their topics.
type ByTopic = BTreeMap<String, BTreeSet<Vec<u8>>>;

/// A connection that has subscribed to all channels.
struct Client {
    socket: WebSocket<TcpStream>,
    /// As they were announced, by their numbers; these are those of the subscriptions, too.
    channels: BTreeMap<u64, Value>,
}

impl Client {
    fn new(address: &str) -> Self {
        let request = ClientRequestBuilder::new(address.parse().unwrap()).with_sub_protocol("foxglove.sdk.v1");
        let stream = TcpStream::connect(address.strip_prefix("ws://").unwrap()).unwrap();
        let (mut socket, answer) = tungstenite::client(request, stream).unwrap();
        assert_eq!(answer.headers()["sec-websocket-protocol"], "foxglove.sdk.v1");
        let mut said = || -> Value { serde_json::from_str(socket.read().unwrap().to_text().unwrap()).unwrap() };
        assert_eq!(said()["op"], "serverInfo");
        let announced = said();
        assert_eq!(announced["op"], "advertise", "{announced}");
        let channels = announced["channels"].as_array().unwrap().iter();
        let channels: BTreeMap<u64, Value> = channels.map(|of| (of["id"].as_u64().unwrap(), of.clone())).collect();
        let subscriptions: Vec<Value> = channels.keys().map(|id| json!({ "id": id, "channelId": id })).collect();
        let text = json!({ "op": "subscribe", "subscriptions": subscriptions }).to_string();
        socket.send(Message::text(text)).unwrap();
        Self { socket, channels }
    }

    /// The next message with its topic; `None` at the end.
    fn next(&mut self) -> Option<(String, Vec<u8>)> {
        loop {
            let Message::Binary(bytes) = self.socket.read().ok()? else { continue };
            assert_eq!(bytes[0], 1, "a message has this kind");
            let of = u64::from(u32::from_le_bytes(bytes[1..5].try_into().unwrap()));
            return Some((self.channels[&of]["topic"].as_str().unwrap().to_owned(), bytes[13..].to_vec()));
        }
    }
}

/// Starts a command, and returns it with the address that it prints.
fn start(workplace: &Workplace, arguments: &str) -> (Child, String) {
    let mut child = workplace.command(arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let line = lines.next().unwrap().unwrap();
    let address = line.split(' ').find(|word| word.starts_with("ws://")).unwrap().to_owned();
    // Nothing that is printed later may block.
    std::thread::spawn(move || lines.for_each(drop));
    (child, address)
}

fn interrupt(mut child: Child) -> Option<i32> {
    signal(&child, "INT");
    child.wait().unwrap().code()
}

/// Channels, by topic with the name of their schema, and messages of the export of a run.
fn exported(workplace: &Workplace) -> (BTreeMap<String, String>, ByTopic, Vec<u8>) {
    workplace.run("export mcap out --out run.mcap --overwrite").good();
    let file = fs::read(workplace.path("run.mcap")).unwrap();
    let (mut channels, mut topics, mut messages) = (BTreeMap::new(), BTreeMap::new(), ByTopic::new());
    scan(&workplace.path("run.mcap"), &mut |record: McapRecord<'_>| {
        match record {
            McapRecord::Channel(id, channel) => {
                topics.insert(id, channel.topic.clone());
                channels.insert(channel.topic.clone(), channel.schema.clone());
            }
            McapRecord::Message(id, _, data) => {
                messages.entry(topics[&id].clone()).or_default().insert(data.to_vec());
            }
            McapRecord::Attachment(..) => {}
        }
        Ok::<_, McapError>(true)
    })
    .unwrap();
    (channels, messages, file)
}

fn of_base64(text: &str) -> Vec<u8> {
    const DIGITS: &[u8] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let (mut bits, mut count, mut bytes) = (0_u32, 0, Vec::new());
    for digit in text.trim_end_matches('=').bytes() {
        bits = bits << 6 | DIGITS.iter().position(|other| *other == digit).unwrap() as u32;
        count += 6;
        if count >= 8 {
            count -= 8;
            bytes.push((bits >> count) as u8);
        }
    }
    bytes
}

#[test]
fn a_run_that_has_ended_is_played_with_the_channels_and_messages_of_its_export() {
    let workplace = Workplace::new();
    workplace.run("run --object cube70 --duration 0.4 --out out --quiet").good();
    let (channels, messages, file) = exported(&workplace);
    let (view, address) = start(&workplace, "view out --foxglove 0");
    let mut client = Client::new(&address);
    let announced: BTreeMap<String, String> = client
        .channels
        .values()
        .map(|of| (of["topic"].as_str().unwrap().to_owned(), of["schemaName"].as_str().unwrap().to_owned()))
        .collect();
    assert_eq!(announced, channels);
    for channel in client.channels.values() {
        assert_eq!((&channel["encoding"], &channel["schemaEncoding"]), (&json!("protobuf"), &json!("protobuf")));
        let schema = of_base64(channel["schema"].as_str().unwrap());
        assert!(!schema.is_empty() && file.windows(schema.len()).any(|part| part == schema), "{}", channel["topic"]);
    }
    let mut missing = messages.clone();
    while !missing.is_empty() {
        let (topic, message) = client.next().unwrap();
        assert!(messages[&topic].contains(&message), "{topic} is none of the export");
        let left = missing.get_mut(&topic);
        if left.is_some_and(|left| left.remove(&message) && left.is_empty()) {
            missing.remove(&topic);
        }
    }
    // Somebody who comes late sees the shape at once.
    let mut late = Client::new(&address);
    while late.next().unwrap().0 != "/estimate/mesh" {}
    assert_eq!(interrupt(view), Some(0));
    // The connection ends, too.
    while client.next().is_some() {}
}

#[test]
fn a_run_is_followed_and_no_client_holds_it_up() {
    let workplace = Workplace::new();
    let (mut run, address) = start(&workplace, "run --object cube70 --duration 0.7 --out out --foxglove 0");
    // This one never reads.
    let _stalled = Client::new(&address);
    let mut client = Client::new(&address);
    let mut seen = ByTopic::new();
    while let Some((topic, message)) = client.next() {
        seen.entry(topic).or_default().insert(message);
    }
    assert_eq!(run.wait().unwrap().code(), Some(0));
    let (_, messages, _) = exported(&workplace);
    for topic in ["/tf", "/hand/joints", "/estimate/state", "/estimate/mesh", "/camera/side/depth", "/truth/mesh"] {
        let (seen, of_export) = (&seen[topic], &messages[topic]);
        assert!(seen.is_subset(of_export), "{topic}: a message is none of the export");
        // The first frames may have gone by before the client came.
        assert!(3 * seen.len() > of_export.len(), "{topic}: {} of {}", seen.len(), of_export.len());
    }
}

/// Bytes of memory that a process holds.
fn resident(process: u32) -> u64 {
    let text = fs::read_to_string(format!("/proc/{process}/status")).unwrap();
    let line = text.lines().find(|line| line.starts_with("VmRSS:")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse::<u64>().unwrap() << 10
}

#[test]
fn memory_does_not_grow_with_a_client_that_does_not_read() {
    let workplace = Workplace::new();
    workplace.run("run --object cube70 --duration 0.8 --out out --quiet").good();
    let (_, messages, _) = exported(&workplace);
    let bytes: usize = messages.values().flatten().map(Vec::len).sum();
    assert!(bytes > 10 << 20, "a play has {bytes} bytes");
    let (view, address) = start(&workplace, "view out --foxglove 0");
    let _stalled = Client::new(&address);
    // Counts how often the run was played.
    let (mut client, ends) = (Client::new(&address), messages["/estimate/scores"].len());
    let mut play = |times: usize| {
        for _ in 0..times * ends {
            while client.next().unwrap().0 != "/estimate/scores" {}
        }
    };
    play(3);
    let before = resident(view.id());
    play(4);
    let after = resident(view.id());
    assert!(after < before + (bytes as u64), "{before} bytes became {after}; a play has {bytes}");
    assert_eq!(interrupt(view), Some(0));
}

#[test]
fn ports_and_addresses_that_cannot_be_used_are_named() {
    let workplace = Workplace::new();
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port();
    let refused = workplace.run(&format!("run --object cube70 --foxglove {port} --out out")).error();
    assert!(refused.contains(&format!("port {port}")) && refused.contains("another port"), "{refused}");
    assert!(!workplace.path("out").exists(), "nothing was begun");
    let said = workplace.run("view nothing --foxglove 0 --foxglove-address 0.0.0.0");
    assert!(said.stderr.contains("whoever reaches this address sees the run"), "{said:?}");
    assert!(said.code != Some(0) && said.stderr.contains("nothing"), "{said:?}");
    assert!(workplace.run("view --foxglove 0").error().contains("give its folder"));
    workplace.run("run --foxglove-address 0.0.0.0").usage();
}
