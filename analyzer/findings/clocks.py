"""Checks of the clocks of two devices: steps, suspends, drift beyond what a crystal does."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import polars as pl

from ..clocks.boots import ping_boots
from ..model.finding import Finding, Severity

if TYPE_CHECKING:
    from collections.abc import Iterator

    from .evidence import Evidence

_DRIFT_PPB = 100_000
"""A crystal is off by less than 100 ppm; more is a clock that is being slewed, or a fault."""

_SHORTEST_SLEEP_NS = 1_000_000_000
"""No device goes to sleep and wakes in less."""


def suspends(evidence: Evidence) -> Iterator[Finding]:
    """A device slept: its monotonic clock stood still while neither process was started anew."""
    for fit, standing in _steps(evidence):
        if standing is not None:
            yield Finding(
                Severity.WARNING,
                "suspend",
                f"{standing} ({fit['relay_device']} against {fit['ping_device']})",
                f"Its clock stood still for {abs(fit['step_before_ns']) / 1e9:.3f} s (within "
                f"{fit['step_bound_ns'] / 1e9:.3f} s) before {fit['start_ns'] / 1e9:.1f} s of the ping's clock, and the "
                "relay ran on: the device, or its virtual machine, was suspended.",
                "Repeat the runs about that time with suspending switched off: messages were lost or late for it. If "
                "the stamps are not of CLOCK_MONOTONIC, that clock was set.",
            )


def clock_steps(evidence: Evidence) -> Iterator[Finding]:
    """One device's clock jumped against the other's: it was restarted, or its stamps are of another clock."""
    for fit, standing in _steps(evidence):
        if standing is None:
            yield Finding(
                Severity.WARNING,
                "clock_step",
                f"{fit['relay_device']} against {fit['ping_device']}",
                f"The clock jumped by {fit['step_before_ns'] / 1e6:.3f} ms (within {fit['step_bound_ns'] / 1e6:.3f} ms) "
                f"before {fit['start_ns'] / 1e9:.1f} s of the ping's clock.",
                "One-way times are fitted apart before and after; a message under way at the jump has a wrong round "
                "trip. Do not restart devices while recording.",
            )


def _steps(evidence: Evidence) -> Iterator[tuple[dict[str, Any], str | None]]:
    """The rows of `clock_fits` that begin with a step, each with the device whose clock stood still, if one did.

    A clock that runs steadily while its device is up can only stand still. So a step of a second or more over which
    one relay process went on is sleep: the relay's if its clock fell back, the ping's if it got ahead. (Each fit is
    of one boot of the ping.)
    """
    boots = ping_boots(evidence.campaign.sessions.values(), evidence.campaign.runs.values())
    knots = evidence.details.clock_knots.sort("at_ns")
    for fit in evidence.details.clock_fits.drop_nulls("step_before_ns").iter_rows(named=True):
        own = knots.filter(ping_device=fit["ping_device"], relay_device=fit["relay_device"])
        in_boot = [boots.get(run_id, 0) == fit["boot"] for run_id in own["run_id"]]
        of_boot = own.filter(pl.Series(in_boot, dtype=pl.Boolean))
        before, after = (
            of_boot.filter(side)
            for side in (pl.col("at_ns") < fit["start_ns"], pl.col("at_ns") >= fit["start_ns"])
        )
        went_on = before.height and after.height and before["relay_id"][-1] == after["relay_id"][0]
        slept = abs(fit["step_before_ns"]) - fit["step_bound_ns"] >= _SHORTEST_SLEEP_NS
        asleep = fit["relay_device"] if fit["step_before_ns"] < 0 else fit["ping_device"]
        yield fit, asleep if went_on and slept else None


def clock_drifts(evidence: Evidence) -> Iterator[Finding]:
    """Two clocks surely part faster than crystals do."""
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
