"""`ddsrouter`: eProsima's DDS Router, successor of its Integration Service for DDS; one program, or a half on each device."""

from __future__ import annotations

import ipaddress
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from dds_trace.base.errors import OptionError

from ..backends.qos import asked_durations
from ..choices import Discovery
from .base import Halves
from .options import Half, split_address
from .process.programs import reported_version
from .texts import yaml_text

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from dds_trace.tracefile.format.descriptions import Qos

    from .options import BridgeOptions

PROGRAM = "ddsrouter"
CONFIGURATION_VERSION = "v5.0"
"""Configuration format of DDS Router 3; version 2, which read v4.0, has reached its end of life."""


@dataclass(frozen=True, slots=True)
class DdsRouter:
    """eProsima's DDS Router; see `Bridge` for the names."""

    name: str = PROGRAM
    install: str = "build it with colcon or take the docker image (https://eprosima-dds-router.readthedocs.io), and put it on the PATH"
    halves: Halves = Halves.OPTIONAL
    suffix: str = ".yaml"
    up_pattern: str | None = "DDS Router running"
    needs_ros_nodes: bool = False

    def configuration(self, options: BridgeOptions) -> str:
        """Return YAML: the allowed topics with their quality of service, a participant for each domain, and the link."""
        sides = options.sides()
        names = [name for topic in options.topics for name in (topic.name, topic.reply_name)]
        topics = [
            {"name": f"rt/{name}", "type": options.topic_of(name).dds_type_name, "qos": _qos(options.qos)}
            for name in names
        ]
        participants = [_local_participant(side.domain_id, options) for side in sides]
        if options.half is not Half.BOTH:
            participants.append(_wan_participant(options))
        return yaml_text(
            {
                "version": CONFIGURATION_VERSION,
                "allowlist": [{"name": topic["name"], "type": topic["type"]} for topic in topics],
                "topics": topics,
                "participants": participants,
            },
        )

    def find(self) -> Path | None:
        """Return the program on the PATH."""
        path = shutil.which(PROGRAM)
        return Path(path) if path else None

    def version(self, program: Path) -> str:
        """Return the line of `--version`."""
        return reported_version(program, "--version")

    def command(self, program: Path, configuration: Path, options: BridgeOptions) -> Sequence[str]:
        """Return the program with its file."""
        del options
        return (str(program), "--config-path", str(configuration))

    def environment(self, program: Path, options: BridgeOptions) -> Mapping[str, str]:
        """Return no variables: it is no ROS 2 program."""
        del program, options
        return {}


BRIDGE = DdsRouter()


def _qos(qos: Qos) -> dict[str, object]:
    for policy in asked_durations(qos):
        raise OptionError(
            f"--{policy}: the topics of {PROGRAM} know none, so it would not match; leave it out or take another bridge"
        )
    return {
        "reliability": qos.reliability == "reliable",
        "durability": qos.durability == "transient_local",
        "history-depth": qos.depth,
    }


def _local_participant(domain_id: int, options: BridgeOptions) -> dict[str, object]:
    local: dict[str, object] = {"name": f"domain_{domain_id}", "kind": "local", "domain": domain_id}
    if options.discovery is Discovery.LOCALHOST:
        local["whitelist-interfaces"] = ["127.0.0.1"]
    return local


def _wan_participant(options: BridgeOptions) -> dict[str, object]:
    wan: dict[str, object] = {"name": "link", "kind": "wan"}
    if options.listen:
        wan["listening-addresses"] = [_address(options.listen)]
    if options.peers:
        wan["connection-addresses"] = [_address(peer) for peer in options.peers]
    return wan


def _address(text: str) -> dict[str, object]:
    host, port = split_address(text)
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return {"domain": host, "port": port, "transport": "tcp"}
    return {"ip": host, "port": port, "transport": "tcp"}
