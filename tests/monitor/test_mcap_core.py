# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Others read our bags: the JavaScript library that Foxglove uses, and our report a torn one."""

import hashlib
import json
import subprocess
from collections import defaultdict

import pytest
from mcap.reader import make_reader

pytest.importorskip("rclpy")

from support import npm
from support.recorded_flight import recorded

from gtmr_monitor.bag.reader import bag_files, read_messages

pytestmark = pytest.mark.slow
"""Flies in a real ROS graph."""

PACKAGES = ["@mcap/core@2.2.2", "fzstd@0.1.1"]
READ = """
import { McapIndexedReader, McapStreamReader } from "@mcap/core";
import { createHash } from "node:crypto";
import { open, readFile } from "node:fs/promises";
import { decompress } from "fzstd";

const [path] = process.argv.slice(2);
const decompressHandlers = {
  zstd: (data, size) => decompress(data, new Uint8Array(Number(size))),
};

function summary() {
  const topics = {};
  return {
    topics,
    add(topic, data) {
      topics[topic] ??= { count: 0, hash: createHash("sha256") };
      topics[topic].count += 1;
      topics[topic].hash.update(data);
    },
    done() {
      for (const each of Object.values(topics)) each.hash = each.hash.digest("hex");
      return topics;
    },
  };
}

async function indexed() {
  const file = await open(path);
  const readable = {
    size: async () => BigInt((await file.stat()).size),
    read: async (offset, length) => {
      const buffer = new Uint8Array(Number(length));
      await file.read(buffer, 0, Number(length), Number(offset));
      return buffer;
    },
  };
  const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });
  const read = summary();
  for await (const message of reader.readMessages()) {
    read.add(reader.channelsById.get(message.channelId).topic, message.data);
  }
  await file.close();
  return {
    profile: reader.header.profile,
    messageCount: Number(reader.statistics.messageCount),
    encodings: [...reader.channelsById.values()].map((c) => c.messageEncoding),
    schemas: [...reader.schemasById.values()].map((s) => s.encoding),
    topics: read.done(),
  };
}

async function streamed() {
  const reader = new McapStreamReader({ decompressHandlers });
  reader.append(await readFile(path));
  const read = summary();
  const channels = new Map();
  for (let record; (record = reader.nextRecord()); ) {
    if (record.type === "Channel") channels.set(record.id, record.topic);
    if (record.type === "Message") read.add(channels.get(record.channelId), record.data);
  }
  return { topics: read.done() };
}

console.log(JSON.stringify({ indexed: await indexed(), streamed: await streamed() }));
"""


@pytest.fixture(scope="module")
def script(tmp_path_factory):
    """The reading script, with its packages beside it."""
    folder = npm.installed(tmp_path_factory.mktemp("node"), *PACKAGES)
    (folder / "read.mjs").write_text(READ)
    return ["node", str(folder / "read.mjs")]


def test_mcap_core_reads_every_message_by_index_and_as_a_stream(script):
    bag = recorded("lockstep")
    (path,) = bag_files(bag)
    run = subprocess.run([*script, path], capture_output=True, text=True, timeout=60, check=False)
    assert run.returncode == 0, run.stderr
    read = json.loads(run.stdout)

    expected = defaultdict(list)
    for message in read_messages(bag):
        expected[message.topic].append(message.data)
    ours = {
        topic: {"count": len(data), "hash": hashlib.sha256(b"".join(data)).hexdigest()}
        for topic, data in expected.items()
    }
    assert {"/odom", "/rotor_command", "/tightening", "/parameter_events"} <= set(ours)
    assert read["streamed"]["topics"] == ours
    assert {t: e["count"] for t, e in read["indexed"]["topics"].items()} == {
        t: e["count"] for t, e in ours.items()
    }
    # By the index messages come in order of time, which the topics of one writer already are in.
    assert read["indexed"]["topics"]["/odom"] == ours["/odom"]
    assert read["indexed"]["profile"] == "ros2"
    assert read["indexed"]["messageCount"] == sum(each["count"] for each in ours.values())
    assert set(read["indexed"]["encodings"]) == {"cdr"}
    assert set(read["indexed"]["schemas"]) == {"ros2msg"}


def test_a_report_of_a_torn_copy_tells_all_up_to_its_last_whole_chunk(tmp_path, gtmr):
    (path,) = bag_files(recorded("lockstep"))
    whole = path.read_bytes()
    with path.open("rb") as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    # In the middle of the last chunk that holds a message of the flight.
    last = sorted(chunks, key=lambda chunk: chunk.chunk_start_offset)[-2]
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(whole[: last.chunk_start_offset + last.chunk_length // 2])
    kept = [m for m in read_messages(path) if m.log_time_ns < last.message_start_time]
    states = [m.decode().header.stamp for m in kept if m.topic == "/ground_truth"]
    samples = len({(stamp.sec, stamp.nanosec) for stamp in states})

    run = gtmr("report", torn, "--out", tmp_path / "torn.html")
    assert run.returncode == 0, run.stderr
    assert f"{torn}: the bag has no end; read up to its last whole chunk" in run.stderr
    text = (tmp_path / "torn.html").read_text(encoding="utf-8")
    assert "the bag has no end" in text
    assert samples > 0
    assert f'<th scope="row">samples</th><td>{samples}</td>' in text
