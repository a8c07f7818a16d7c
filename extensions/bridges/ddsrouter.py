"""`ddsrouter`: eProsima's DDS Router, successor of its Integration Service; one program, or a half on each device."""

from __future__ import annotations

import ipaddress

from dds_trace.base.errors import OptionError
from dds_trace.recorder.backends.dds_types import dds_name
from dds_trace.recorder.backends.qos import requested_durations
from dds_trace.recorder.backends.ros2.fastdds_profile import tuned_participants
from dds_trace.recorder.choices import Discovery, Durability, Reliability, Transport
from dds_trace.tracefile.format.descriptions import Qos

from .base import Bridge, BridgeOptions, Half, Halves, split_address
from .programs import program_on_path, reported_version
from .texts import yaml_text

PROGRAM = "ddsrouter"
CONFIGURATION_VERSION = "v5.0"
"""Format of DDS Router 3; version 2, which read v4.0, has reached its end of life."""


def _configuration(options: BridgeOptions) -> str:
    names = [{"name": f"rt/{name}", "type": dds_name(options.type_of(name))} for name in options.topic_names]
    qos = _qos(options.qos)
    participants = [_local_participant(side.domain_id, options) for side in options.sides()]
    if options.half is not Half.BOTH:
        wan: dict[str, object] = {"name": "link", "kind": "wan"}
        if options.listen:
            wan["listening-addresses"] = [_address(options.listen)]
        if options.peers:
            wan["connection-addresses"] = [_address(peer) for peer in options.peers]
        participants.append(wan)
    profiles = {}
    if options.tuned:
        names_of_domains = {_participant_name(side.domain_id): side.domain_id for side in options.sides()}
        is_local = options.discovery is Discovery.LOCALHOST
        profiles = {"xml": {"raw": tuned_participants(names_of_domains, is_local=is_local)}}
    return yaml_text(
        {
            "version": CONFIGURATION_VERSION,
            **profiles,
            "allowlist": names,
            "topics": [{**name, "qos": qos} for name in names],
            "participants": participants,
        }
    )


BRIDGE = Bridge(
    name=PROGRAM,
    install="build it with colcon or take the docker image (https://eprosima-dds-router.readthedocs.io), and put it on the PATH",
    tried="3.2.0 on Fast DDS 3.2.2, with --tuned, November 2026",
    suffix=".yaml",
    configuration=_configuration,
    find=lambda: program_on_path(PROGRAM),
    version=lambda program: reported_version(program, "--version"),
    arguments=lambda _: ("--config-path",),
    halves=Halves.OPTIONAL,
    up_pattern="DDS Router running",
)


def _qos(qos: Qos) -> dict[str, object]:
    for policy in requested_durations(qos):
        raise OptionError(
            f"--{policy}: {PROGRAM} cannot set it on its topics, so they would not match; leave it out or take another bridge"
        )
    return {
        "reliability": qos.reliability == Reliability.RELIABLE,
        "durability": qos.durability == Durability.TRANSIENT_LOCAL,
        "history-depth": qos.depth,
    }


def _local_participant(domain_id: int, options: BridgeOptions) -> dict[str, object]:
    name = _participant_name(domain_id)
    if options.tuned:  # only a profile sets sizes of buffers
        return {"name": name, "kind": "xml", "profile": name}
    local: dict[str, object] = {"name": name, "kind": "local", "domain": domain_id}
    if options.transport in (Transport.UDP, Transport.SHM):
        local["transport"] = options.transport.value
    if options.discovery is Discovery.LOCALHOST:
        local["whitelist-interfaces"] = ["127.0.0.1"]
    return local


def _participant_name(domain_id: int) -> str:
    return f"domain_{domain_id}"


def _address(text: str) -> dict[str, object]:
    host, port = split_address(text)
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return {"domain": host, "port": port, "transport": "tcp"}
    return {"ip": host, "port": port, "transport": "tcp"}
