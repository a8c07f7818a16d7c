"""Bags of strangers that unpack to far more than they are: rosbags unpacks them within our bounds, and those of others as before."""

from __future__ import annotations

from functools import partial

import lz4.frame
import pytest
import zstandard
from rosbags.rosbag1 import Writer as Bag1Writer
from rosbags.rosbag1 import reader as ros1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Bag2Writer
from rosbags.rosbag2 import reader as ros2
from rosbags.rosbag2 import storage_mcap as mcap
from rosbags.typesys import Stores, get_typestore

from dds_trace.analyzer.recordings.messages import iter_messages
from dds_trace.base.errors import OptionError, TraceFormatError
from dds_trace.recorder.payloads import STRING
from dds_trace.recorder.payloads.bag import load_payload
from dds_trace.tracefile.mcapfile import blocks
from dds_trace.tracefile.reading import bag_bounds
from dds_trace.tracefile.reading.bag_bounds import bounded_unpacking

KB = 1000
TYPE = "std_msgs/msg/String"


def write_bag1(compression, path, sizes_bytes):
    store = get_typestore(Stores.ROS1_NOETIC)
    bag = Bag1Writer(path)
    bag.set_compression(compression)
    write(bag, store, store.serialize_ros1, sizes_bytes)


def write_bag2(mode, path, sizes_bytes):
    store = get_typestore(Stores.ROS2_JAZZY)
    bag = Bag2Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3)
    bag.set_compression(mode, CompressionFormat.ZSTD)
    write(bag, store, store.serialize_cdr, sizes_bytes)


def write(bag, store, serialize, sizes_bytes):
    with bag:
        topic = bag.add_connection("/zeros", TYPE, typestore=store)
        for number, size in enumerate(sizes_bytes):
            message = store.types[TYPE](data="0" * size)
            bag.write(topic, number, serialize(message, TYPE))


BAGS = {
    "ros1-bz2.bag": partial(write_bag1, Bag1Writer.CompressionFormat.BZ2),
    "ros1-lz4.bag": partial(write_bag1, Bag1Writer.CompressionFormat.LZ4),
    "ros2-files": partial(write_bag2, CompressionMode.FILE),
    "ros2-messages": partial(write_bag2, CompressionMode.MESSAGE),
}


@pytest.fixture(params=BAGS)
def write_bag(request, tmp_path):
    """A function that writes a bag of messages of the given sizes, and returns its path."""

    def written(*sizes_bytes):
        path = tmp_path / request.param
        BAGS[request.param](path, sizes_bytes)
        return path

    return written


def test_an_honest_packed_bag_is_read_as_before(write_bag):
    path = write_bag(10 * KB, 200 * KB, 0)
    longest, *_, shortest = sorted((message.payload_bytes for message in iter_messages(path)), reverse=True)
    assert 200 * KB <= longest < 201 * KB
    assert shortest < KB
    payload = load_payload(f"{path}#/zeros", {TYPE: STRING})
    assert len(payload.messages) == 3


def test_a_bag_that_unpacks_to_more_than_the_bound_ends_in_one_line(write_bag, monkeypatch):
    path = write_bag(*[900 * KB] * 8)
    monkeypatch.setattr(blocks, "_UNSUSPECTED_FILE_BYTES", 5000 * KB)
    with pytest.raises(TraceFormatError, match=r"unpacks to more than (200|50) times its size"):
        list(iter_messages(path))
    with pytest.raises(OptionError, match=r"unpacks to more than (200|50) times its size"):
        load_payload(f"{path}#/zeros", {TYPE: STRING})


def test_no_piece_is_unpacked_beyond_a_record(write_bag, monkeypatch):
    path = write_bag(900 * KB)
    if path.name == "ros2-files":
        pytest.skip("a file is unpacked stretch by stretch, onto the disk")
    monkeypatch.setattr(bag_bounds, "MAX_RECORD_BYTES", 800 * KB)
    with pytest.raises(TraceFormatError, match="a piece of it unpacks to more than"):
        list(iter_messages(path))


@pytest.mark.parametrize("compression", ["lz4", "zstd"])
def test_a_packed_chunk_of_mcap_is_bounded_too(compression, tmp_path):
    packed = {"lz4": lz4.frame.compress, "zstd": zstandard.compress}[compression](bytes(65 << 20))
    with bounded_unpacking(tmp_path), pytest.raises(ValueError, match="more than 64 MiB"):
        mcap.DECOMPRESSORS[compression](packed, 65 << 20)


def test_rosbags_has_its_own_decompressors_back_behind_the_block(tmp_path):
    before = dict(ros1.decompressors), dict(mcap.DECOMPRESSORS), ros2.zstd
    with bounded_unpacking(tmp_path):
        assert ros1.decompressors["bz2"] is not before[0]["bz2"]
    assert (ros1.decompressors, mcap.DECOMPRESSORS, ros2.zstd) == before
