"""The parameter `setting`: everything that was asked for and has no column of its own, as one canonical text.

The recorder writes what was asked for: `settings` of a session for its side, `settings` of a run for the ping's run
(`docs/trace-format.md`). A new option is there by itself. Traces of older recorders have no such fields; what can be told
of them comes from `host.middleware` and the run's own fields.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING
from urllib.parse import unquote

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Mapping

    from dds_trace.tracefile.format.descriptions import Run, Session
    from dds_trace.tracefile.format.json_fields import Json, JsonObject

CONDITIONS = frozenset({"link", "flows", "relays", "data"})
"""Keys of what surrounds a run and is no choice: groups that differ in these are no contenders of each other."""

_OLD: Mapping[str, Callable[[str], str | None]] = {
    "transport": lambda text: None if text == "default" else text,
    "tuned": lambda text: None if text == "false" else "true",  # or a sentence: there was nothing to tune
    "executor": lambda text: "single" if text == "single" else None,
}
"""Settings that `host.middleware` of older recorders tells -> what was asked for by that text, None for the default."""

_BOTH_SIDES = ("reliability", "durability", "history", "depth", "serialization")
"""Settings of a side that the run tells of the ping, and nothing but the session of the relay."""


def setting_of(run: Run, ping: Session, relay: Session | None, *, relays: int = 1, flows: int = 1) -> str:
    """Return the setting of an exchange: `key=value,...`, sorted by key, defaults left out.

    Args:
        run: the ping's description of the run.
        ping: session of the ping.
        relay: session of the relay, None without its trace. What it was asked for unlike the ping is `relay.key=value`;
            `default` stands for what it was not asked for.
        relays: number of relays that took part in the run.
        flows: number of runs that went on at the same time, this one included.
    """
    of_ping = _side(ping)
    values = {key: value for key, value in of_ping.items() if key not in _BOTH_SIDES}
    values |= _of_run(run)
    if relays > 1:
        values["relays"] = str(relays)
    if flows > 1:
        values["flows"] = str(flows)
    if relay is not None:
        values |= _of_relay(ping, of_ping, relay)
    return write_setting(values)


def write_setting(values: Mapping[str, str]) -> str:
    """Write keys and values as one text that `parse_setting` takes apart again."""
    return ",".join(f"{_quoted(key, '=')}={_quoted(value)}" for key, value in sorted(values.items()))


def parse_setting(text: str) -> dict[str, str]:
    """Return the keys and values of a setting."""
    pairs = (part.partition("=") for part in _split(text))
    return {unquote(key): unquote(value) for key, _, value in pairs}


def condition_of(setting: str) -> str:
    """Return the part of a setting that surrounds a run and that nobody chooses: see `CONDITIONS`."""
    return write_setting({k: v for k, v in parse_setting(setting).items() if k in CONDITIONS})


def choice_of(setting: str) -> str:
    """Return the part of a setting that a user can choose: all but its `condition_of`."""
    return write_setting({k: v for k, v in parse_setting(setting).items() if k not in CONDITIONS})


def without_relay(setting: str) -> str:
    """Return the part of a setting that is known without the relay's trace."""
    known = {k: v for k, v in parse_setting(setting).items() if k != "relays" and not k.startswith("relay.")}
    return write_setting(known)


def _side(session: Session) -> dict[str, str]:
    """Return what a side was asked for, defaults left out."""
    told = session.extra.get("settings")
    if isinstance(told, dict):
        settings = _texts(told)
    else:
        middleware = session.host.get("middleware")
        in_effect = _texts(middleware) if isinstance(middleware, dict) else {}
        asked = {key: ask(in_effect[key]) for key, ask in _OLD.items() if key in in_effect}
        settings = {key: value for key, value in asked.items() if value is not None}
    return settings | _configuration(session.host)


def _configuration(host: JsonObject) -> dict[str, str]:
    """Return the user's configuration files of the middleware: variable -> names with the first digits of their hashes."""
    configuration = host.get("configuration")
    named: dict[str, str] = {}
    for variable, entries in configuration.items() if isinstance(configuration, dict) else ():
        files = [entry for entry in entries if isinstance(entry, dict)] if isinstance(entries, list) else []
        if files:
            named[variable] = "+".join(
                f"{entry.get('name')}#{str(entry.get('sha256'))[:8]}" for entry in files
            )
    return named


def _of_run(run: Run) -> dict[str, str]:
    told = run.extra.get("settings")
    values = _texts(run.qos.extra)
    if isinstance(run.extra.get("data_source"), str):
        values["data"] = str(run.extra["data_source"])
    if run.extra.get("bridge_running"):
        values["bridge_running"] = "true"
    if "link" in run.labels:  # of a sweep by an older recorder
        values["link"] = run.labels["link"]
    return values | (_texts(told) if isinstance(told, dict) else {})


def _of_relay(ping: Session, of_ping: Mapping[str, str], relay: Session) -> Iterator[tuple[str, str]]:
    """Yield what the relay was asked for unlike the ping."""
    of_relay = _side(relay)
    compared: Collection[str] = {*of_relay, *of_ping}
    if not ("settings" in ping.extra and "settings" in relay.extra):
        # An older recorder's session is silent about the rest, which is no difference.
        compared = {key for key in compared if key in _OLD}
    for key in compared:
        if of_relay.get(key) != of_ping.get(key):
            yield f"relay.{key}", of_relay.get(key, "default")
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
"""A value that holds commas within parentheses only, and these in pairs and not within each other."""


def _quoted(text: str, further: str = "") -> str:
    """Write `%`, and what would end a key or value, as URLs do."""
    special = "%" + further + ("" if _PART.fullmatch(text) else ",()")
    return "".join(f"%{ord(c):02X}" if c in special else c for c in text)


def _split(text: str) -> list[str]:
    return [part for part in re.findall(rf"(?:^|(?<=,))({_PART.pattern})(?=,|$)", text) if part]
