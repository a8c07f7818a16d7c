"""The commands that record a setup and a message again: `dds-record` of the relay and of the ping."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator, Mapping

from dds_trace.analyzer.model.setting import parse_setting
from dds_trace.analyzer.verdicts.cases import Setting
from dds_trace.analyzer.verdicts.job import Job
from dds_trace.base.printable import printable
from dds_trace.base.units import spell_duration, spell_size

QOS_DEFAULTS = {
    "reliability": "reliable",
    "durability": "volatile",
    "history": "keep_last",
    "depth": "10",
    "serialization": "raw",
}
"""Columns that are options of both sides, with the option's default."""

SETTING_OPTIONS = {
    "cpu_affinity": "--cpu-affinity",
    "load": "--load",
    "priority": "--priority",
    "when_full": "--when-full",
    "security": "--security",
    "realtime_priority": "--realtime",
    "wire": "--wire",
    "discovery": "--discovery",
    "transport": "--transport",
    "executor": "--executor",
    "tuned": "--tuned",
    "congestion_control": "--congestion-control",
    "deadline_ns": "--deadline",
    "lifespan_ns": "--lifespan",
    "rmw": "--rmw",
    "multicast": "--no-multicast",
    "buffer_bytes": "--buffer",
    "segment_bytes": "--segment",
    "fragment_bytes": "--fragment",
    "call": "--call",
    "response_bytes": "--response-size",
}
"""Setting of one side -> its option; any other is a `--setting` of the ping."""

PING_OPTIONS = {
    "bridge_running": "--bridge-running",
    "bridge_listen": "--bridge-listen",
    "relays": "--relays",
    "ping_share": "--ping-share",
    "wake_ms": "--wake",
    "clients": "--clients",
}

LISTENS_AT = "0.0.0.0:7447"
"""A trace does not contain the address of a bridge's half."""

IMU = "imu"
"""Its messages have one size."""

_HASH = re.compile(r"#[0-9a-f]+")


def recording_commands(setting: Setting, job: Job, messages: int) -> tuple[tuple[str, str], tuple[str, str]]:
    extra = parse_setting(str(setting["setting"]))
    relay_extra = {key.removeprefix("relay."): extra.pop(key) for key in list(extra) if key.startswith("relay.")}
    variables = {key: extra.pop(key) for key in list(extra) if key.isupper()}
    qos = {name: str(setting[name]) for name in QOS_DEFAULTS}
    own = {key: value for key, value in extra.items() if key in SETTING_OPTIONS}
    ping = {"rmw": str(setting["rmw"]), **own, **qos} if setting["rmw"] else {**own, **qos}
    has_same_backend = setting["relay_backend"] in (None, setting["backend"])
    relay = {**(ping if has_same_backend else {**own, **qos}), **relay_extra}
    if setting["connectivity"] == "loopback":
        ping, relay = ({"discovery": "localhost", **side} for side in (ping, relay))
    sides = (
        ("relay", setting["relay_backend"] or setting["backend"], setting["relay_device"], relay, ()),
        ("ping", setting["backend"], setting["ping_device"], ping, _message(setting, extra, job, messages)),
    )
    relay_words, ping_words = (
        (
            printable(str(device or "the relay's device")),
            _spelled(variables, ["--role", role, "--backend", str(backend), *options, *_side(values, setting, device)]),
        )
        for role, backend, device, values, options in sides
    )
    return relay_words, ping_words


def _message(setting: Setting, extra: Mapping[str, str], job: Job, messages: int) -> Iterator[str]:
    if setting["bridge"] != "none":
        yield from ("--bridge", str(setting["bridge"]))
    yield from ("--data", extra.get("data", job.data_type))
    if "data" not in extra and job.data_type != IMU:
        yield from ("--size", spell_size(job.payload_bytes))
    yield from ("--rate", f"{job.rate_hz:g}" if job.rate_hz else "max", "--messages", str(messages))
    for key, value in sorted(extra.items()):
        if key in PING_OPTIONS:
            yield from _option(PING_OPTIONS[key], LISTENS_AT if key == "bridge_listen" else value)
        elif key not in SETTING_OPTIONS and key not in ("data", "flows"):
            yield from ("--setting", f"{key}={value}")


def _side(values: Mapping[str, str], setting: Setting, device: object) -> Iterator[str]:
    for key, value in sorted(values.items()):
        if value not in (QOS_DEFAULTS.get(key), "default"):
            text = spell_duration(int(value)) if key.endswith("_ns") and value.isdecimal() else value
            yield from _option(SETTING_OPTIONS.get(key, f"--{key}"), text)
            yield from ("--keys", "keys") if key == "security" else ()
    if setting["connectivity"] != "loopback":
        yield from ("--connectivity", str(setting["connectivity"]))
    if device is not None:
        yield from ("--device", str(device))


def _option(name: str, value: str) -> tuple[str, ...]:
    return (name,) if value in ("true", "false") else (name, value)


def _spelled(variables: Mapping[str, str], arguments: list[str]) -> str:
    assignments = [f"{key}={shlex.quote(printable(_HASH.sub('', value)))}" for key, value in sorted(variables.items())]
    role = arguments[arguments.index("--role") + 1]
    words = ["dds-record", *arguments, "--out", f"runs/{role}.mcap"]
    return " ".join([*assignments, *(shlex.quote(printable(word)) for word in words)])
