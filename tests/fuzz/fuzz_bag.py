"""Fuzz target `bag`: payloads and topics of any recording are read, or refused with one line that names it."""

import shutil
from collections.abc import Callable
from pathlib import Path

from bags import ROS1, imu, text, write_bag1, write_bag2
from fuzz_shapes import changed, must_name, shaped, shaped_seeds
from rosbags.rosbag2 import StoragePlugin

from dds_trace.base.errors import TraceError
from dds_trace.extensions.bags.analyze import analyze_topics
from dds_trace.extensions.bags.payload import load_payload

TOPIC = "/imu"


class Target:
    """ROS 1 bags, and the MCAP and SQLite files of rosbag2 folders, with and without their metadata."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder / "bag"
        messages = {TOPIC: [imu(yaw) for yaw in (0.1, 0.2)], "/chatter": [text("hello")]}
        mcap = write_bag2(folder / "mcap", messages)
        sqlite = write_bag2(folder / "sqlite", messages, StoragePlugin.SQLITE3)
        ros1 = write_bag1(
            folder / "one.bag", {TOPIC: [imu(yaw, ROS1) for yaw in (0.1, 0.2)], "/chatter": [text("hello", ROS1)]}
        )
        self._good = {
            "bag.mcap": (mcap / "mcap.mcap").read_bytes(),
            "bag.db3": (sqlite / "sqlite.db3").read_bytes(),
            "bag.bag": ros1.read_bytes(),
        }
        self._metadata = {
            "bag.mcap": (mcap / "metadata.yaml").read_bytes().replace(b"mcap.mcap", b"bag.mcap"),
            "bag.db3": (sqlite / "metadata.yaml").read_bytes().replace(b"sqlite.db3", b"bag.db3"),
        }
        self._shapes = (
            self._mcap,
            self._changed_mcap,
            self._changed_database,
            self._ros1,
            self._changed_ros1,
            self._metadata_text,
        )

    def try_input(self, data: bytes) -> None:
        """Read the recording that the bytes stand for as a payload and as topics."""
        shutil.rmtree(self._folder, ignore_errors=True)
        self._folder.mkdir()
        path = shaped(self._shapes, data)
        self._read(lambda: load_payload(f"{path}#{TOPIC}", {}))
        self._read(lambda: analyze_topics(path))

    def _read(self, read: Callable[[], object]) -> None:
        try:
            read()
        except TraceError as err:
            must_name(self._folder, err)

    def seeds(self) -> dict[str, bytes]:
        return shaped_seeds(
            self._shapes,
            {
                self._mcap: self._good["bag.mcap"],
                self._changed_mcap: bytes(3),
                self._changed_database: bytes(3),
                self._ros1: self._good["bag.bag"],
                self._changed_ros1: bytes(3),
                self._metadata_text: self._metadata["bag.mcap"],
            },
        )

    def _mcap(self, data: bytes) -> Path:
        return self._file("bag.mcap", data)

    def _changed_mcap(self, data: bytes) -> Path:
        return self._bag("bag.mcap", changed(self._good["bag.mcap"], data))

    def _changed_database(self, data: bytes) -> Path:
        return self._bag("bag.db3", changed(self._good["bag.db3"], data))

    def _ros1(self, data: bytes) -> Path:
        return self._file("bag.bag", data)

    def _changed_ros1(self, data: bytes) -> Path:
        return self._file("bag.bag", changed(self._good["bag.bag"], data))

    def _metadata_text(self, data: bytes) -> Path:
        self._metadata_of_bag(data)
        self._file("bag.mcap", self._good["bag.mcap"])
        return self._folder

    def _file(self, name: str, data: bytes) -> Path:
        (self._folder / name).write_bytes(data)
        return self._folder / name

    def _bag(self, name: str, data: bytes) -> Path:
        self._metadata_of_bag(self._metadata[name])
        self._file(name, data)
        return self._folder

    def _metadata_of_bag(self, data: bytes) -> None:
        (self._folder / "metadata.yaml").write_bytes(data)
