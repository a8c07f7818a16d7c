"""Busy processors, and clocks that step, sleep, drift or are slewed."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import polars as pl

from dds_trace.base.units import counted, format_duration
from dds_trace.tracefile.format.json_fields import number_of, object_of

from ..clocks.boots import share_boot
from ..clocks.slews import CRYSTAL_PPB, slewed_ppm
from ..model.finding import Subject
from .evidence import Evidence, Observation, note, warning
from .rows import Rows, frame_of, named

_SHORTEST_SLEEP_NS = 1_000_000_000
"""Shortest time in which a device goes to sleep and wakes."""


def _steps(evidence: Evidence) -> pl.DataFrame:
    """List the steps that no slew made.

    A running device's monotonic clock can only stand still, so a step of a second or more during one relay process
    is sleep: the relay's if its clock fell back, else the ping's.
    """
    rows = []
    for pair in evidence.device_pairs:
        slewed = {index for slew in pair.slews for index in range(slew.first, slew.after)}
        at_ns, relay_id = pair.knots["at_ns"], pair.knots["relay_id"]
        for index, fit in enumerate(pair.segments):
            if fit["step_before_ns"] is None or index in slewed:
                continue
            after = at_ns.search_sorted(fit["start_ns"], side="left")
            size_ns, bound_ns = fit["step_before_ns"], fit["step_bound_ns"]
            went_on = 0 < after < len(at_ns) and relay_id[after - 1] == relay_id[after]
            slept = went_on and abs(size_ns) - bound_ns >= _SHORTEST_SLEEP_NS
            asleep = fit["relay_device"] if size_ns < 0 else fit["ping_device"]
            devices = f"{fit['relay_device']} against {fit['ping_device']}"
            rows.append(
                {
                    "where": f"{asleep} ({devices})" if slept else devices,
                    "slept": slept,
                    "before_s": fit["start_ns"] / 1e9,
                    "size_ns": size_ns,
                    "lasted_ns": abs(size_ns),
                    "bound_ns": bound_ns,
                }
            )
    return frame_of(rows)


STEPS = Rows(Subject.DEVICE, _steps, named)

_SET_NS = 1_000_000_000
"""Largest change of the wall clock against the monotonic one between two recordings that NTP makes by slewing."""


def _set_clocks(evidence: Evidence) -> pl.DataFrame:
    sessions = sorted(evidence.campaign.sessions.values(), key=lambda one: (one.device, one.monotonic_anchor_ns))
    steps = []
    for before, after in pairwise(sessions):
        wall_ns = after.wall_anchor_ns - before.wall_anchor_ns
        set_ns = wall_ns - (after.monotonic_anchor_ns - before.monotonic_anchor_ns)
        is_one_machine = after.device == before.device and share_boot(before, after)
        # In another time namespace it is the monotonic clock that jumped.
        if is_one_machine and abs(set_ns) > _SET_NS and (set_ns > 0 or wall_ns < 0):
            steps.append((after, set_ns, "before"))
    for reading in evidence.topics.wall_readings:
        at = int(abs(reading.steps_ns).argmax())
        after_s = (reading.first_ns[at] - reading.session.monotonic_anchor_ns) / 1e9
        steps.append((reading.session, int(reading.steps_ns[at]), f"{after_s:.0f} s after the start of"))
    rows = [
        {
            "where": session.device,
            "when": f"{when} {evidence.session_name(session)}",
            "way": "forward" if set_ns > 0 else "back",
            "size_ns": abs(set_ns),
        }
        for session, set_ns, when in steps
        if set_ns
    ]
    return frame_of(rows)


SET_CLOCKS = Rows(Subject.DEVICE, _set_clocks, named)


def _times_of_topics(evidence: Evidence) -> pl.DataFrame:
    topics = evidence.topics.topic_messages.group_by("data_type", "ping_device", "relay_device", maintain_order=True)
    return topics.agg(
        early=(pl.col("one_way_ns") < -pl.col("bound_ns")).sum(), messages=pl.len(), least_ns=pl.col("one_way_ns").min()
    ).with_columns(where=pl.format("{}, {} to {}", "data_type", "ping_device", "relay_device"))


TIMES_OF_TOPICS = Rows(Subject.DEVICE, _times_of_topics, named)


@warning(
    "slewed",
    Subject.DEVICE,
    "Letting NTP settle before recording may help; durations and one-way times of that time are wrong by that share.",
)
def slews(evidence: Evidence) -> Iterator[Observation]:
    """A clock was slewed against the other device's."""
    for pair in evidence.device_pairs:
        first = pair.segments[0]
        for slew in pair.slews:
            yield Observation(
                f"{first['relay_device']} against {first['ping_device']}",
                f"The clock was slewed at {slew.rate_ppm:.0f} ppm (within {slew.bound_ppm:.2g}) for "
                f"{(slew.end_ns - slew.start_ns) / 1e9:.1f} s from {slew.start_ns / 1e9:.1f} s of the ping's clock: "
                f"{counted(slew.after - slew.first, 'step')} of the fit.",
            )


@note(
    "slewed",
    Subject.DEVICE,
    "Durations of that time are wrong by that share: letting NTP settle before recording may help.",
)
def slow_slews(evidence: Evidence) -> Iterator[Observation]:
    """A clock was slewed against CLOCK_MONOTONIC_RAW."""
    segments = (pair.segments[0] for pair in evidence.device_pairs if pair.slews)
    reported = {first[f"{role}_device"] for first in segments for role in ("ping", "relay")}
    gains: dict[str, float] = {}
    sessions = evidence.details.host_samples.group_by(["device", "session_id"], maintain_order=True)
    for (device, _), samples in sessions:
        clocks = samples.drop_nulls(["monotonic_ns", "monotonic_raw_ns"])
        rate_ppm = slewed_ppm(*(clocks[n].to_numpy() for n in ("monotonic_ns", "monotonic_raw_ns")))
        if abs(rate_ppm) > abs(gains.get(str(device), 0.0)):
            gains[str(device)] = rate_ppm
    for device, rate_ppm in gains.items():
        if device not in reported:
            yield Observation(
                device,
                f"Its monotonic clock was slewed at {rate_ppm:.0f} ppm against CLOCK_MONOTONIC_RAW during the recording.",
            )


@warning(
    "clock_drift",
    Subject.DEVICE,
    "Letting NTP settle before recording may help; durations of one of the devices are wrong by that share.",
)
def clock_drifts(evidence: Evidence) -> Iterator[Observation]:
    """Two clocks drift apart faster than crystals do."""
    for pair in evidence.device_pairs:
        slewed = {index for slew in pair.slews for index in range(slew.first - 1, slew.after)}
        for index, fit in enumerate(pair.segments):
            if index not in slewed and abs(fit["drift_ppb"]) - fit["drift_bound_ppb"] > CRYSTAL_PPB:
                yield Observation(
                    f"{fit['relay_device']} against {fit['ping_device']}",
                    f"The clocks drift apart by {fit['drift_ppb'] / 1000:.1f} ppm "
                    f"(within {fit['drift_bound_ppb'] / 1000:.1f}), more than crystals do.",
                )


_FREE_PROCESSORS = 0.5
"""Below this a woken thread often gets no processor."""

_FULL_PERCENT = 95.0
"""Share of one processor, on which Python runs, at which the recording process is full."""

_SATURATED_SHARE = 0.1
"""Share of seconds above which percentiles, though no median, show saturation."""

_SATURATED_SECONDS = 2
"""Least saturated seconds: the first one of a recording is its start."""


@warning(
    "cpu_saturated",
    Subject.RECORDING,
    "Latencies here include waiting for the processor: a lower rate or size, or a free device, may help.",
)
def cpu_saturation(evidence: Evidence) -> Iterator[Observation]:
    """The machine or the recording process ran out of processor time."""
    full = (pl.col("cpu_free_processors") < _FREE_PROCESSORS, pl.col("node_cpu_percent") >= _FULL_PERCENT)
    words = (
        f"the machine had less than {_FREE_PROCESSORS:g} processors free",
        f"the recording process filled a processor to at least {_FULL_PERCENT:g} %",
    )
    counts = evidence.details.host_samples.group_by("session_id", maintain_order=True).agg(
        pl.len().alias("seconds"), *(is_full.sum().alias(str(cause)) for cause, is_full in enumerate(full))
    )
    for session_id, seconds, *saturated in counts.iter_rows():
        most = max(saturated)
        if most >= _SATURATED_SECONDS and most > _SATURATED_SHARE * seconds:
            yield evidence.recording(
                evidence.campaign.sessions[session_id],
                f"In {most:,} of {counted(seconds, 'second')} {words[saturated.index(most)]}.",
                most / seconds,
            )


_COARSE_STEPS = 20
"""With fewer clock steps, a median round trip is known to no better than 5 %."""


@warning(
    "coarse_clock",
    Subject.RECORDING,
    "Do not use times of a few steps; another clock source of the kernel may help "
    "(/sys/devices/system/clocksource/clocksource0/available_clocksource).",
)
def coarse_clocks(evidence: Evidence) -> Iterator[Observation]:
    """A clock advances in steps that are long for these times."""
    medians_ns = evidence.summary.frame["rtt_p50_ns"].to_list()
    for session in evidence.campaign.sessions.values():
        step_ns = number_of(object_of(session.extra.get("clock")).get("resolution_ns")) or 0
        groups = [
            group
            for group in evidence.groups_of_sessions.get(session.session_id, ())
            if medians_ns[group] is not None and medians_ns[group] < _COARSE_STEPS * step_ns
        ]
        if groups:
            least_ns = min(medians_ns[group] for group in groups)
            yield Observation(
                evidence.session_name(session),
                f"Its clock advances in steps of {format_duration(step_ns)}, and the median round trip is "
                f"{format_duration(least_ns)}: nothing below a step is known.",
                tuple(groups),
            )
