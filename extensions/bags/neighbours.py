"""What topics of one recording show of each other: silences of all of them, who stood still, which clock was set."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dds_trace.base.units import SECOND_NS, clock_words, counted, format_duration

from .bounds import FEW, FEWEST, NEAR, NOTICED_NS, PATTERN
from .clocks import Note
from .holes import Holes
from .losses import Losses, Reading, TopicTimes
from .periods import Bools, Float64, Int64, Regularity
from .quantiles import median


def find_silent(logged: Int64, topics: int) -> Holes:
    steps_ns = np.diff(logged)
    if topics < 2 or not len(steps_ns):
        return Holes()
    gaps = np.flatnonzero(steps_ns > max(2 * NOTICED_NS, PATTERN * median(steps_ns)))
    return Holes.between(logged[gaps].tolist(), logged[gaps + 1].tolist())


def moved_on(times: Sequence[TopicTimes], silent: Holes) -> tuple[Bools, Bools]:
    """Return across which stretches some topic has stamps, and across which such stamps move on by half of the time at least."""
    inner = replace(silent, start_ns=silent.start_ns + 1)
    is_stamped, has_moved = np.zeros(len(silent), np.bool_), np.zeros(len(silent), np.bool_)
    for topic in times if len(silent) else ():
        around, still = topic.has_stamps_around(silent), topic.is_still(inner)
        is_stamped |= around
        has_moved |= around & ~still
    return is_stamped, has_moved


def stood_still(times: Sequence[TopicTimes], silent: Holes) -> Holes:
    """Return the stretches over which the stamps of every topic that has some stand still: a simulation that is paused or reset sends nothing."""
    is_stamped, has_moved = moved_on(times, silent)
    return silent.at(is_stamped & ~has_moved)


def set_clocks(readings: Sequence[Sequence[Reading]], silent: Holes, start_ns: int) -> tuple[Holes, list[Note]]:
    """Return stretches over which the recorder's clock was set: the silences of three timers at least are equal to within their jitter.

    Of what a recorder lost, each would lack whole periods of its own; the silence has to be no multiple of one of them.
    """
    moved = []
    for topic in readings if len(silent) else ():
        for reading in topic:
            holes = reading.holes
            if reading.name != "period" or reading.rhythm is None or not len(holes):
                continue
            within_ns, off_ns = _off_multiples(reading.rhythm)
            at = np.minimum(np.searchsorted(holes.end_ns, silent.start_ns, "right"), len(holes) - 1)
            is_met = holes.start_ns[at] < silent.end_ns
            if within_ns < NEAR * reading.rhythm.period_ns:
                moved.append(np.where(is_met, [holes.duration_ns[at], np.full(len(at), within_ns), off_ns[at]], np.nan))
    if len(moved) <= 2:
        return Holes(), []
    by_ns, within_ns, off_ns = np.array(moved).transpose(1, 0, 2)
    is_met = ~np.isnan(by_ns)
    with np.errstate(all="ignore"):
        least = np.where(is_met, by_ns, np.inf).min(axis=0)
        most = np.where(is_met, by_ns, -np.inf).max(axis=0)
        is_set = (is_met.sum(axis=0) > 2) & (most - least <= np.where(is_met, within_ns, 0).max(axis=0))
        is_set &= (off_ns > within_ns).any(axis=0)
    notes = [
        Note(
            f"the recorder's clock was set forward by {format_duration(by)} at {clock_words((at - start_ns) / SECOND_NS)}: "
            f"{counted(count, 'timer')} moved alike, nothing is missing there"
        )
        for at, by, count in zip(
            silent.start_ns[is_set].tolist(), least[is_set].tolist(), is_met.sum(axis=0)[is_set].tolist(), strict=True
        )
    ]
    return silent.at(is_set), notes


def _off_multiples(rhythm: Regularity) -> tuple[float, Float64]:
    """Return within what the holes of a timer that lost messages are multiples of its period, and how far each one is from it."""
    lacking = rhythm.holes.duration_ns / rhythm.period_ns
    within_ns = max(2 * 2 * rhythm.jitter_ns, FEW * rhythm.period_ns)
    return within_ns, np.abs(lacking - np.rint(lacking)) * rhythm.period_ns


def without_stretches(readings: Sequence[Reading], stretches: Holes) -> list[Reading]:
    """Take the holes of arrival within stretches out in which nothing was sent, or a clock was set."""
    return [
        Reading.of(reading.name, reading.rhythm.without(reading.holes.meet(stretches)))
        if reading.rhythm is not None and reading.name == "period" and len(stretches)
        else reading
        for reading in readings
    ]


def doubted(readings: Sequence[Sequence[Reading]], silent: Holes) -> list[list[Reading]]:
    """Lower the counts of silences in which another topic shows that its publisher stood still: of reading program, simulation, or computer.

    Its stamps show it, or a silence of all topics that is no multiple of its steady period: where one is of that kind, all may be.
    So may a silence after which no stamps, numbers or steady timer go on as after a loss.
    """
    is_lost, is_still, witnesses = np.zeros(len(silent), np.bool_), False, []
    for reading in (reading for topic in readings for reading in topic):
        lost, still = _went_on(reading)
        is_lost |= silent.meet(lost)
        if reading.name == "stamps":
            witnesses.append(still)
        else:
            is_still |= bool(silent.meet(still).any())
    witness = Holes.of([*witnesses, silent if is_still else silent.at(~is_lost)])
    return [[_doubted(reading, witness) if len(witness) else reading for reading in topic] for topic in readings]


def _went_on(reading: Reading) -> tuple[Holes, Holes]:
    """Return the holes after which stamps, numbers or a steady timer go on as after a loss, and the long ones after which they do not."""
    holes, rhythm = reading.holes, reading.rhythm
    if rhythm is None or reading.name == "tap":
        return holes.at(holes.low > 0), Holes()
    is_still = (holes.low == 0) & (holes.missing > 0) & (holes.duration_ns > FEWEST * rhythm.period_ns)
    if reading.name == "stamps":
        return holes.at(holes.low > 0), holes.at(is_still)
    within_ns, off_ns = _off_multiples(rhythm)
    is_steady = within_ns < NEAR * rhythm.period_ns
    is_lost = (holes.low > 0) & (off_ns <= within_ns / 2)  # a pause is near to a multiple by chance
    return holes.at(is_steady & is_lost), holes.at(is_steady & is_still & (off_ns > within_ns))


def _doubted(reading: Reading, witness: Holes) -> Reading:
    if reading.rhythm is None or not len(reading.holes) or reading.name == "tap":  # counted, whatever its rhythm
        return reading
    holes = reading.holes
    middle_ns = witness.start_ns + witness.duration_ns // 2
    first = np.searchsorted(middle_ns, holes.start_ns)
    is_met = first < np.searchsorted(middle_ns, holes.end_ns)
    length_ns = witness.duration_ns[np.minimum(first, len(witness) - 1)]
    is_alike = (holes.duration_ns < 2 * length_ns) & (length_ns < 2 * holes.duration_ns)
    return Reading.of(reading.name, reading.rhythm.unsure(is_met & is_alike))


def find_silences(logged: Int64, losses: Sequence[Losses]) -> tuple[Holes, list[tuple[int, int, int]]]:
    """Return pauses of the recorder, in which several topics lack messages, and its stalls: length, start, late messages."""
    regular = [loss for loss in losses if loss.regularity]
    rates_hz = [loss.regularity.rate_hz for loss in regular if loss.regularity]
    if len(rates_hz) < 2:
        return Holes(), []
    per_ns = sum(rates_hz) / SECOND_NS
    gaps = np.flatnonzero(np.diff(logged) > PATTERN / per_ns)
    silent = Holes.between(logged[gaps].tolist(), logged[gaps + 1].tolist())
    lacking, late_starts = np.zeros(len(silent), np.int64), np.zeros(len(silent), np.bool_)
    for loss in regular:
        holes = loss.holes
        lacking += silent.meet(holes.at(holes.missing > 0))
        late_starts |= silent.meet(holes.at((holes.start_ns == logged[0]) & (holes.missing == 0)))
    window_ns = silent.duration_ns / (2 * 2)
    late = np.searchsorted(logged, silent.end_ns + window_ns, "right") - gaps - 1 - np.rint(per_ns * window_ns)
    is_long = silent.duration_ns > (2 + 1 / 2) * SECOND_NS / max(rates_hz)
    stalls = (lacking < 2) & is_long & (late > per_ns * silent.duration_ns / 2) & ~late_starts
    columns = (part[stalls].tolist() for part in (silent.duration_ns, silent.start_ns, np.rint(late).astype(np.int64)))
    return silent.at(lacking >= 2), list(zip(*columns, strict=True))
