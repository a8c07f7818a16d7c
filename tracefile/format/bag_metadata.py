"""The `metadata.yaml` that makes a folder with one MCAP file a rosbag2 bag."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING

from dds_trace.base.files import OWNER_AND_GROUP, create_file, replacing

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path


METADATA_NAME = "metadata.yaml"

BAG_VERSION = 9
"""Version that ROS 2 Jazzy writes: with type hashes (7), distribution (8), QoS profiles as YAML (9)."""


@dataclass(frozen=True, slots=True)
class TopicCount:
    """A topic of a bag: its name, type with hash (REP 2016), and number of messages."""

    topic: str
    schema_name: str
    type_hash: str
    messages: int


def write_metadata(
    trace: Path,
    topics: Sequence[TopicCount],
    time_range_ns: tuple[int, int],
    *,
    mode: int = OWNER_AND_GROUP,
    fsync: bool = False,
) -> None:
    """Write `metadata.yaml` next to the one MCAP file of a bag.

    It has no QoS profile: nothing was received over these topics, so a player uses its default.
    """
    start_ns, end_ns = time_range_ns
    count = sum(topic.messages for topic in topics)
    name = json.dumps(trace.name)  # a JSON string is a YAML string
    per_topic = "".join(
        _TOPIC.format(
            topic=json.dumps(topic.topic),
            schema_name=topic.schema_name,
            type_hash=topic.type_hash,
            messages=topic.messages,
        )
        for topic in topics
    )
    text = _METADATA.format(
        version=BAG_VERSION,
        name=name,
        start_ns=start_ns,
        duration_ns=end_ns - start_ns,
        count=count,
        topics=per_topic or " []\n",
    )
    with replacing(trace.with_name(METADATA_NAME), fsync=fsync) as draft, create_file(draft, mode) as file:
        file.write(text.encode())


_TOPIC = """
    - topic_metadata:
        name: {topic}
        type: {schema_name}
        serialization_format: cdr
        offered_qos_profiles: []
        type_description_hash: {type_hash}
      message_count: {messages}"""

_METADATA = """\
rosbag2_bagfile_information:
  version: {version}
  storage_identifier: mcap
  duration:
    nanoseconds: {duration_ns}
  starting_time:
    nanoseconds_since_epoch: {start_ns}
  message_count: {count}
  topics_with_message_count:{topics}
  compression_format: ""
  compression_mode: ""
  relative_file_paths:
    - {name}
  files:
    - path: {name}
      starting_time:
        nanoseconds_since_epoch: {start_ns}
      duration:
        nanoseconds: {duration_ns}
      message_count: {count}
  custom_data: ~
  ros_distro: dds-trace
"""
