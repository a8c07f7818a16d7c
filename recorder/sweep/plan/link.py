"""An emulated link between two network namespaces: values, presets, and its report."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TypeAlias, TypedDict

from dds_trace.base import limits

from .cells import plan_key
from .drive import Drive, read_drive


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
        parts = [
            f"{self.rate_mbit_s:g} Mbit/s{' in both directions together' * self.shared}" if self.rate_mbit_s else "",
            f"delay {self.delay_ms:g} ms" if self.delay_ms else "",
            f"jitter {self.jitter_ms:g} ms" if self.jitter_ms else "",
            f"loss {self.loss_percent:g} %{f' in bursts of {self.loss_burst:g}' * bool(self.loss_burst)}"
            if self.loss_percent
            else "",
            f"outage {self.outage_ms:g} ms every {self.outage_every_s:g} s" if self.outage_ms else "",
            f"as {Path(self.file).name} says" if self.file else "",
        ]
        return f"{self.name} ({', '.join(part for part in parts if part) or 'nothing shaped'})"


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
