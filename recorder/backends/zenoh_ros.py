"""Keys, graph entries and attachments of ROS 2 nodes on zenoh (`rmw_zenoh_cpp`)."""

from __future__ import annotations

import struct
from typing import Any, NamedTuple

from dds_trace.base.units import SECOND_NS

from .dds_types import dds_name, ros_name
from .node import Publication

GRAPH_KEY = "@ros2_lv/{domain_id}/**"
_TOKEN_PARTS = 13
_PUBLISHER_KIND = "MP"
_NUMBER = struct.Struct("<q")
_GID_BYTES = 16
_SEQUENCE_NAME, _TIME_NAME = b"sequence_number", b"source_timestamp"


class Attachment(NamedTuple):
    """What a publisher sends with each message; `gid` in hex."""

    sequence: int = 0
    source_ns: int = 0
    gid: str | None = None


def parse_token(key: str) -> Publication | None:
    parts = key.split("/")
    if len(parts) != _TOKEN_PARTS or parts[5] != _PUBLISHER_KIND:
        return None
    namespace, node, topic, type_name = (part.replace("%", "/") for part in parts[7:11])
    return Publication(topic, ros_name(type_name), None, f"{namespace.rstrip('/')}/{node}")


def data_key(domain_id: int, topic: str, type_name: str) -> str:
    return f"{domain_id}/{topic.strip('/')}/{dds_name(type_name)}/*"


def parse_attachment(data: bytes) -> Attachment:
    if len(data) < 2 * _NUMBER.size + _GID_BYTES:
        return Attachment()
    sequence_at, time_at = 0, _NUMBER.size
    if _SEQUENCE_NAME in data and _TIME_NAME in data:
        sequence_at = data.index(_SEQUENCE_NAME) + len(_SEQUENCE_NAME)
        time_at = data.index(_TIME_NAME) + len(_TIME_NAME)
    if max(sequence_at, time_at) + _NUMBER.size > len(data):
        return Attachment()
    (sequence,), (source_ns,) = _NUMBER.unpack_from(data, sequence_at), _NUMBER.unpack_from(data, time_at)
    return Attachment(max(sequence, 0), max(source_ns, 0), data[-_GID_BYTES:].hex())


def origin_of(sample: Any, *, is_ros: bool) -> Attachment:
    if is_ros and sample.attachment is not None:
        return parse_attachment(sample.attachment.to_bytes())
    source_ns = 0
    if sample.timestamp is not None:
        ntp64 = sample.timestamp.get_time_as_ntp64()
        source_ns = (ntp64 >> 32) * SECOND_NS + ((ntp64 & 0xFFFFFFFF) * SECOND_NS >> 32)
    source = sample.source_info
    return Attachment(0 if source is None else source.source_sn + 1, source_ns)
