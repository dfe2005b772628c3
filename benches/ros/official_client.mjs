// Subscribes to all channels of a server with Foxglove's own client, until standard input ends; then prints a JSON line: topics of
// which a message came, with a schema.
//
// usage: node official_client.mjs ADDRESS      needs @foxglove/ws-protocol and ws

import protocol from "@foxglove/ws-protocol";
import { WebSocket } from "ws";

const client = new protocol.FoxgloveClient({ ws: new WebSocket(process.argv[2], ["foxglove.sdk.v1"]) });
const topics = new Map();
const heard = new Set();
client.on("error", (error) => {
  throw error;
});
client.on("advertise", (channels) => {
  for (const channel of channels.filter((channel) => channel.schema)) {
    topics.set(client.subscribe(channel.id), channel.topic);
  }
});
client.on("message", (message) => heard.add(topics.get(message.subscriptionId)));
process.stdin.resume().on("end", () => {
  console.log(JSON.stringify([...heard]));
  process.exit();
});
