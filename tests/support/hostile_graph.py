"""Announces topics and types that no honest program has; after a line on its standard input one good topic, until that ends.

hostile_graph.py cyclonedds|zenoh DOMAIN
"""

import os
import re
import select
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

from dds_trace.recorder.backends import open_node
from dds_trace.recorder.backends.node import NodeOptions
from dds_trace.recorder.choices import Discovery
from dds_trace.tracefile.format.encoding import encode_string

GOOD = "good"
STRING = "std_msgs::msg::dds_::String_"
TOPICS = (
    "/x", "a b", "1x", "x/", "%s", "\x1b[31m", "ü", "a" * 200, "a" * 10_000, "-", "<script>", "a__b", "~", "", "{x}", "..",
    "../../etc/passwd", "*", "**", "x/**", "$*", "a\nb", "\u202e",
)  # fmt: skip
TYPES = (
    "nonsense", "std_msgs::msg::dds_::Nope_", "nopkg::msg::dds_::X_", "a::b::c::d", "std_msgs::srv::dds_::String_",
    "os::msg::dds_::path_", "__main__::msg::dds_::X_", "std_msgs::msg::dds_::__init___", "antigravity::msg::dds_::X_",
    "..::msg::dds_::X_", "rclpy::msg::dds_::Node_", "std_msgs::msg::dds_::_String_", "1::msg::dds_::2_", "T" * 200,
    "hostile_package::msg::dds_::X_",
)  # fmt: skip
ANNOUNCED = (
    *((topic, STRING) for topic in TOPICS),
    *((f"type{number}", type_name) for number, type_name in enumerate(TYPES)),
    *(("one", f"many::msg::dds_::Type{number}_") for number in range(3)),
    ("not\udcfftext", STRING),
    (GOOD, "std_msgs::msg::dds_::Header_"),
)


def announce_in_dds(participant: Any) -> list[object]:
    from cyclonedds.idl import make_idl_struct
    from cyclonedds.pub import DataWriter
    from cyclonedds.topic import Topic

    kept = list[object]()
    for topic, type_name in ANNOUNCED:
        name = f"rt/{topic}".encode(errors="surrogateescape")
        stand_in = f"rt/stand_in_{len(kept):05}".ljust(len(name), "x")
        opened = Topic(participant, stand_in, make_idl_struct("T_", type_name.replace("::", "."), {"data": str}))
        overwrite(stand_in.encode(), name.ljust(len(stand_in), b"\0"))
        kept.append((opened, DataWriter(participant, opened)))
    return kept


def overwrite(text: bytes, other: bytes) -> None:
    """Replace a text in this process's own memory: Cyclone DDS takes names as Unicode only."""
    assert len(text) == len(other)
    lines = [line.split() for line in Path("/proc/self/maps").read_text().splitlines()]
    memory = os.open("/proc/self/mem", os.O_RDWR)
    for first, last in (line[0].split("-") for line in lines if line[1].startswith("rw")):
        start = int(first, 16)
        with suppress(OSError):
            content = os.pread(memory, int(last, 16) - start, start)
            for match in re.finditer(re.escape(text + b"\0"), content):
                if os.pread(memory, len(text), start + match.start()) == text:
                    os.pwrite(memory, other, start + match.start())
    os.close(memory)


def announce_on_zenoh(session: Any, domain_id: int) -> list[object]:
    kept = list[object]()
    for topic, type_name in ANNOUNCED:
        for name in (f"%{topic.replace('/', '%')}", topic):
            key = f"@ros2_lv/{domain_id}/aa/0/{len(kept)}/MP/%/%/driver/{name}/{type_name}/RIHS01_aa/::,10:,:,:,,"
            with suppress(Exception):  # what zenoh itself refuses nobody is sent
                kept.append(session.liveliness().declare_token(key))
    return kept


def main() -> None:
    backend, domain_id = sys.argv[1], int(sys.argv[2])
    options = NodeOptions(domain_id=domain_id, name="stranger", discovery=Discovery.LOCALHOST, listens=True)
    with open_node(backend, options) as node:
        is_zenoh = backend == "zenoh"
        kept = announce_on_zenoh(node._session, domain_id) if is_zenoh else announce_in_dds(node._participant)
        node.start()
        print(f"announced {len(kept)}", flush=True)
        sys.stdin.readline()
        publisher = node.create_publisher(GOOD, "std_msgs/msg/String")
        while not select.select([sys.stdin], [], [], 0.05)[0]:
            publisher.publish(encode_string("good"))
        os._exit(0)  # names were overwritten in its memory


if __name__ == "__main__":
    main()
