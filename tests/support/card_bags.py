"""Recordings of messages with a header, and their health card."""

import struct

from mcap.writer import CompressionType, Writer

from dds_trace.analyzer.recordings.topics import analyze_topics

MS, S = 1_000_000, 10**9
START_NS = 1_700_000_000 * 10**9
HEADER = ("my_msgs/msg/Blob", "ros2msg", b"std_msgs/Header header\nuint8[] data\n")


def blob(stamp_ns, size=8, frame="a"):
    head = struct.pack("<4siII", b"\0\1\0\0", *divmod(stamp_ns, 10**9), len(frame) + 1)
    return head + frame.encode() + b"\0" + bytes(size)


def write(path, topics, *, schema=HEADER, metadata=None, sequences=None):
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start("ros2")
        schema_id = writer.register_schema(*schema)
        channels = {name: writer.register_channel(name, "cdr", schema_id, metadata or {}) for name in topics}
        events = [
            (log_ns, name, stamp_ns, number)
            for name, times in topics.items()
            for number, (log_ns, stamp_ns) in enumerate(times)
        ]
        for log_ns, name, stamp_ns, number in sorted(events):
            sequence = (sequences or {}).get(name, range(len(events)))[number]
            writer.add_message(channels[name], log_ns, blob(stamp_ns), log_ns, sequence)
        writer.finish()
    return path


def timer(hz, seconds, *, without=(), since_ns=START_NS):
    times = [since_ns + round(n * 1e9 / hz) for n in range(int(hz * seconds))]
    return [(at, at - MS) for at in times if not any(first <= (at - since_ns) / 1e9 < last for first, last in without)]


def card(path):
    report = analyze_topics(path)
    (health,) = report.recordings
    return report, health, {row["topic"]: row for row in report.topics.iter_rows(named=True)}
