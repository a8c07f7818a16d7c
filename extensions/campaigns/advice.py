"""Settings of a vendor that may serve a link and a load better than its defaults."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path

from dds_trace.analyzer.model.environment import flat_fields
from dds_trace.recorder.applied.vendors import BUFFER_BYTES
from dds_trace.recorder.backends import load_backend
from dds_trace.recorder.backends.ros2.fastdds_profile import Settings, profile_xml, xml_text
from dds_trace.recorder.backends.ros2.installation import fast_dds
from dds_trace.recorder.kernel.counters import read_limits

from .folder import replace_text
from .plan.link import Link

PACKET_BYTES = 1400
"""Largest datagram that no link splits, with its headers."""
LARGEST_BYTES = 1 << 16
"""Largest datagram, which one period of a flow controller has to let through."""
DATAGRAM_BYTES = {"fastdds": LARGEST_BYTES, "cyclonedds": 14_720}
"""Largest datagram of a vendor's defaults; zenoh sends a stream."""
PACED_SHARE, PERIOD_MS = 0.8, 10
"""Share of the link's rate at which Fast DDS may send, and its shortest period."""


def bundles(vendor: str, largest_bytes: int, link: Link | None) -> dict[str, str]:
    rate_byte_s = link.rate_mbit_s * 1e6 / 8 if link else 0.0
    if vendor == "fastdds":
        return _fastdds(largest_bytes, rate_byte_s)
    if vendor == "cyclonedds":
        by_name = _cyclonedds(rate_byte_s * link.queue_ms / 1000 if link else 0.0)
        return {name: xml_text(name, {"CycloneDDS": {"Domain": domain}}) for name, domain in by_name.items()}
    if vendor == "zenoh":
        by_name = _zenoh(largest_bytes, rate_byte_s * (0.005 + 0.002 * link.delay_ms) if link else 0.0)
        texts = {name: json.dumps({"transport": settings}, indent=2) for name, settings in by_name.items()}
        return {name: f"// Written by dds-trace: {name}.\n{text}\n" for name, text in texts.items()}
    return {}


def arriving_share(vendor: str, bundle: str, largest_bytes: int, link: Link | None) -> float:
    """Return the share of datagrams that arrive: one is lost with any of its packets."""
    sizes = {"small-packets": PACKET_BYTES, "large-packets": LARGEST_BYTES}
    own_bytes = DATAGRAM_BYTES.get(vendor, PACKET_BYTES)
    datagram_bytes = next((size for name, size in sizes.items() if bundle.endswith(name)), own_bytes)
    loss = link.loss_percent / 100 / max(1.0, link.loss_burst) if link else 0.0
    return (1 - loss) ** math.ceil(min(datagram_bytes, largest_bytes) / PACKET_BYTES)


def write_bundles(vendor: str, texts_by_name: Mapping[str, str], folder: Path) -> list[Path]:
    ending = ".json5" if vendor == "zenoh" else ".xml"
    texts = {folder / f"{name}{ending}": text for name, text in texts_by_name.items()}
    for path, text in texts.items():
        folder.mkdir(parents=True, exist_ok=True)
        replace_text(path, text)
    return list(texts)


def variables_of(vendor: str, path: Path) -> dict[str, str]:
    maker = load_backend("ros2" if vendor == "fastdds" else vendor).variables_of
    assert maker is not None
    variables = dict(maker("rmw_fastrtps_cpp", path.absolute()))
    if vendor == "zenoh":
        leaves = flat_fields(json.loads(path.read_text().partition("\n")[2]), separator="/")
        variables["ZENOH_CONFIG_OVERRIDE"] = ";".join(f"{name}={json.dumps(value)}" for name, value in leaves)
    return variables


def _receive_bytes() -> int:
    return min(BUFFER_BYTES, read_limits().get("net.core.rmem_max", BUFFER_BYTES))


def _fastdds(largest_bytes: int, rate_byte_s: float) -> dict[str, str]:
    heartbeat, nack, answer = fast_dds().times
    writer, reader = (
        f'{kind} profile_name="dds_trace_{kind}" is_default_profile="true"' for kind in ("data_writer", "data_reader")
    )
    times = {"times": {heartbeat: {"nanosec": 20_000_000}, nack: {"nanosec": 1_000_000}}}
    quick = {writer: times, reader: {"times": {answer: {"nanosec": 1_000_000}}}}
    small = {"maxMessageSize": PACKET_BYTES}

    def text(name: str, further: Settings, udp: Settings | None = None, rtps: Settings | None = None) -> str:
        transports: dict[str, Settings] = {
            "dds_trace_shm": {"type": "SHM", "segment_size": max(1 << 20, 4 * largest_bytes)},
            "dds_trace_udp": {"type": "UDPv4", "receiveBufferSize": _receive_bytes(), **(udp or {})},
        }
        return profile_xml(name, transports, rtps or {}, further)

    settings = {
        "buffers": text("buffers", {}),
        "quick-repair": text("quick-repair", quick),
        "small-packets": text("small-packets", quick, small),
    }
    if not rate_byte_s:
        return settings
    period_ms = max(PERIOD_MS, math.ceil(1000 * LARGEST_BYTES / (PACED_SHARE * rate_byte_s)))
    budget_bytes = round(PACED_SHARE * rate_byte_s * period_ms / 1000)
    pace = {"name": "dds_trace_pace", "max_bytes_per_period": budget_bytes, "period_ms": period_ms}
    controller = {"flow_controller_descriptor_list": {"flow_controller_descriptor": pace}}
    mode = {"publishMode": {"kind": "ASYNCHRONOUS", "flow_controller_name": "dds_trace_pace"}}
    paced = {**quick, writer: {"qos": mode, **times}}
    return settings | {
        "paced": text("paced", paced, None, controller),
        "paced-small-packets": text("paced-small-packets", paced, small, controller),
    }


def _cyclonedds(queue_bytes: float) -> dict[str, Settings]:
    buffers: Settings = {f'SocketReceiveBufferSize min="default" max="{_receive_bytes()}B"': ""}
    delays = {"NackDelay": "10ms", "AckDelay": "5ms", "HeartbeatInterval": "20ms", "AutoReschedNackDelay": "50ms"}
    quick = {**buffers, **delays}
    small = {"MaxMessageSize": f"{PACKET_BYTES}B", "FragmentSize": f"{PACKET_BYTES - 100}B"}
    large = {"MaxMessageSize": "65500B", "FragmentSize": "60000B"}
    settings = {
        "buffers": {"Internal": buffers},
        "large-packets": {"General": large, "Internal": buffers},
        "quick-repair": {"Internal": quick},
        "small-packets": {"General": small, "Internal": quick},
    }
    if queue_bytes:
        burst = max(LARGEST_BYTES, round(queue_bytes / 2))
        bursts = {"BurstSize": {"MaxRexmit": f"{burst}B", "MaxInitTransmit": burst}}  # the latter has no unit
        settings["paced-small-packets"] = {"General": small, "Internal": {**quick, **bursts}}
    return settings


def _zenoh(largest_bytes: int, on_the_way_bytes: float) -> dict[str, Settings]:
    unbatched: Settings = {"tx": {"queue": {"batching": {"enabled": False}}}}
    buffers = {**unbatched, "rx": {"buffer_size": max(1 << 16, min(largest_bytes, 1 << 20))}}
    settings: dict[str, Settings] = {"unbatched": {"link": unbatched}, "buffers": {"link": buffers}}
    if on_the_way_bytes:
        send_bytes = max(1 << 14, min(1 << 22, round(on_the_way_bytes)))
        settings["short-queue"] = {"link": {**buffers, "tcp": {"so_sndbuf": send_bytes}}}
    return settings
