// Reads a log with the TypeScript reader of MCAP and prints, as JSON, what it decoded.
import { readFileSync } from "node:fs";
import { McapIndexedReader } from "@mcap/core";
import { loadDecompressHandlers } from "@mcap/support";
import { parse } from "@foxglove/rosmsg";
import { MessageReader } from "@foxglove/rosmsg2-serialization";

const bytes = readFileSync(process.argv[2]);
const readable = {
  size: async () => BigInt(bytes.length),
  read: async (offset, length) => new Uint8Array(bytes.buffer, bytes.byteOffset + Number(offset), Number(length)),
};
const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers: await loadDecompressHandlers() });
const decoders = new Map();
const counts = {};
const last = {};
let positions = 0;
for await (const message of reader.readMessages()) {
  const channel = reader.channelsById.get(message.channelId);
  const schema = reader.schemasById.get(channel.schemaId);
  if (!decoders.has(schema.id)) {
    const definition = parse(new TextDecoder().decode(schema.data), { ros2: true });
    decoders.set(schema.id, new MessageReader(definition));
  }
  const decoded = decoders.get(schema.id).readMessage(message.data);
  counts[channel.topic] = (counts[channel.topic] ?? 0) + 1;
  last[channel.topic] = decoded;
  if (channel.topic === "/joint_states") for (const angle of decoded.position) positions += angle;
}
const attachments = {};
for await (const attachment of reader.readAttachments()) attachments[attachment.name] = attachment.data.length;
const metadata = [];
for await (const record of reader.readMetadata()) metadata.push(record.name);
console.log(
  JSON.stringify({
    profile: reader.header.profile,
    counts,
    positions,
    reason: last["/controller"].reason,
    energy: last["/power"].energy_pos_j,
    names: last["/joint_states"].name,
    depth: last["/depth/image"] && [last["/depth/image"].height, last["/depth/image"].width],
    attachments,
    metadata,
  }),
);
