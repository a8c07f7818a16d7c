"""The parameter `setting` (docs/trace-format.md): requested options without a column, as one canonical text."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterator, Mapping
from urllib.parse import unquote

from dds_trace.tracefile.format.descriptions import Run, Session
from dds_trace.tracefile.format.json_fields import Json, JsonObject

LOAD = "load"
FLOW, WITH, FLOWS = "flow", "with", "flows"
"""A run's flow, the flows that ran with it (joined by +), and the runs of its machine."""

_CONDITIONS = "link relays nodes hosts pings topics data outage outage_by queue clients response_bytes"
CONDITIONS = frozenset((*_CONDITIONS.split(), LOAD, FLOW, WITH, FLOWS))
"""Keys that nobody chooses: other values are no alternatives."""

_OLD: Mapping[str, Callable[[str], str | None]] = {
    "transport": lambda text: None if text == "default" else text,
    "tuned": lambda text: None if text == "false" else "true",  # or a sentence: there was nothing to tune
    "executor": lambda text: "single" if text == "single" else None,
}
"""Of `host.middleware` of older recorders -> what the text requested, None for the default."""

_BOTH_SIDES = ("reliability", "durability", "history", "depth", "serialization")
"""The run has the ping's, only the session the relay's."""


def setting_of(
    run: Run,
    ping: Session,
    relay: Session | None,
    *,
    relays: int = 1,
    flows: int = 1,
    versions: tuple[str, str] = ("", ""),
) -> str:
    """Return `key=value,...`, sorted by key, defaults left out; with versions of both sides these, too.

    Where the relay's differs it is `relay.key=value`, `default` for one that only the ping has.
    """
    ping_settings = _side(ping)
    values = {key: value for key, value in ping_settings.items() if key not in _BOTH_SIDES}
    values |= _run_settings(run)
    if relays > 1:
        values.setdefault("relays", str(relays))
    if flows > 1:
        values[FLOWS] = str(flows)
    if versions[0]:
        values |= {"version": versions[0]} | ({"relay.version": versions[1]} if versions[0] != versions[1] else {})
    if relay is not None:
        values |= _relay_differences(ping, ping_settings, relay)
    return write_setting(values)


def write_setting(values: Mapping[str, str]) -> str:
    return ",".join(f"{_quoted(key, '=')}={_quoted(value)}" for key, value in sorted(values.items()))


def parse_setting(text: str) -> dict[str, str]:
    parts = re.findall(rf"(?:^|(?<=,))({_PART.pattern})(?=,|$)", text)
    pairs = (part.partition("=") for part in parts if part)
    return {unquote(key): unquote(value) for key, _, value in pairs}


def flows_of(setting: str) -> tuple[str, tuple[str, ...]]:
    values = parse_setting(setting)
    return values.get(FLOW, ""), tuple(filter(None, values.get(WITH, "").split("+")))


def condition_of(setting: str) -> str:
    return write_setting({k: v for k, v in parse_setting(setting).items() if k in CONDITIONS})


def choice_of(setting: str) -> str:
    return write_setting({k: v for k, v in parse_setting(setting).items() if k not in CONDITIONS})


def without_relay(setting: str) -> str:
    values = {k: v for k, v in parse_setting(setting).items() if k != "relays" and not k.startswith("relay.")}
    return write_setting(values)


def _side(session: Session) -> dict[str, str]:
    recorded = session.extra.get("settings")
    if isinstance(recorded, dict):
        settings = _texts(recorded)
    else:
        middleware = session.host.get("middleware")
        in_effect = _texts(middleware) if isinstance(middleware, dict) else {}
        requested = {key: read(in_effect[key]) for key, read in _OLD.items() if key in in_effect}
        settings = {key: value for key, value in requested.items() if value is not None}
    return settings | _configuration(session.host)


def _configuration(host: JsonObject) -> dict[str, str]:
    configuration = host.get("configuration")
    hash_of: dict[str, str] = {}
    for variable, entries in configuration.items() if isinstance(configuration, dict) else ():
        files = [entry for entry in entries if isinstance(entry, dict)] if isinstance(entries, list) else []
        if files:
            hash_of[variable] = "+".join(f"{entry.get('name')}#{str(entry.get('sha256'))[:8]}" for entry in files)
    return hash_of


def _run_settings(run: Run) -> dict[str, str]:
    recorded = run.extra.get("settings")
    values = _texts(run.qos.extra)
    if isinstance(run.extra.get("data_source"), str):
        values["data"] = str(run.extra["data_source"])
    if run.extra.get("bridge_running"):
        values["bridge_running"] = "true"
    if "link" in run.labels:  # of a sweep by an older recorder
        values["link"] = run.labels["link"]
    return values | (_texts(recorded) if isinstance(recorded, dict) else {})


def _relay_differences(ping: Session, ping_settings: Mapping[str, str], relay: Session) -> Iterator[tuple[str, str]]:
    relay_settings = _side(relay)
    compared: Collection[str] = {*relay_settings, *ping_settings}
    if not ("settings" in ping.extra and "settings" in relay.extra):
        # An older recorder's session says nothing of the other settings.
        compared = {key for key in compared if key in _OLD}
    for key in compared:
        if relay_settings.get(key) != ping_settings.get(key):
            yield f"relay.{key}", relay_settings.get(key, "default")
    if relay.rmw is not None and relay.rmw != ping.rmw:
        yield "relay.rmw", relay.rmw


def _texts(values: JsonObject) -> dict[str, str]:
    return {key: _text(value) for key, value in values.items()}


def _text(value: Json) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return f"{value:g}"
    return "+".join(map(_text, value)) if isinstance(value, list) else str(value)


_PART = re.compile(r"[^,()]*(?:\([^()]*\)[^,()]*)*")
"""Commas within parentheses only, in pairs and not nested."""


def _quoted(text: str, further: str = "") -> str:
    special = "%" + further + ("" if _PART.fullmatch(text) else ",()")
    return "".join(f"%{ord(c):02X}" if c in special else c for c in text)
