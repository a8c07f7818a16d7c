"""Checks of the devices: clocks that jump, stop or drift, processors that are overloaded."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING

import polars as pl

from dds_trace.tracefile.units.counts import counted
from dds_trace.tracefile.units.durations import format_ms

from ..clocks.boots import ping_boots
from ..model.finding import Finding, Severity

if TYPE_CHECKING:
    from collections.abc import Iterator

    from .evidence import Evidence

_DRIFT_PPB = 100_000
"""Drift of a crystal at most, 100 ppm; a larger one is a clock that is slewed, or a fault."""

_SHORTEST_SLEEP_NS = 1_000_000_000
"""Shortest time in which a device goes to sleep and wakes."""

_SATURATED_PERCENT = 95.0
_SATURATED_SHARE = 0.1
"""Share of samples with a busy processor from which on it delays messages, though no median shows it."""


@dataclass(frozen=True, slots=True)
class _Step:
    """A step between the clocks of two devices.

    Attributes:
        ping_device: name of the ping's device.
        relay_device: name of the relay's device.
        before_ns: first message after the step, ping's monotonic clock.
        size_ns: how far the relay's clock jumped against the ping's.
        bound_ns: the size is wrong by at most this.
        asleep: the device whose clock stood still; None if neither did.
    """

    ping_device: str
    relay_device: str
    before_ns: int
    size_ns: int
    bound_ns: int
    asleep: str | None


def suspends(evidence: Evidence) -> Iterator[Finding]:
    """Report devices that slept: the monotonic clock stood still while the processes went on."""
    for step in _steps(evidence):
        if step.asleep is not None:
            yield Finding(
                Severity.WARNING,
                "suspend",
                f"{step.asleep} ({step.relay_device} against {step.ping_device})",
                f"Its clock stood still for {abs(step.size_ns) / 1e9:.3f} s (within {step.bound_ns / 1e9:.3f} s) before "
                f"{step.before_ns / 1e9:.1f} s of the ping's clock, and the "
                "relay ran on: the device, or its virtual machine, was suspended.",
                "Repeat the runs about that time with suspending switched off: messages were lost or late for it. If "
                "the stamps are not of CLOCK_MONOTONIC, that clock was set.",
            )


def clock_steps(evidence: Evidence) -> Iterator[Finding]:
    """Report clocks that jumped against the other device's: a restart, or stamps of another clock."""
    for step in _steps(evidence):
        if step.asleep is None:
            yield Finding(
                Severity.WARNING,
                "clock_step",
                f"{step.relay_device} against {step.ping_device}",
                f"The clock jumped by {format_ms(step.size_ns)} ms (within {format_ms(step.bound_ns)} ms) "
                f"before {step.before_ns / 1e9:.1f} s of the ping's clock.",
                "One-way times are fitted apart before and after; a message under way at the jump has a wrong round "
                "trip. Do not restart devices while recording.",
            )


def _steps(evidence: Evidence) -> Iterator[_Step]:
    """Yield the steps in `clock_fits`.

    A clock that runs steadily while its device is up can only stand still. So a step of a second or more over which
    one relay process went on is sleep: the relay's if its clock fell back, the ping's if it got ahead. (Each fit is
    of one boot of the ping.)
    """
    boots = ping_boots(evidence.campaign.sessions.values(), evidence.campaign.runs.values())
    knots = evidence.details.clock_knots.sort("at_ns")
    for fit in evidence.details.clock_fits.drop_nulls("step_before_ns").iter_rows(named=True):
        own = knots.filter(
            pl.col("relay_boot").eq_missing(pl.lit(fit["relay_boot"], pl.String)),
            ping_device=fit["ping_device"],
            relay_device=fit["relay_device"],
        )
        in_boot = [boots.get(run_id, 0) == fit["boot"] for run_id in own["run_id"]]
        of_boot = own.filter(pl.Series(in_boot, dtype=pl.Boolean))
        before, after = (
            of_boot.filter(side)
            for side in (pl.col("at_ns") < fit["start_ns"], pl.col("at_ns") >= fit["start_ns"])
        )
        size_ns, bound_ns = fit["step_before_ns"], fit["step_bound_ns"]
        went_on = before.height and after.height and before["relay_id"][-1] == after["relay_id"][0]
        slept = went_on and abs(size_ns) - bound_ns >= _SHORTEST_SLEEP_NS
        asleep = fit["relay_device"] if size_ns < 0 else fit["ping_device"]
        yield _Step(
            ping_device=fit["ping_device"],
            relay_device=fit["relay_device"],
            before_ns=fit["start_ns"],
            size_ns=size_ns,
            bound_ns=bound_ns,
            asleep=asleep if slept else None,
        )


def clock_drifts(evidence: Evidence) -> Iterator[Finding]:
    """Report pairs of clocks that surely part faster than crystals do."""
    for fit in evidence.details.clock_fits.iter_rows(named=True):
        if abs(fit["drift_ppb"]) - fit["drift_bound_ppb"] > _DRIFT_PPB:
            yield Finding(
                Severity.WARNING,
                "clock_drift",
                f"{fit['relay_device']} against {fit['ping_device']}",
                f"The clocks part by {fit['drift_ppb'] / 1000:.1f} ppm (within {fit['drift_bound_ppb'] / 1000:.1f}), "
                "more than crystals do.",
                "Let NTP settle before recording; durations of one of the devices are wrong by that share.",
            )


def cpu_saturation(evidence: Evidence) -> Iterator[Finding]:
    """Report devices with a processor that was busy in many samples."""
    busy: dict[int, list[float]] = defaultdict(list)
    samples = evidence.details.host_samples.select("session_id", "cpu_busiest_percent").drop_nulls()
    for session_id, percent in samples.iter_rows():
        busy[session_id].append(percent)
    for session_id, percents in busy.items():
        full = sum(percent >= _SATURATED_PERCENT for percent in percents)
        if full > _SATURATED_SHARE * len(percents):
            yield Finding(
                Severity.WARNING,
                "cpu_saturated",
                evidence.session_name(evidence.campaign.sessions[session_id]),
                f"In {full} of {counted(len(percents), 'second')} a processor was busy to at least {_SATURATED_PERCENT:g} %.",
                "Latencies here hold time spent waiting for the processor: lower rate or size, or free the device.",
            )
