"""Checks of the clocks of two devices: steps, suspends, drift beyond what a crystal does."""

from __future__ import annotations

from typing import TYPE_CHECKING

from analyzer.analysis import Finding, Severity

if TYPE_CHECKING:
    from collections.abc import Iterator

    from analyzer.evidence import Evidence

_DRIFT_PPB = 100_000
"""A crystal is off by less than 100 ppm; more is a clock that is being slewed, or a fault."""


def clock_steps(evidence: Evidence) -> Iterator[Finding]:
    """One device's clock jumped against the other's: it was suspended or restarted, or its stamps are of another clock."""
    if evidence.details is None:
        return
    for fit in evidence.details.clock_fits.drop_nulls("step_before_ns").iter_rows(named=True):
        yield Finding(
            Severity.WARNING,
            "clock_step",
            f"{fit['relay_device']} against {fit['ping_device']}",
            f"The clock jumped by {fit['step_before_ns'] / 1e6:.3f} ms (within {fit['step_bound_ns'] / 1e6:.3f} ms) "
            f"before {fit['start_ns'] / 1e9:.1f} s of the ping's clock.",
            "One-way times are fitted apart before and after; a message under way at the jump has a wrong round "
            "trip. Keep devices from suspending while recording.",
        )


def clock_drifts(evidence: Evidence) -> Iterator[Finding]:
    """Two clocks surely part faster than crystals do."""
    if evidence.details is None:
        return
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
