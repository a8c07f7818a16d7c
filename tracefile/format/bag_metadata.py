"""The `metadata.yaml` that makes a folder with one MCAP file a rosbag2 bag."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from dds_trace.base.files import OWNER_AND_GROUP, create_file, replacing

METADATA_NAME = "metadata.yaml"

BAG_VERSION = 9
"""Version that ROS 2 Jazzy writes: with type hashes (7), distribution (8), QoS profiles as YAML (9)."""

MOST_TOPICS = 10_000
"""A robot has some hundreds; each costs about a millisecond in an analysis."""


@dataclass(frozen=True, slots=True)
class RecordedTopic:
    """A topic as the recording declares it, `type_hash` of REP 2016; a text is empty where there is none."""

    name: str
    message_type: str
    encoding: str
    definition: str = ""
    definition_encoding: str = ""
    qos: str = ""
    publisher: str = ""
    type_hash: str = ""
    descriptors: bytes = b""
    """A protobuf `FileDescriptorSet`, where that is the definition."""


@dataclass(frozen=True, slots=True)
class BagFile:
    name: str
    start_ns: int
    duration_ns: int
    messages: int


def write_bag_metadata(
    folder: Path,
    storage: str,
    files: Sequence[BagFile],
    topics: Sequence[tuple[RecordedTopic, int]],
    *,
    mode: int = OWNER_AND_GROUP,
    fsync: bool = True,
    custom: Mapping[str, str] | None = None,
) -> None:
    """Describe several files; QoS stays as it was recorded where it is plain YAML."""
    counts = Counter[str]()
    for topic, messages in topics:
        counts[topic.name] += messages
    by_name = {topic.name: topic for topic, _ in reversed(topics)}
    # Before version 9 the profiles are a text with numbers, since then a list with names.
    qos = [topic.qos for topic in by_name.values()]
    version = BAG_VERSION if any(map(_has_names, qos)) or not any(qos) else 8
    start_ns = min((file.start_ns for file in files if file.messages), default=0)
    end_ns = max((file.start_ns + file.duration_ns for file in files if file.messages), default=0)
    per_topic = "".join(
        _TOPIC.format(
            topic=json.dumps(name),
            schema_name=json.dumps(by_name[name].message_type),
            encoding=json.dumps(by_name[name].encoding),
            qos=_qos(by_name[name].qos, version),
            type_hash=json.dumps(by_name[name].type_hash),
            messages=count,
        )
        for name, count in counts.items()
    )
    text = _METADATA.format(
        version=version,
        storage=storage,
        names="".join(f"\n    - {json.dumps(file.name)}" for file in files),  # a JSON string is a YAML string
        files="".join(
            _FILE.format(
                name=json.dumps(file.name), start=file.start_ns, duration=file.duration_ns, count=file.messages
            )
            for file in files
        ),
        start_ns=start_ns,
        duration_ns=end_ns - start_ns,
        count=counts.total(),
        topics=per_topic or " []\n",
        custom="".join(f"\n    {key}: {json.dumps(value)}" for key, value in (custom or {}).items()) or " ~",
    )
    with replacing(folder / METADATA_NAME, fsync=fsync) as draft, create_file(draft, mode) as file:
        file.write(text.encode())


_TOPIC = """
    - topic_metadata:
        name: {topic}
        type: {schema_name}
        serialization_format: {encoding}
        offered_qos_profiles: {qos}
        type_description_hash: {type_hash}
      message_count: {messages}"""

_FILE = """
    - path: {name}
      starting_time:
        nanoseconds_since_epoch: {start}
      duration:
        nanoseconds: {duration}
      message_count: {count}"""

_QOS_LINE = re.compile(r" *(- )?[a-z_]+:( [\w.-]+)?")


def _has_names(qos: str) -> bool:
    return re.search(r"^[- ]*history: [a-z]", qos, re.MULTILINE) is not None


def _qos(qos: str, version: int) -> str:
    """Return the profiles for a version; none where a line could be more than a key and a plain value."""
    lines = qos.splitlines()
    if not lines or not all(map(_QOS_LINE.fullmatch, lines)) or _has_names(qos) != (version > 8):
        return "[]" if version > 8 else '""'
    return "".join(f"\n          {line}" for line in lines) if version > 8 else json.dumps(qos)


_METADATA = """\
rosbag2_bagfile_information:
  version: {version}
  storage_identifier: {storage}
  duration:
    nanoseconds: {duration_ns}
  starting_time:
    nanoseconds_since_epoch: {start_ns}
  message_count: {count}
  topics_with_message_count:{topics}
  compression_format: ""
  compression_mode: ""
  relative_file_paths:{names}
  files:{files}
  custom_data:{custom}
  ros_distro: dds-trace
"""
