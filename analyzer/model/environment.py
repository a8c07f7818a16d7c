"""Environments: a digest of the lasting properties of both devices."""

from __future__ import annotations

import hashlib
import json
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence

from dds_trace.tracefile.format.descriptions import Session

Sides = tuple[Session, Session | None]
"""Sessions of ping and relay, None for a relay without a trace."""

FLEETING = ("wifi",)
"""Parts of the fingerprint that change from minute to minute."""


def flat_fields(host: Mapping[str, object], prefix: str = "", separator: str = ".") -> Iterator[tuple[str, object]]:
    for key, value in host.items():
        if isinstance(value, dict):
            yield from flat_fields(value, f"{prefix}{key}{separator}", separator)
        else:
            yield f"{prefix}{key}", value


_OLD_NAMES = {"fastrtps": "fastdds"}
"""Packages of Fast DDS up to version 2, by which older recorders name it."""


def versions_of(session: Session) -> dict[str, str]:
    """Return package -> version of the middleware and its client library."""
    recorded = session.host.get("versions")
    versions = {name: str(version) for name, version in recorded.items()} if isinstance(recorded, dict) else {}
    return {_OLD_NAMES.get(name, name): version for name, version in versions.items()}


def middleware_version(session: Session) -> str:
    versions = versions_of(session)
    return versions.get(session.vendor) or next((versions[name] for name in versions if session.vendor in name), "")


def versions_apart(sessions: Sequence[Session]) -> list[str]:
    """Return of each session the version in which they differ, the middleware's or else the first package's; empty if unknown, or equal in all."""
    tables = [{"": middleware_version(session), **versions_of(session)} for session in sessions]
    for name in dict.fromkeys(name for table in tables for name in table):
        found = [table.get(name, "") for table in tables]
        if len({*found} - {""}) > 1:
            return [version and f"{name} {version}".strip() for version in found]
    return [""] * len(tables)


_NOT_LASTING = (*FLEETING, "middleware", "configuration")
"""Fleeting parts, and what follows from the settings."""

_BY_BOOT = "udp_mem"
"""Limits that the kernel computes at boot from free memory."""


def lasting_parts(session: Session) -> dict[str, object]:
    host = {name: value for name, value in session.host.items() if name not in _NOT_LASTING}
    if "versions" in host:
        host["versions"] = {**versions_of(session)}
    if isinstance(mtus := host.pop("mtu", None), dict):
        # Interfaces come and go with containers; possible sizes of packets last.
        host["mtu"] = sorted({mtu for mtu in mtus.values() if isinstance(mtu, int)})
    return {name: value for name, value in flat_fields(host) if _BY_BOOT not in name}


def environment_of(ping: Session, relay: Session | None) -> str:
    """Return 8 hex digits of the SHA-256 of both sides' lasting parts as canonical JSON."""
    parts = {"ping": lasting_parts(ping), "relay": lasting_parts(relay) if relay is not None else None}
    canonical = json.dumps(parts, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(canonical.encode()).hexdigest()[:8]


def environment_differences(sides: Iterable[Sides]) -> dict[str, list[str]]:
    values: dict[str, set[str]] = defaultdict(set)
    for pair in sides:
        for role, session in zip(("ping", "relay"), pair, strict=True):
            for name, value in lasting_parts(session).items() if session is not None else ():
                values[f"{role} {name}"].add(json.dumps(value, sort_keys=True))
    return {name: sorted(texts) for name, texts in sorted(values.items()) if len(texts) > 1}
