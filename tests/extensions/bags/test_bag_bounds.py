import re
from contextlib import suppress

import pytest
from bags import ROS1, ROS2, text, write_bag1, write_bag2
from rosbags.rosbag1 import Writer
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from dds_trace.base.errors import OptionError, TraceFormatError
from dds_trace.extensions.bags import bag1, read
from dds_trace.extensions.bags.payload import load_payload
from dds_trace.extensions.bags.read import read_messages
from dds_trace.recorder.payloads import STRING
from dds_trace.tracefile.mcapfile import blocks, chunks
from dds_trace.tracefile.reading.source import Condition

KB = 1000
TYPE = "std_msgs/msg/String"


BAGS = {
    "ros1-bz2.bag": (write_bag1, ROS1, {"compression": Writer.CompressionFormat.BZ2}),
    "ros1-lz4.bag": (write_bag1, ROS1, {"compression": Writer.CompressionFormat.LZ4}),
    "ros2-files": (write_bag2, ROS2, {"plugin": StoragePlugin.SQLITE3, "mode": CompressionMode.FILE}),
    "ros2-messages": (write_bag2, ROS2, {"plugin": StoragePlugin.SQLITE3, "mode": CompressionMode.MESSAGE}),
}


@pytest.fixture(params=BAGS)
def write_bag(request, tmp_path):
    write, store, packed = BAGS[request.param]

    def written(*sizes_bytes):
        return write(tmp_path / request.param, {"/zeros": [text("0" * size, store) for size in sizes_bytes]}, **packed)

    return written


def test_an_honest_packed_bag_is_read_as_before(write_bag):
    path = write_bag(10 * KB, 200 * KB, 0)
    longest, *_, shortest = sorted((len(message.data) for message in read_messages(path, Condition())), reverse=True)
    assert 200 * KB <= longest < 201 * KB
    assert shortest < KB
    payload = load_payload(f"{path}#/zeros", {TYPE: STRING})
    assert len(payload.messages) == 3


def test_a_bag_that_unpacks_to_more_than_the_bound_ends_in_one_line(write_bag, monkeypatch):
    path = write_bag(*[900 * KB] * 8)
    monkeypatch.setattr(blocks, "_UNSUSPECTED_FILE_BYTES", 5000 * KB)
    with pytest.raises(TraceFormatError, match=r"unpacks to more than (200|50) times its size"):
        list(read_messages(path, Condition()))
    with pytest.raises(OptionError, match=r"unpacks to more than (200|50) times its size"):
        load_payload(f"{path}#/zeros", {TYPE: STRING})


def test_no_piece_is_unpacked_beyond_a_record(write_bag, monkeypatch):
    path = write_bag(900 * KB)
    if path.name == "ros2-files":
        pytest.skip("a file is unpacked stretch by stretch, onto the disk")
    for module in (bag1, chunks, read):
        monkeypatch.setattr(module, "MAX_RECORD_BYTES", 800 * KB)
    condition = Condition()
    with suppress(TraceFormatError):
        assert not list(read_messages(path, condition))
    assert re.search(r"unpacks to more than|it claims", f"{condition.damages}") or path.name == "ros2-messages"
