"""Checks of the clocks of devices: jumps, sleep, slews, and rates that no crystal has."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import polars as pl

from dds_trace.base.units import counted, format_ms

from ..clocks.slews import CRYSTAL_PPB, slewed_ppm
from ..model.finding import Finding, Severity

if TYPE_CHECKING:
    from collections.abc import Iterator

    from .evidence import Evidence


_FREE_PROCESSORS = 0.5
"""Free processors of the machine, mean of a second, below which a woken thread often finds none: with one of 64 busy, 63 are."""

_FULL_PERCENT = 95.0
"""Share of one processor from which on the recording process has none left: Python runs on one at a time."""

_SATURATED_SHARE = 0.1
"""Share of seconds from which on it delays messages that percentiles show, though no median does."""

_SATURATED_SECONDS = 2
"""Seconds at least: the first one of a short recording holds its start."""


def cpu_saturation(evidence: Evidence) -> Iterator[Finding]:
    """Report recordings in many seconds of which the machine, or the one processor of the process, was full."""
    full = (pl.col("cpu_free_processors") < _FREE_PROCESSORS, pl.col("node_cpu_percent") >= _FULL_PERCENT)
    words = (
        f"the machine had less than {_FREE_PROCESSORS:g} processors free",
        f"the recording process filled a processor to at least {_FULL_PERCENT:g} %",
    )
    counts = evidence.details.host_samples.group_by("session_id", maintain_order=True).agg(
        pl.len().alias("seconds"), *(each.sum().alias(str(cause)) for cause, each in enumerate(full))
    )
    for session_id, seconds, *of_cause in counts.iter_rows():
        most = max(of_cause)
        if most >= _SATURATED_SECONDS and most > _SATURATED_SHARE * seconds:
            yield Finding(
                Severity.WARNING,
                "cpu_saturated",
                evidence.session_name(evidence.campaign.sessions[session_id]),
                f"In {most} of {counted(seconds, 'second')} {words[of_cause.index(most)]}.",
                "Latencies here hold time spent waiting for the processor: lower rate or size, or free the device.",
                evidence.groups_of_sessions.get(session_id, ()),
                effect=most / seconds,
            )


_SHORTEST_SLEEP_NS = 1_000_000_000
"""Shortest time in which a device goes to sleep and wakes."""


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
    for pair in evidence.device_pairs:
        slewed = {position for slew in pair.slews for position in range(slew.first, slew.after)}
        at_ns, relay_id = pair.knots["at_ns"], pair.knots["relay_id"]
        for position, fit in enumerate(pair.segments):
            if fit["step_before_ns"] is None:
                continue
            after = at_ns.search_sorted(fit["start_ns"], side="left")
            size_ns, bound_ns = fit["step_before_ns"], fit["step_bound_ns"]
            went_on = 0 < after < len(at_ns) and relay_id[after - 1] == relay_id[after]
            slept = went_on and abs(size_ns) - bound_ns >= _SHORTEST_SLEEP_NS
            asleep = fit["relay_device"] if size_ns < 0 else fit["ping_device"]
            yield _Step(
                ping_device=fit["ping_device"],
                relay_device=fit["relay_device"],
                before_ns=fit["start_ns"],
                size_ns=size_ns,
                bound_ns=bound_ns,
                asleep=asleep if slept else None,
                slewed=position in slewed,
            )


def clock_drifts(evidence: Evidence) -> Iterator[Finding]:
    """Report pairs of clocks that surely part faster than crystals do; a slew's segments are its finding's."""
    for pair in evidence.device_pairs:
        slewed = {position for slew in pair.slews for position in range(slew.first - 1, slew.after)}
        for position, fit in enumerate(pair.segments):
            if position not in slewed and abs(fit["drift_ppb"]) - fit["drift_bound_ppb"] > CRYSTAL_PPB:
                yield Finding(
                    Severity.WARNING,
                    "clock_drift",
                    f"{fit['relay_device']} against {fit['ping_device']}",
                    f"The clocks part by {fit['drift_ppb'] / 1000:.1f} ppm (within {fit['drift_bound_ppb'] / 1000:.1f}), "
                    "more than crystals do.",
                    "Let NTP settle before recording; durations of one of the devices are wrong by that share.",
                )


def slews(evidence: Evidence) -> Iterator[Finding]:
    """Report clocks that were slewed: one finding for a slew, however many steps the fit made of it.

    A slew beyond 500 ppm shows in the offsets of two devices; a slower one where a device's own CLOCK_MONOTONIC gains on
    its CLOCK_MONOTONIC_RAW, which nobody slews.
    """
    seen: set[str] = set()
    for pair in evidence.device_pairs:
        ping_device, relay_device = (pair.segments[0][f"{role}_device"] for role in ("ping", "relay"))
        for slew in pair.slews:
            seen |= {ping_device, relay_device}
            yield Finding(
                Severity.WARNING,
                "slewed",
                f"{relay_device} against {ping_device}",
                f"The clock was slewed at {slew.rate_ppm:.0f} ppm (within {slew.bound_ppm:.2g}) for "
                f"{(slew.end_ns - slew.start_ns) / 1e9:.1f} s from {slew.start_ns / 1e9:.1f} s of the ping's clock: "
                f"{counted(slew.after - slew.first, 'step')} of the fit.",
                "Let NTP settle before recording; durations and one-way times of that time are wrong by that share.",
            )
    gains: dict[str, float] = {}
    for (device,), samples in evidence.details.host_samples.group_by(["device"], maintain_order=True):
        for (_,), of_session in samples.group_by(["session_id"], maintain_order=True):
            both = of_session.drop_nulls(["monotonic_ns", "monotonic_raw_ns"])
            rate_ppm = slewed_ppm(*(both[n].to_numpy() for n in ("monotonic_ns", "monotonic_raw_ns")))
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
