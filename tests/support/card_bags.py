"""Recordings of messages with a header, and their health card."""

import struct

from mcap.writer import CompressionType, Writer

from dds_trace.extensions.bags.analyze import analyze_topics

MS, S = 1_000_000, 10**9
START_NS = 1_700_000_000 * 10**9
TEXT_SCHEMA = ("std_msgs/msg/String", "ros2msg", b"string data")
HEADER = ("my_msgs/msg/Blob", "ros2msg", b"std_msgs/Header header\nuint8[] data\n")


def blob(stamp_ns, size=8, frame="a"):
    head = struct.pack("<4siII", b"\0\1\0\0", *divmod(stamp_ns, 10**9), len(frame) + 1)
    return head + frame.encode() + b"\0" + bytes(size)


def write_mcap(path, messages, *, encoding="json", schema=None, compression=CompressionType.NONE, metadata=None):
    """Write messages (topic, log time, publish time, data, perhaps a number) in their order."""
    with path.open("wb") as file:
        writer = Writer(file, compression=compression)
        writer.start("ros2" if encoding == "cdr" else "")
        schema_id = writer.register_schema(*schema) if schema else 0
        channels = {}
        for topic, log_ns, publish_ns, data, *sequence in messages:
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, encoding, schema_id, metadata or {})
            writer.add_message(channels[topic], log_ns, data, publish_ns, *sequence)
        writer.finish()
    return path


def write(path, topics, *, schema=HEADER, metadata=None, sequences=None):
    events = [
        (log_ns, name, stamp_ns, (sequences or {}).get(name, range(len(times)))[number])
        for name, times in topics.items()
        for number, (log_ns, stamp_ns) in enumerate(times)
    ]
    messages = [(name, log_ns, log_ns, blob(stamp_ns), number) for log_ns, name, stamp_ns, number in sorted(events)]
    return write_mcap(path, messages, encoding="cdr", schema=schema, metadata=metadata)


def timer(hz, seconds, *, without=(), since_ns=START_NS):
    times = [since_ns + round(n * 1e9 / hz) for n in range(int(hz * seconds))]
    return [(at, at - MS) for at in times if not any(first <= (at - since_ns) / 1e9 < last for first, last in without)]


def card(path):
    report = analyze_topics(path)
    (health,) = report.recordings
    assert health.certain or health.verdict != "whole"
    return report, health, {row["topic"]: row for row in report.topics.iter_rows(named=True)}
