"""Recording processes: events they dropped, how they ended, their environments; files that were skipped, cut, copied or recovered."""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise

import polars as pl

from dds_trace.base.units import counted
from dds_trace.tracefile.format.descriptions import Session
from dds_trace.tracefile.format.json_fields import number_of, object_of, objects_of

from ..loading.campaign import part_of
from ..model import applied
from ..model.environment import FLEETING, flat_fields, versions_of
from ..model.finding import Subject
from .evidence import Evidence, Observation, error, note, some, warning
from .rows import Rows, frame_of, in_recording, named

UNSAVED_NS = 1_000_000_000
"""With `-o fsync=true` a power loss takes less (`chunk_seconds`)."""

_ERROR_CHARACTERS = 400
"""Longest part of an error that is repeated."""


def _sessions(evidence: Evidence) -> pl.DataFrame:
    return frame_of(
        {
            "session_id": session.session_id,
            "state": session.state,
            "dropped_events": session.dropped_events,
            "error": None if _failed_bridge(session) else _reason(session, "error"),
            "stopped": _reason(session, "stopped"),
            "longest_unsaved_ns": number_of(session.extra.get("longest_unsaved_ns")),
            "dropped_datagrams": applied.socket_drops(session),
            "strangers": _strangers(session),
            "cure": _TUNED_ALREADY if applied.is_tuned(session) else _UNTUNED,
        }
        for session in evidence.campaign.sessions.values()
    )


_UNTUNED = "raise net.core.rmem_max and net.core.rmem_default, or record with --tuned"
_TUNED_ALREADY = "it has the buffers of --tuned already, so a lower rate or size may help"


def _reason(session: Session, name: str) -> str | None:
    reason = session.extra.get(name)
    return reason[:_ERROR_CHARACTERS].rstrip(".") if isinstance(reason, str) and reason else None


def _strangers(session: Session) -> str:
    counts = object_of(session.extra.get("strangers"))
    return some((f"{counts[kind]} x {str(kind)[:100]}" for kind in sorted(counts, key=str)), 8)


RECORDINGS = Rows(Subject.RECORDING, _sessions, in_recording)

_BRIDGE_FAILURES = {"died": "ended by itself", "never_ready": "never carried a message"}


def _failed_bridge(session: Session) -> Mapping[str, object] | None:
    bridge = session.extra.get("bridge")
    return bridge if isinstance(bridge, dict) and bridge.get("state") in _BRIDGE_FAILURES else None


@error(
    "bridge_failed",
    Subject.RECORDING,
    "Losses here are the bridge's: repeat the runs; its whole output is in the session of the trace.",
)
def failed_bridges(evidence: Evidence) -> Iterator[Observation]:
    """A bridge ended by itself, or never carried a message."""
    for session in evidence.campaign.sessions.values():
        if bridge := _failed_bridge(session):
            failure = str(bridge.get("failure") or "it said nothing").rstrip(".")
            state = _BRIDGE_FAILURES[str(bridge["state"])]
            tails = [str(log.get("log_tail") or "") for log in (bridge, *objects_of(bridge.get("programs")))]
            lines = [line.strip() for tail in tails for line in tail.splitlines()[-1:] if line.strip()]
            words = "; ".join(line[:200].rstrip(".") for line in lines) or "none"
            yield evidence.recording(
                session, f"The bridge {bridge.get('bridge')} {state}: {failure}. Its last words: {words}."
            )


@note("missing_files", Subject.RECORDING, "If you need those runs, copy the missing files into this folder.")
def missing_files(evidence: Evidence) -> Iterator[Observation]:
    """Files of a rotating recording are missing."""
    parts: dict[int, dict[int, Session]] = defaultdict(dict)
    for trace in evidence.campaign.traces:
        for session in trace.parts:
            parts[session.session_id][part_of(session)] = session
    for session_id, by_part in parts.items():
        last = max(by_part)
        missing = list(_missing_numbers(sorted(by_part)))
        if by_part[last].extra.get("followed"):
            missing.append(f"those after {last}")
        if missing:
            yield Observation(
                evidence.session_name(evidence.campaign.sessions[session_id]),
                f"Of the {last} files of this recording (-o rotate) some are not here: {some(missing)}.",
            )


def _missing_numbers(parts: Sequence[int]) -> Iterator[str]:
    """Yield the numbers from 1 on that ascending `parts` lack, a range as `2 to 5`: one may be huge."""
    for previous, following in pairwise((0, *parts)):
        first, last = previous + 1, following - 1
        if first <= last:
            yield str(first) if first == last else f"{first} to {last}"


@warning("doubtful_session", Subject.RECORDING, "Keep each recording in its own file.")
def doubtful_sessions(evidence: Evidence) -> Iterator[Observation]:
    """More than one session could have recorded a run."""
    runs = Counter((doubt.role, doubt.candidates) for doubt in evidence.exchanges.doubts)
    for (role, candidates), count in runs.items():
        yield Observation(
            some(evidence.session_name(evidence.campaign.sessions[c]) for c in candidates),
            f"{len(candidates)} {role} sessions could have recorded the events of {counted(count, 'run')} (a restarted "
            "process, or traces merged into one file); each run was assigned to the last session started before it.",
        )


_MIDDLEWARE_PARTS = ("versions", "configuration", "settings")
"""Parts of the fingerprint that are compared within one vendor only."""


@warning(
    "unlike_environments",
    Subject.RECORDING,
    "Compare numbers across these sessions with care, or record again under equal conditions.",
)
def unlike_environments(evidence: Evidence) -> Iterator[Observation]:
    """Sessions ran in different environments."""
    taking_part = {id(s): s for e in evidence.grouping.exchanges for s in (e.ping, e.relay) if s is not None}
    by_role: dict[str, list[Session]] = defaultdict(list)
    by_vendor: dict[str, list[Session]] = defaultdict(list)
    for session in taking_part.values():
        if session.host:
            by_role[f"{session.role} sessions"].append(session)
            by_vendor[f"{session.vendor} {session.role} sessions"].append(session)
    for where, sessions in sorted(by_role.items()):
        parts = ({k: v for k, v in s.host.items() if k not in (*_MIDDLEWARE_PARTS, *FLEETING)} for s in sessions)
        yield from _differences(where, [(s, dict(flat_fields(part))) for s, part in zip(sessions, parts, strict=True)])
    for where, sessions in sorted(by_vendor.items()):
        described = [(s, _middleware(s)) for s in sessions]
        names = {name for _, fields in described for name in fields}
        # A setting that one device lacks is a difference; an interface is none.
        yield from _differences(where, [(s, dict.fromkeys(names) | fields) for s, fields in described])


def _middleware(session: Session) -> dict[str, object]:
    parts = {name: session.host.get(name, {}) for name in _MIDDLEWARE_PARTS} | {"versions": versions_of(session)}
    return {"rmw": session.rmw, **dict(flat_fields(parts))}


def _differences(where: str, described: list[tuple[Session, dict[str, object]]]) -> Iterator[Observation]:
    values: dict[str, dict[str, list[Session]]] = defaultdict(lambda: defaultdict(list))
    for session, fields in described:
        for name, value in fields.items():
            values[name][json.dumps(value, sort_keys=True)].append(session)
    for name, by_value in sorted(values.items()):
        if len(by_value) > 1:
            listed = some((f"{value} {_on_devices(sessions)}" for value, sessions in sorted(by_value.items())), 4)
            yield Observation(where, f"{name} differs: {listed}.")


def _on_devices(sessions: list[Session]) -> str:
    devices = Counter(session.device for session in sessions)
    return "on " + ", ".join(f"{device} ({n} sessions)" if n > 1 else device for device, n in devices.items())


def _sources(evidence: Evidence) -> pl.DataFrame:
    sources = evidence.campaign.sources
    return frame_of([{"where": source.path, "status": source.status, "detail": source.detail} for source in sources])


SOURCES = Rows(Subject.FILE, _sources, named)


def _traces(evidence: Evidence) -> pl.DataFrame:
    return frame_of(
        {
            "where": evidence.campaign.name(index),
            "truncated": trace.truncated,
            "unreadable_messages": trace.unreadable_messages,
            "ring_events": trace.ring_events,
            "notes": trace.notes,
        }
        for index, trace in enumerate(evidence.campaign.traces)
    )


TRACES = Rows(Subject.FILE, _traces, named)
NOTES_OF_READERS = Rows(Subject.FILE, lambda evidence: evidence.frame(_traces).explode("notes"), named)


@note("skipped_file", Subject.FILE, "Nothing to do, unless one of them should be a trace.")
def skipped_files(evidence: Evidence) -> Iterator[Observation]:
    """Other files were not used."""
    others = [
        source.path
        for source in evidence.campaign.sources
        if source.status == "skipped" and not source.path.endswith(".mcap")
    ]
    if others:
        what = counted(
            len(others), "file here is not a trace and was not used.", "files here are not traces and were not used."
        )
        yield Observation(some(others, 10), what)


@note("overlapping_files", Subject.FILE, "Nothing to do; keep the more complete file to save time.")
def overlapping_files(evidence: Evidence) -> Iterator[Observation]:
    """Files share events."""
    read = {source.path for source in evidence.campaign.sources if source.status != "duplicate"}
    for copy in evidence.campaign.copies:
        name = evidence.campaign.name(copy.trace)
        if name in read:
            events = "is" if copy.events == 1 else "are"
            once = "it was" if copy.events == 1 else "they were"
            others = evidence.campaign.names(copy.others) or name
            yield Observation(name, f"{copy.events:,} of its events {events} also in {others}; {once} counted once.")


@error(
    "not_applied",
    Subject.RESULT,
    "No answer, bridge cost, recommendation or gate uses this result: request what the middleware can do, and record again.",
)
def settings_not_applied(evidence: Evidence) -> Iterator[Observation]:
    """The middleware did not apply a requested setting."""
    roles: dict[int, dict[str, set[str]]] = defaultdict(lambda: defaultdict(set))
    for exchange, group in evidence.exchanges_by_group():
        for role, session in (("ping", exchange.ping), ("relay", exchange.relay)):
            for words in applied.words_not_applied(session) if session else ():
                roles[group][words].add(role)
    for group, by_words in sorted(roles.items()):
        listed = "; ".join(f"{' and '.join(sorted(sides))}: {words}" for words, sides in by_words.items())
        yield evidence.result(group, f"What was requested is not what was measured. {listed[0].upper()}{listed[1:]}.")


def _fragments(evidence: Evidence) -> pl.DataFrame:
    """The kernel counts for a whole network namespace: of recordings with messages that are cut."""
    captured, cut = set(evidence.details.wire["group"]), evidence.groups_by_session(applied.may_be_cut)
    rows = []
    for session in evidence.campaign.sessions.values():
        groups = cut.get(session.session_id, ())
        rises, limits = applied.kernel_counts(session), applied.kernel_limits(session)
        time_s, most_bytes = limits.get("net.ipv4.ipfrag_time"), limits.get("net.ipv4.ipfrag_high_thresh")
        row = {"where": evidence.session_name(session), "late": rises.get("ReasmTimeout", 0), "limits": ""}
        if time_s is not None and most_bytes is not None:
            row["limits"] = f", whose other fragments wait for {time_s} s in at most {most_bytes:,} B"
        not_captured = [group for group in groups if group not in captured]
        for counter, concerned in (("ReasmFails", not_captured), ("FragFails", groups)):
            if concerned and rises.get(counter):
                rows.append({**row, "counter": counter, "datagrams": rises[counter], "groups": list(concerned)})
    return frame_of(rows)


FRAGMENTS = Rows(Subject.RECORDING, _fragments, lambda _, row: (row["where"], tuple(row["groups"])))


_SENT_SHARE, _LEAST_PAYLOAD_BYTES = 0.9, 2_000_000
"""Share of the payload that a carrying interface sends, and payload larger than discovery."""


@warning(
    "several_networks",
    Subject.RECORDING,
    "Name one interface on both sides: NetworkInterface in CYCLONEDDS_URI, interfaceWhiteList in a Fast DDS profile.",
)
def several_networks(evidence: Evidence) -> Iterator[Observation]:
    """Messages went over several networks at once.

    Interfaces within each other (bridge, bond) count alike.
    """
    payload_bytes: dict[int, dict[int, int]] = defaultdict(dict)
    for exchange, _, counts in evidence.counts_by_exchange():
        run = exchange.run
        payload_bytes[exchange.ping.session_id][run.run_id] = counts["with_warmup"] * run.payload_bytes
        if exchange.relay is not None:
            payload_bytes[exchange.relay.session_id][run.run_id] = counts["reached"] * run.payload_bytes
    for session_id, by_run in payload_bytes.items():
        session, payload = evidence.campaign.sessions[session_id], sum(by_run.values())
        sent_bytes = applied.interface_bytes(session).items()
        names = [name for name, sent in sent_bytes if name != "lo" and sent >= _SENT_SHARE * payload]
        if len(names) > 1 and payload >= _LEAST_PAYLOAD_BYTES:
            yield evidence.recording(
                session, f"Each of {' and '.join(names)} sent as many bytes as all its messages have ({payload:,} B)."
            )
