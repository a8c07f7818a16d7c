"""Checks of the clocks of devices: jumps, sleep, slews, and rates that no crystal has."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl

from dds_trace.tracefile.units.counts import counted
from dds_trace.tracefile.units.durations import format_ms

from ..clocks.boots import ping_boots
from ..clocks.lines import WINDOW_NS
from ..model.finding import Finding, Severity

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from .evidence import Evidence

_DRIFT_PPB = 100_000
"""Drift of a crystal at most, 100 ppm; a larger one is a clock that is slewed, or a fault."""

_SHORTEST_SLEEP_NS = 1_000_000_000
"""Shortest time in which a device goes to sleep and wakes."""

_SLEW_STEPS = 3
"""Steps the same way, each at most a window after the one before, that are one slew: nothing jumps again and again by chance."""

_SLEW_NS = 100_000
"""Gain on CLOCK_MONOTONIC_RAW within a window of ten seconds beyond the steady rate that is a slew. The frequency that NTP
holds moves by well under 1 ppm at once (10 us); 0.1 ms is what the offset of a fast link is known by. Of 2000 simulated
sessions of ten minutes, with readings that are off by 1 us and a frequency that wanders by 0.1 ppm every 16 s, none is
taken for slewed."""


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
        slewed: whether it is one of many the same way, which a slew beyond the fit's limit leaves.
    """

    ping_device: str
    relay_device: str
    before_ns: int
    size_ns: int
    bound_ns: int
    asleep: str | None
    slewed: bool


def suspends(evidence: Evidence) -> Iterator[Finding]:
    """Report devices that slept: the monotonic clock stood still while the processes went on."""
    for step in _steps(evidence):
        if step.asleep is not None and not step.slewed:
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
        if step.asleep is None and not step.slewed:
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
    slewed = {key for slew in _slews(evidence) for key in slew.steps}
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
            slewed=_step_key(fit) in slewed,
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


@dataclass(frozen=True, slots=True)
class _Slew:
    """A slew faster than the fit's limit, which the fit cuts into steps.

    Attributes:
        ping_device: name of the ping's device.
        relay_device: name of the relay's device.
        start_ns: when the best-known offset before it was, ping's monotonic clock.
        end_ns: when the best-known offset after it was.
        rate_ppm: rate at which the relay's clock gained on the ping's.
        bound_ppm: the rate is wrong by at most this.
        steps: keys of its steps (`_step_key`).
    """

    ping_device: str
    relay_device: str
    start_ns: int
    end_ns: int
    rate_ppm: float
    bound_ppm: float
    steps: tuple[tuple[object, ...], ...]


def slews(evidence: Evidence) -> Iterator[Finding]:
    """Report clocks that were slewed: one finding for a slew, however many steps the fit made of it.

    A slew beyond 500 ppm shows in the offsets of two devices; a slower one where a device's own CLOCK_MONOTONIC gains on
    its CLOCK_MONOTONIC_RAW, which nobody slews.
    """
    seen: set[str] = set()
    for slew in _slews(evidence):
        seen |= {slew.ping_device, slew.relay_device}
        yield Finding(
            Severity.WARNING,
            "slewed",
            f"{slew.relay_device} against {slew.ping_device}",
            f"The clock was slewed at {slew.rate_ppm:.0f} ppm (within {slew.bound_ppm:.2g}) for "
            f"{(slew.end_ns - slew.start_ns) / 1e9:.1f} s from {slew.start_ns / 1e9:.1f} s of the ping's clock: "
            f"{counted(len(slew.steps), 'step')} of the fit.",
            "Let NTP settle before recording; durations and one-way times of that time are wrong by that share.",
        )
    gains: dict[str, float] = {}
    for (device,), samples in evidence.details.host_samples.group_by(["device"], maintain_order=True):
        for (_,), of_session in samples.group_by(["session_id"], maintain_order=True):
            pair = of_session.drop_nulls(["monotonic_ns", "monotonic_raw_ns"])
            monotonic_ns, raw_ns = (pair[n].to_numpy() for n in ("monotonic_ns", "monotonic_raw_ns"))
            rate_ppm = _slewed_ppm(monotonic_ns, raw_ns)
            if abs(rate_ppm) > abs(gains.get(str(device), 0.0)):
                gains[str(device)] = rate_ppm
    for device, rate_ppm in gains.items():
        if device not in seen:
            yield Finding(
                Severity.INFO,
                "slewed",
                device,
                f"Its monotonic clock was slewed at {rate_ppm:.0f} ppm against CLOCK_MONOTONIC_RAW while this was recorded.",
                "Durations of that time are wrong by that share: let NTP settle before recording if that matters.",
            )


def _slewed_ppm(monotonic_ns: NDArray[np.int64], raw_ns: NDArray[np.int64]) -> float:
    """Return the fastest slew of a device's monotonic clock in parts per million, 0 if it ran steadily.

    Args:
        monotonic_ns: CLOCK_MONOTONIC of each host sample, rising, int64.
        raw_ns: CLOCK_MONOTONIC_RAW at the same instants.
    """
    if len(monotonic_ns) < _SLEW_STEPS:
        return 0.0
    elapsed_ns, gain_ns = (
        monotonic_ns - monotonic_ns[0],
        (monotonic_ns - monotonic_ns[0]) - (raw_ns - raw_ns[0]),
    )
    steady = float(np.median(np.diff(gain_ns) / np.maximum(np.diff(elapsed_ns), 1)))
    if abs(steady) * 1e9 > _DRIFT_PPB:  # slewed throughout
        return float(gain_ns[-1] / elapsed_ns[-1]) * 1e6
    after = np.minimum(np.searchsorted(elapsed_ns, elapsed_ns + WINDOW_NS), len(elapsed_ns) - 1)
    lasted_ns = np.maximum(elapsed_ns[after] - elapsed_ns, 1)
    beyond_ns = gain_ns[after] - gain_ns - steady * lasted_ns
    # Samples lie a second apart, but a gap in them must not gather what a steady frequency adds.
    is_window = (lasted_ns <= 2 * WINDOW_NS) & (np.abs(beyond_ns) >= _SLEW_NS)
    if not is_window.any():
        return 0.0
    fastest = int(np.argmax(np.where(is_window, np.abs(beyond_ns) / lasted_ns, 0)))
    return float(gain_ns[after[fastest]] - gain_ns[fastest]) / float(lasted_ns[fastest]) * 1e6


_PAIR = ("ping_device", "relay_device", "boot", "relay_boot")


def _step_key(fit: dict[str, Any]) -> tuple[object, ...]:
    """Return what names a step: its pair of devices, their boots, and the segment that it began."""
    return *(fit[name] for name in _PAIR), fit["segment"]


def _slews(evidence: Evidence) -> Iterator[_Slew]:
    """Yield each chain of steps the same way in `clock_fits`."""
    fits = evidence.details.clock_fits
    for segments in fits.partition_by(*_PAIR, maintain_order=True):
        chain: list[dict[str, Any]] = []
        before: dict[str, Any] = {}
        for last, segment in pairwise(segments.iter_rows(named=True)):
            goes_on = (
                chain
                and segment["start_ns"] - chain[-1]["start_ns"] <= WINDOW_NS
                and (segment["step_before_ns"] > 0) == (chain[-1]["step_before_ns"] > 0)
            )
            if not goes_on:
                yield from _slew(before, chain)
                chain, before = [], last
            chain.append(segment)
        yield from _slew(before, chain)


def _slew(before: dict[str, Any], chain: list[dict[str, Any]]) -> Iterator[_Slew]:
    """Yield the slew that a chain of steps is, if it is long enough."""
    if len(chain) < _SLEW_STEPS:
        return
    last = chain[-1]
    lasted_ns = last["at_ns"] - before["at_ns"]
    yield _Slew(
        ping_device=last["ping_device"],
        relay_device=last["relay_device"],
        start_ns=before["at_ns"],
        end_ns=last["at_ns"],
        rate_ppm=(last["offset_ns"] - before["offset_ns"]) / lasted_ns * 1e6,
        bound_ppm=(last["bound_ns"] + before["bound_ns"]) / lasted_ns * 1e6,
        steps=tuple(_step_key(segment) for segment in chain),
    )
