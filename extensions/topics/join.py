"""Messages of a publisher at all its taps: which are the same, their origin, when each tap had them.

A message has one publisher and sequence number at each tap; without numbers one source stamp and content; after a bridge,
which publishes again, one content. Contents that repeat are then not joined.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from dds_trace.analyzer.clocks.lines import Int64
from dds_trace.analyzer.loading.campaign import Campaign
from dds_trace.analyzer.loading.event_index import EventPart, merge_parts
from dds_trace.analyzer.model.detail_frames import MESSAGE_COLUMNS
from dds_trace.extensions.bags.bounds import DAY_NS
from dds_trace.tracefile.format.descriptions import Session
from dds_trace.tracefile.format.events import Stage, TapColumns
from dds_trace.tracefile.format.json_fields import JsonObject, object_of

from .clock_track import UNKNOWN_NS
from .device_clocks import DeviceClocks, Machine, machine_of_session

TAP_ROLE = "tap"


@dataclass(frozen=True, slots=True, eq=False)
class Heard:
    session: Session
    topic: str
    message_type: str
    publisher: str
    node: str
    qos: JsonObject
    subscribed: JsonObject
    has_sequence: bool
    is_local: bool | None
    messages: pl.DataFrame
    end_ns: int

    @property
    def machine(self) -> Machine:
        return machine_of_session(self.session)


def heard_by_taps(campaign: Campaign) -> list[Heard]:
    parts: dict[tuple[int, int], list[EventPart]] = defaultdict(list)
    ends: dict[int, int] = defaultdict(int)
    for (stage, _, publisher_id), parts_of_key in campaign.events.items():
        for part in parts_of_key if stage is Stage.TAP else ():
            taps = [session.session_id for session in campaign.traces[part.trace].sessions if session.role == TAP_ROLE]
            session_id = taps[-1] if taps else -1
            parts[session_id, publisher_id].append(part)
            ends[session_id] = max(ends[session_id], part.last_ns)
    records: dict[tuple[int, int], JsonObject] = {}
    for trace in campaign.traces:
        for record in trace.publishers:
            session_id, publisher_id = _number(record.get("session_id"), 16), _number(record.get("publisher_id"), 10)
            records[session_id, publisher_id] = record
            instant_ns = record.get("monotonic_ns")
            if isinstance(instant_ns, int) and session_id in ends:
                ends[session_id] = max(ends[session_id], instant_ns)
    heard = [
        _heard(campaign.sessions[key[0]], records[key], parts_of_publisher, ends[key[0]])
        for key, parts_of_publisher in parts.items()
        if key in records and key[0] in campaign.sessions
    ]
    return sorted(heard, key=lambda stream: (stream.topic, stream.session.session_id, stream.publisher))


def _number(value: Any, base: int) -> int:
    try:
        return int(str(value), base)
    except ValueError:
        return -1


def _heard(session: Session, record: JsonObject, parts: list[EventPart], end_ns: int) -> Heard:
    events = TapColumns.from_events(merge_parts(parts)[0])
    order = np.argsort(events.monotonic_ns, kind="stable")
    columns = {
        "received_ns": events.monotonic_ns,
        **{name: getattr(events, name) for name in ("header_ns", "source_ns", "content_hash")},
        **{name: getattr(events, name) for name in ("publication_sequence", "payload_bytes")},
    }
    return Heard(
        session=session,
        topic=_text(record, "topic"),
        message_type=_text(record, "type"),
        publisher=_text(record, "publisher"),
        node=_text(record, "node"),
        qos=object_of(record.get("qos")),
        subscribed=object_of(record.get("subscribed")),
        has_sequence=record.get("sequence_is_given") is True and bool((events.publication_sequence > 0).all()),
        is_local=is_local if isinstance(is_local := record.get("is_local"), bool) else None,
        messages=pl.DataFrame({name: values[order] for name, values in columns.items()}),
        end_ns=end_ns,
    )


def _text(record: JsonObject, name: str) -> str:
    value = record.get(name)
    return value if isinstance(value, str) else ""


FASTEST = 0.05
"""Quantile of lateness that decides which tap is next to the publisher."""

_MOST_MISSING = 1_000
"""Missing numbers in a row, or ten for each message heard; beyond, the publisher counts from the start."""

NOT_BOUNDED_NS = UNKNOWN_NS // 4
"""Bound of an unknown time; sums of two fit into 64 bits."""

Key = tuple[str, ...]
SEQUENCE, SOURCE, CONTENT = ("publication_sequence",), ("source_ns", "content_hash"), ("content_hash",)


@dataclass(frozen=True, slots=True, eq=False)
class Stream:
    heard: tuple[Heard, ...]
    key: Key

    @property
    def machines(self) -> tuple[Machine, ...]:
        return tuple(sorted({tap.machine for tap in self.heard}))


@dataclass(frozen=True, slots=True, eq=False)
class Delivery:
    """The messages of a stream at one tap.

    Attributes:
        origin: the publisher's machine; None if unknown.
        clock: `same`, `fit`, `assumed` (nothing says that the publisher ran here) or `unknown`.
        messages: by publishing; the columns of `MESSAGE_COLUMNS`, ages null before `with_ages`.
    """

    heard: Heard
    origin: Machine | None
    clock: str
    messages: pl.DataFrame


_BY_CLOCK = ("one_way_ns", "age_ns", "bound_ns", "stamp_to_publish_ns")


def find_streams(heard: Sequence[Heard]) -> Iterator[Stream]:
    by_topic: dict[str, list[Heard]] = defaultdict(list)
    for tap in heard:
        by_topic[tap.topic].append(tap)
    for on_topic in by_topic.values():
        by_publisher: dict[str, list[Heard]] = defaultdict(list)
        for number, tap in enumerate(on_topic):
            by_publisher[tap.publisher or f"unknown {number}"].append(tap)
        unmatched = [
            Stream(tuple(parts), SEQUENCE if all(tap.has_sequence for tap in parts) else SOURCE)
            for parts in by_publisher.values()
        ]
        while unmatched:
            stream = unmatched.pop(0)
            for other in list(unmatched):
                key = _shared_key(stream, other)
                if key is not None:
                    stream = Stream((*stream.heard, *other.heard), key)
                    unmatched.remove(other)
            yield stream


def _shared_key(first: Stream, other: Stream) -> Key | None:
    if {tap.session.session_id for tap in first.heard} & {tap.session.session_id for tap in other.heard}:
        return None
    for key in (SOURCE, CONTENT):
        sides = [pl.concat([tap.messages.select(key) for tap in stream.heard]).unique() for stream in (first, other)]
        if key is SOURCE and any((side["source_ns"] == 0).any() for side in sides):
            continue
        alike = len(sides[0].join(sides[1], on=key, how="semi"))
        if 2 * alike >= min(map(len, sides)) > 0:  # a bridge made one of the other
            return key
    return None


def deliver(stream: Stream, clocks: DeviceClocks) -> Iterator[Delivery]:
    arrivals = [_arrivals(tap, stream.key) for tap in stream.heard]
    sent = _sent(stream.key, arrivals)
    origin, is_assumed = _origin(stream, arrivals, clocks)
    machine = stream.heard[0].machine if origin is None else origin
    sent = _with_publish(stream, arrivals, sent, machine, clocks)
    for tap, arrived in zip(stream.heard, arrivals, strict=True):
        messages = _messages(stream.key, tap, arrived, sent, machine, clocks)
        clock = "assumed" if is_assumed else "same" if clocks.share_clock(machine, tap.machine) else "fit"
        if origin is None or messages["bound_ns"].null_count() == len(messages):
            clock = "unknown"
            messages = messages.with_columns(pl.lit(None, pl.Int64).alias(name) for name in _BY_CLOCK)
        missing = [pl.lit(None, pl.Int64).alias(name) for name in _BY_CLOCK if name not in messages.columns]
        messages = messages.with_columns(missing).select(pl.col(n).cast(t) for n, t in MESSAGE_COLUMNS.items())
        yield Delivery(tap, origin, clock, messages)


def _arrivals(heard: Heard, key: Key) -> pl.DataFrame:
    if key == CONTENT:
        return heard.messages.filter(~pl.col("content_hash").is_duplicated()).with_columns(
            duplicates=pl.lit(0, pl.UInt16), reordered=pl.lit(value=False)
        )
    order = pl.col(key[0])
    return (
        heard.messages.with_columns(reordered=order < order.cum_max())
        .group_by(key, maintain_order=True)
        .agg(pl.all().first(), (pl.len() - 1).clip(0, 65535).cast(pl.UInt16).alias("duplicates"))
    )


def _sent(key: Key, arrivals: Sequence[pl.DataFrame]) -> pl.DataFrame:
    names = ["source_ns", "header_ns", "payload_bytes"]
    sent = (
        pl.concat([part.select(*dict.fromkeys([*key, *names])) for part in arrivals])
        .group_by(key, maintain_order=True)
        .agg(pl.col(name).max() for name in names if name not in key)
        .with_columns(is_heard=pl.lit(value=True))
    )
    if key != SEQUENCE:
        return sent
    sent = sent.sort("publication_sequence")
    missing = _missing_numbers(sent["publication_sequence"].to_numpy())
    numbers = pl.DataFrame({"publication_sequence": missing}, {"publication_sequence": pl.UInt64})
    return pl.concat([sent, numbers], how="diagonal").sort("publication_sequence")


def _missing_numbers(sequence: NDArray[np.uint64]) -> NDArray[np.uint64]:
    gaps = np.diff(sequence)
    most = max(_MOST_MISSING, 10 * len(sequence))
    holes = np.flatnonzero((gaps > 1) & (gaps <= most))
    lengths = (gaps[holes] - 1).astype(np.int64)
    if lengths.sum() > most:
        return np.empty(0, np.uint64)
    starts = np.repeat(np.cumsum(lengths) - lengths, lengths)
    return np.repeat(sequence[holes] + 1, lengths) + (np.arange(lengths.sum()) - starts).astype(np.uint64)


def _origin(stream: Stream, arrivals: Sequence[pl.DataFrame], clocks: DeviceClocks) -> tuple[Machine | None, bool]:
    """Return the publisher's machine, None if unknown, and whether it is only assumed, being the only one.

    The tap next to it may know. Else it is the only machine with a clock that can have made the stamps, else the one that hears
    messages first.
    """
    local = {tap.machine for tap in stream.heard if tap.is_local}
    if len(local) == 1:
        return local.pop(), False
    if len(clocks.machines) == 1:
        return clocks.machines[0], True
    remote = {tap.machine for tap in stream.heard if tap.is_local is False}
    candidates = [tap for tap in clocks.machines if tap not in remote]
    possible = [tap for tap in candidates if _can_be_origin(stream, arrivals, tap, clocks)]
    if len(possible) == 1:
        return possible[0], False
    if len(stream.machines) == 1:
        return None, False
    machine = stream.machines[0]
    reached = [
        clocks.convert(part["received_ns"].to_numpy(), tap.machine, machine) for tap, part in _zip(stream, arrivals)
    ]
    if any((tap.bound_ns >= NOT_BOUNDED_NS).all() for tap in reached):
        return None, False
    heard_by = [
        part.select(*stream.key, at_ns=tap.at_ns, tap=pl.lit(number))
        for number, (part, tap) in enumerate(zip(arrivals, reached, strict=True))
    ]
    all_taps = pl.concat(heard_by).with_columns(late_ns=pl.col("at_ns") - pl.col("at_ns").min().over(stream.key))
    at_both = all_taps.filter(pl.len().over(stream.key) > 1)
    # The fastest messages show the way, others wait for a processor.
    fastest = at_both.group_by("tap").agg(
        pl.col("late_ns").quantile(FASTEST), pl.col("late_ns").mean().alias("mean_ns")
    )
    taps = fastest.sort("late_ns", "mean_ns", "tap")["tap"]
    return (stream.heard[taps[0]].machine if len(taps) else None), False


def _can_be_origin(stream: Stream, arrivals: Sequence[pl.DataFrame], origin: Machine, clocks: DeviceClocks) -> bool:
    for tap, part in _zip(stream, arrivals):
        stamped = part.filter(pl.col("source_ns") != 0)
        publish = clocks.of_wall(stamped["source_ns"].to_numpy(), origin)
        reached = clocks.convert(stamped["received_ns"].to_numpy(), tap.machine, origin)
        slack_ns = publish.bound_ns + np.minimum(reached.bound_ns, NOT_BOUNDED_NS)
        is_bounded = slack_ns < NOT_BOUNDED_NS
        if not is_bounded.any() or (reached.at_ns - publish.at_ns + slack_ns < 0).any():
            return False
    return True


def _with_publish(
    stream: Stream, arrivals: Sequence[pl.DataFrame], sent: pl.DataFrame, machine: Machine, clocks: DeviceClocks
) -> pl.DataFrame:
    """Add each publish time on the publisher's clock, and its bound: by stamp, else by a tap next to it."""
    source_ns = sent["source_ns"].fill_null(0).to_numpy()
    stamped = clocks.of_wall(source_ns, machine)
    at_ns = np.where(source_ns == 0, 0, stamped.at_ns)
    bound_ns = np.where(source_ns == 0, NOT_BOUNDED_NS, stamped.bound_ns)
    for tap, part in _zip(stream, arrivals):
        received = sent.select(stream.key).join(
            part.select(*stream.key, "received_ns"), on=stream.key, how="left", maintain_order="left"
        )["received_ns"]
        reached = clocks.convert(received.fill_null(0).to_numpy(), tap.machine, machine)
        fills = (at_ns == 0) & received.is_not_null().to_numpy()
        at_ns[fills] = reached.at_ns[fills]
        if clocks.share_clock(machine, tap.machine):
            bound_ns[fills] = reached.bound_ns[fills]
    heard_at = np.flatnonzero(at_ns)  # what nobody heard was sent between its neighbours
    if len(heard_at) < len(at_ns):
        first_ns = at_ns[heard_at[0]]
        at_ns = first_ns + np.interp(np.arange(len(at_ns)), heard_at, at_ns[heard_at] - first_ns).astype(np.int64)
    return sent.with_columns(publish_ns=at_ns, publish_bound_ns=bound_ns)


def _messages(
    key: Key, heard: Heard, arrived: pl.DataFrame, sent: pl.DataFrame, machine: Machine, clocks: DeviceClocks
) -> pl.DataFrame:
    arrivals_here = arrived.select(*key, "duplicates", "reordered", relay_in_ns=pl.col("received_ns"))
    joined = sent.join(arrivals_here, on=key, how="left", maintain_order="left")
    reached = clocks.convert(joined["relay_in_ns"].fill_null(0).to_numpy(), heard.machine, machine)
    publish_ns, publish_bound_ns = joined["publish_ns"].to_numpy(), joined["publish_bound_ns"].to_numpy()
    bound_ns = np.minimum(reached.bound_ns, NOT_BOUNDED_NS) + publish_bound_ns
    is_bounded = joined["relay_in_ns"].is_not_null().to_numpy() & (bound_ns < NOT_BOUNDED_NS)
    has_arrived = joined["relay_in_ns"].is_not_null()
    is_heard = joined["is_heard"].fill_null(value=False)
    messages = joined.select(
        (pl.col(SEQUENCE) if key == SEQUENCE else pl.int_range(pl.len(), dtype=pl.UInt64)).alias("sequence"),
        "publish_ns",
        "relay_in_ns",
        pl.col("header_ns").replace(0, None),
        _present("one_way_ns", is_bounded, _not_before(reached.at_ns - publish_ns, bound_ns)),
        _present("bound_ns", is_bounded, bound_ns),
        pl.col("payload_bytes").alias("message_bytes"),
        outcome=pl.when(has_arrived)
        .then(pl.lit("completed"))
        .when(is_heard)
        .then(pl.lit("lost_outbound"))
        .otherwise(pl.lit("lost_unknown")),
        duplicates=pl.col("duplicates").fill_null(0),
        reordered=pl.col("reordered").fill_null(value=False),
    )
    (end_ns,) = clocks.convert(np.array([heard.end_ns]), heard.machine, machine).at_ns.tolist()
    under_way_ns = int((reached.at_ns - publish_ns)[has_arrived.to_numpy()].max()) if has_arrived.any() else 0
    return _in_service(messages.sort("publish_ns", maintain_order=True), end_ns - under_way_ns)


def with_ages(delivery: Delivery, stamper: Machine, clocks: DeviceClocks) -> Delivery:
    """Add ages, by stamps of `stamper`, and times from stamp to publishing."""
    messages, origin = delivery.messages, delivery.origin
    if origin is None or delivery.clock == "unknown":
        return delivery
    header_ns = messages["header_ns"].fill_null(0).to_numpy()
    stamped = clocks.of_wall(header_ns, stamper)
    received = messages["relay_in_ns"]
    reached = clocks.convert(received.fill_null(0).to_numpy(), delivery.heard.machine, stamper)
    published = clocks.convert(messages["publish_ns"].to_numpy(), origin, stamper)
    age_ns, delay_ns = reached.at_ns - stamped.at_ns, published.at_ns - stamped.at_ns
    bound_ns = np.minimum(reached.bound_ns, NOT_BOUNDED_NS) + stamped.bound_ns
    delay_bound_ns = np.minimum(published.bound_ns, NOT_BOUNDED_NS) + 2 * stamped.bound_ns
    is_stamped = (header_ns != 0) & received.is_not_null().to_numpy() & (np.abs(age_ns) < DAY_NS)
    has_age, has_delay = is_stamped & (bound_ns < NOT_BOUNDED_NS), is_stamped & (delay_bound_ns < NOT_BOUNDED_NS)
    ages = messages.with_columns(
        _present("age_ns", has_age, _not_before(age_ns, bound_ns)),
        _present("stamp_to_publish_ns", has_delay, _not_before(delay_ns, delay_bound_ns)),
        pl.max_horizontal("bound_ns", _present("age_bound_ns", has_age, bound_ns)).alias("bound_ns"),
    )
    return replace(delivery, messages=ages)


def _in_service(messages: pl.DataFrame, settled_ns: int) -> pl.DataFrame:
    arrived = np.flatnonzero(messages["relay_in_ns"].is_not_null().to_numpy())
    if not len(arrived):
        return messages.clear()
    after = max(int(arrived[-1]) + 1, int((messages["publish_ns"] <= settled_ns).sum()))
    return messages[int(arrived[0]) : after]


def _not_before(value_ns: Int64, bound_ns: Int64) -> Int64:
    """Raise times below zero as far as their bound allows: nothing arrives before it is sent."""
    return np.where((value_ns < 0) & (value_ns >= -bound_ns), 0, value_ns)


def _present(name: str, is_present: NDArray[np.bool_], values: Int64) -> pl.Series:
    series = pl.Series(name, values, pl.Int64)
    return series if is_present.all() else series.set(pl.Series(~is_present), None)


def _zip(stream: Stream, arrivals: Sequence[pl.DataFrame]) -> Iterator[tuple[Heard, pl.DataFrame]]:
    return zip(stream.heard, arrivals, strict=True)
