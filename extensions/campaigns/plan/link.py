"""An emulated link between two network namespaces: values, presets, its report, and its drive: what a link did over time, from a CSV file."""

from __future__ import annotations

import csv
import hashlib
import itertools
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, fields
from functools import cache
from pathlib import Path
from typing import TypeAlias, TypedDict

from dds_trace.base import limits
from dds_trace.base.errors import OptionError
from dds_trace.base.files import read_settings
from dds_trace.base.link_words import link_words
from dds_trace.base.units import SECOND_NS, counted

from .cells import plan_key

Row: TypeAlias = tuple[float, float, float, float, float]
"""Values of `COLUMNS`."""

COLUMNS = ("time_s", "rate_mbit_s", "delay_ms", "loss_percent", "jitter_ms")
"""Columns of the file; `time_s` is required, a missing one is 0 in every row (no limit of the rate)."""

MOST_ROWS = 100_000
_LIMITS = (limits.WAIT_S, limits.LINE_MBIT_S, limits.DELAY_MS, limits.PERCENT, limits.DELAY_MS)


@dataclass(frozen=True, slots=True)
class Drive:
    """The rows of a file, each valid from its time on; the last one starts it over. A rate of 0 lets nothing pass."""

    rows: tuple[Row, ...]
    has_rate: bool
    sha256: str

    @property
    def length_s(self) -> float:
        return self.rows[-1][0]

    def between(self, started_ns: int, first_ns: int, last_ns: int) -> Iterator[tuple[int, Row]]:
        length_ns = round(self.length_s * SECOND_NS)
        valid: Row | None = None
        for turn in itertools.count(max(0, (first_ns - started_ns) // length_ns)):
            for row in self.rows[:-1]:
                at_ns = started_ns + turn * length_ns + round(row[0] * SECOND_NS)
                if at_ns < first_ns:
                    valid = row
                    continue
                if valid is not None:
                    yield first_ns, valid
                if at_ns > last_ns:
                    return
                valid = None
                yield at_ns, row


@cache
def read_drive(path: str) -> Drive:
    text = read_settings(Path(path), "a drive", "give the path of a CSV file, from the folder of the plan")
    lines = text.splitlines()
    if len(lines) > MOST_ROWS:
        raise OptionError(f"{path} has more than {MOST_ROWS:,} lines; thin it out")
    numbered = [(number, line) for number, line in enumerate(lines, 1) if line.strip() and not line.startswith("#")]
    names, *records = [[cell.strip() for cell in record] for record in csv.reader(line for _, line in numbered)] or [[]]
    if "time_s" not in names or not set(names) <= {*COLUMNS} or len({*names}) < max(2, len(names)):
        unknown = f" ({', '.join(names)})" if "time_s" in names else ""  # nothing of a file that is no drive is printed
        raise OptionError(
            f"{path}: the first line{unknown} does not name columns of a drive; write {','.join(COLUMNS)}"
        )
    rows = [_row(f"{path}:{number}", names, record) for (number, _), record in zip(numbered[1:], records, strict=True)]
    times = [row[0] for row in rows]
    if len(rows) < 2 or times[0] != 0:
        raise OptionError(f"{path} has {counted(len(rows), 'row')}; write at least two, the first at time_s 0")
    for (number, _), before, after in zip(numbered[2:], times, times[1:], strict=False):
        if after <= before:
            raise OptionError(f"{path}:{number}: time_s {after:g} does not follow {before:g}; sort the rows by time")
    return Drive(tuple(rows), "rate_mbit_s" in names, hashlib.sha256(text.encode()).hexdigest())


def _row(where: str, names: list[str], record: list[str]) -> Row:
    if len(record) != len(names):
        raise OptionError(f"{where} has {counted(len(record), 'value')} for {len(names)} columns; write one for each")
    values = dict.fromkeys(COLUMNS, 0.0)
    for name, text in zip(names, record, strict=True):
        try:
            values[name] = float(text)
        except ValueError:
            raise OptionError(f"{where}: {name} is {limits.shown(text)}, not a number") from None
        fault = _LIMITS[COLUMNS.index(name)].fault(values[name])
        if fault is not None:
            raise OptionError(f"{where}: {name} is {text}; {fault}")
    return values["time_s"], values["rate_mbit_s"], values["delay_ms"], values["loss_percent"], values["jitter_ms"]


@dataclass(frozen=True, slots=True)
class Link:
    """One emulated link, equal in both directions; a field at its default is not applied."""

    name: str = plan_key(
        "custom",
        limits.FILE_NAME,
        "name of the link; the trace's `connectivity` is `emulated-NAME`",
        default_words="the preset's, with `-changed` if values differ, else `custom`",
    )
    rate_mbit_s: float = plan_key(
        0.0,
        limits.LINE_MBIT_S,
        "line rate of each direction, 0 for the machine's; by tbf, where a full line blocks the sender",
        unit="Mbit/s",
    )
    delay_ms: float = plan_key(
        0.0,
        limits.DELAY_MS,
        "delay of one direction; by netem where the kernel has it, else by our forwarder",
        unit="ms",
    )
    jitter_ms: float = plan_key(
        0.0,
        limits.DELAY_MS,
        "standard deviation of the delay (normal, not below zero); frames keep their order",
        unit="ms",
    )
    loss_percent: float = plan_key(
        0.0, limits.PERCENT, "share of lost IP fragments, independent of each other, before reassembly", unit="%"
    )
    loss_burst: float = plan_key(
        0.0,
        limits.BURST,
        "mean number of fragments that are lost in a row (a chain of two states), 0 for independent losses",
    )
    shared: bool = plan_key(
        False,
        limits.FLAG,
        "whether both directions share the rate, as in the air: by ifb and tbf, with delay or loss by our forwarder's queue",
    )
    outage_every_s: float = plan_key(
        0.0, limits.WAIT_S, "time from one outage to the next, by our forwarder; needs `outage_ms`", unit="s"
    )
    outage_ms: float = plan_key(
        0.0, limits.DELAY_MS, "length of each outage, in which every frame is lost; needs `outage_every_s`", unit="ms"
    )
    queue_ms: float = plan_key(
        100.0, limits.DELAY_MS, "longest wait of a frame for a full line; later ones are dropped (tail drop)", unit="ms"
    )
    file: str = plan_key(
        "",
        limits.TEXT,
        "CSV file of rate, delay, loss and jitter over time, from the folder of the plan; each run repeats it from its start "
        "([drives](../how-to/sweep.md#a-link-from-a-file))",
        default_words="none",
    )

    @property
    def drive(self) -> Drive | None:
        return read_drive(self.file) if self.file else None

    @property
    def connectivity(self) -> str:
        return f"emulated-{self.name}"

    @property
    def needs_only_rate(self) -> bool:
        return not (self.delay_ms or self.jitter_ms or self.loss_percent or self.outage_ms or self.file)

    def load(self, mbit_s: float) -> float:
        """0 where its rate is not known."""
        return mbit_s * (2 if self.shared else 1) / self.rate_mbit_s if self.rate_mbit_s else 0.0

    def load_words(self, mbit_s: float) -> str:
        carried = self.rate_mbit_s / (2 if self.shared else 1)
        return f"the messages need {mbit_s:.3g} Mbit/s each way, the link carries {carried:.3g}"

    def to_dict(self) -> dict[str, str | float]:
        values = asdict(self)
        path = values.pop("file")  # keys of later versions
        for name in ("loss_burst", "shared"):
            if not values[name]:
                del values[name]
        return values if self.drive is None else {**values, "file": Path(path).name, "sha256": self.drive.sha256}

    @property
    def setting(self) -> str:
        applied = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "name"}
        file = applied.pop("file")
        if self.drive is not None:
            return f"{self.name}(file={Path(file).name}#{self.drive.sha256[:8]},queue_ms={self.queue_ms:g})"
        values = ",".join(f"{name}={value:g}" for name, value in sorted(applied.items()) if value)
        return f"{self.name}({values})"

    def __str__(self) -> str:
        return link_words(self.setting)


class EndCounters(TypedDict):
    sent_bytes: int
    sent_packets: int
    dropped_packets: int


ForwarderReport: TypeAlias = "dict[str, dict[str, float | None]]"
"""Direction (`from_ping`, `from_relay`) -> frames by fate, and lateness in microseconds (`Wire.report`)."""


class LinkReport(TypedDict):
    monotonic_ns: int
    link: dict[str, str | float] | None
    applied_by: str
    commands: list[str]
    ping: EndCounters
    relay: EndCounters
    forwarder: ForwarderReport | None
    drive_started_ns: int | None


PRESETS: Mapping[str, Link] = {
    link.name: link
    for link in (
        Link("ethernet-1g", rate_mbit_s=1000),
        Link("ethernet-100m", rate_mbit_s=100),
        Link("air-30", rate_mbit_s=30, shared=True, queue_ms=400),  # what 802.11n at 2.4 GHz leaves to data
        # 802.11g/a at its highest rate. In the air both directions share it (`shared`); here each has it.
        Link("wifi-54", rate_mbit_s=54, delay_ms=1, jitter_ms=0.5, loss_percent=0.1),
        Link("wifi-poor", rate_mbit_s=12, delay_ms=5, jitter_ms=5, loss_percent=2, outage_every_s=10, outage_ms=300),
        Link("5g", rate_mbit_s=100, delay_ms=10, jitter_ms=3, loss_percent=0.01),
    )
}
"""Typical links, not standards; a plan's `[link]` may change single values."""

LINES = tuple(name for name, link in PRESETS.items() if link.needs_only_rate)
"""Values of the axis `link`: one pair of namespaces can change from one to the other."""
