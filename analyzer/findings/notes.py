"""Findings of severity info, and of relays that an analysis leaves out; functions here: what else it leaves out."""

from __future__ import annotations

from collections.abc import Iterator

import polars as pl

from dds_trace.base.units import counted

from ..groups.batch import WHOLE_GROUP_EVENTS
from ..model.finding import Subject
from ..model.parameters import BRIDGE_MATCH_COLUMNS, CASE_COLUMNS
from ..statistics.percentiles import RELATIVE_ERROR
from ..verdicts.cases import MOST_COMPARED_ROWS, is_too_large, partition_groups
from . import calls, clocks, groups, runs, sessions, shapes, surroundings
from .evidence import Check, Evidence, Observation, note, some


@note(
    "sketched",
    Subject.ANALYSIS,
    "Analyze without --sketch for exact percentiles, the rows in roundtrips.parquet, and who is fastest.",
)
def sketched(evidence: Evidence) -> Iterator[Observation]:
    """Percentiles come from histograms, and there are no rows."""
    if not evidence.options.rows:
        yield Observation(
            "all results",
            f"Percentiles come from histograms and may be off by {RELATIVE_ERROR:.2%} of their value; counts, means, "
            "standard deviations and extremes are exact. There are no rows, so no result is compared with another.",
        )


@note(
    "earlier_rows",
    Subject.FILE,
    "Analyze without --sketch to replace them, or give a sketch a folder of its own with --out.",
)
def stale_rows(evidence: Evidence) -> Iterator[Observation]:
    """The folder has the rows of an earlier analysis."""
    if evidence.stale_rows is not None:
        yield Observation(
            evidence.stale_rows.name,
            "This file has the rows of an earlier analysis; the summary in this folder was not made from them.",
        )


@note("group_in_parts", Subject.RESULT, "Analyze a folder with fewer of their runs to see these.")
def groups_in_parts(evidence: Evidence) -> Iterator[Observation]:
    """A result has no breakdown and no responses, as it is too large."""
    names, in_parts = evidence.group_names, evidence.in_parts
    if in_parts and evidence.details.requested:
        yield Observation(
            some(names[group] for group in in_parts),
            f"{counted(len(in_parts), 'result has', 'results have')} more than {WHOLE_GROUP_EVENTS:,} events"
            f"{'' if len(in_parts) == 1 else ' each'} and {'was' if len(in_parts) == 1 else 'were'} processed in parts: "
            "there is no breakdown of where their time goes, and no response against round trip time.",
            in_parts,
        )


@note("not_compared", Subject.RESULT, "Analyze a folder with fewer runs of each result to compare them.")
def cases_not_compared(evidence: Evidence) -> Iterator[Observation]:
    """A kind of message has too many rows for comparing results."""
    if not evidence.details.requested or not evidence.rows.has_rows:
        return
    groups = sorted(
        {
            group
            for columns in (CASE_COLUMNS, BRIDGE_MATCH_COLUMNS)
            for case in partition_groups(evidence.rows.groups, columns)
            if is_too_large(case)
            for group in case["group"].to_list()
        }
    )
    if groups:
        yield Observation(
            some(evidence.group_names[group] for group in groups),
            f"Their kind of message has more than {MOST_COMPARED_ROWS:,} rows: they are not ranked, and no bridge cost is "
            "computed.",
            tuple(groups),
        )


NOTES: tuple[Check, ...] = (
    runs.UNPLACED.error(
        "too_many_relays",
        "More relays replied than a run can have rows for",
        pl.col("reason") == "too_many_relays",
        "These runs have replies of more relays than their messages explain; those with the fewest events were left out. "
        "{events:# event}, {runs}.",
        "Look for a program that forges replies, or a recorder with a new relay_id for each message.",
    ),
    runs.UNPLACED.error(
        "unnamed_relay",
        "Replies name no relay",
        pl.col("reason") == "names_no_relay",
        "These runs have replies of the ids 0 and ffffffff, which only messages on their way out have; they were left out. "
        "{events:# event}, {runs}.",
        "Look for a program that forges replies, or give each relay an id of its own.",
    ),
    runs.missing_schedule,
    shapes.two_modes,
    surroundings.slowed_results,
    surroundings.FAN_OUT.note(
        "shared_cores",
        "Pings and relays of a result shared processors",
        pl.col("recorders") > pl.col("processors"),
        "{recorders} recorders ran on one machine with {processors:# processor}.",
        "A rise with the number of relays may be this machine's and not the middleware's: lower rates, or a device for each host "
        "([[devices]] of a plan), may show it.",
        effect=1 - pl.col("processors") / pl.col("recorders"),
    ),
    sessions.RECORDINGS.note(
        "slow_to_disk",
        "Events waited longer for the disk than -o fsync=true promises",
        pl.col("longest_unsaved_ns") > sessions.UNSAVED_NS,
        "For {longest_unsaved_ns:duration} events were not on the disk, though -o fsync=true was given: a power loss then would have taken "
        "more than the last second.",
        "Nothing is missing here; a faster disk or less load on the machine may help the next time.",
    ),
    clocks.slow_slews,
    shapes.falls_with_size,
    shapes.jumps_with_size,
    calls.calls,
    surroundings.LOADS.note(
        "loaded",
        "A machine was loaded on purpose",
        pl.col("works"),
        "Under load ({kind}) by {program}, which used {busy:digits} processors.",
        "Read it next to the same result without a load; no answer mixes the two.",
    ),
    surroundings.LINKS.note(
        "link_replayed",
        "An emulated link replayed a file",
        pl.col("file") != "",
        "The link replayed {file} in each run: {spans}.",
        "Results over the same file can be compared; the figure of processor load shows the link below the latency.",
    ),
    groups.few_samples,
    sessions.missing_files,
    sessions.skipped_files,
    sessions.TRACES.note(
        "ring_recovered",
        "Events were recovered from the ring of a killed recorder",
        pl.col("ring_events") > 0,
        "{ring_events:# event comes|events come} from the ring that a killed recorder left next to the file.",
        "Nothing to do; keep the ring file in the trace's folder.",
    ),
    sessions.SOURCES.note(
        "duplicate_file",
        "A file is a copy of another",
        pl.col("status") == "duplicate",
        "Not counted again: {detail}.",
        "Nothing to do; remove the copy to save time.",
    ),
    sessions.overlapping_files,
    sessions.NOTES_OF_READERS.note(
        "reader_note",
        "The reader noticed something else",
        pl.col("notes").is_not_null(),
        "{notes}",
        "Check whether it affects the numbers.",
    ),
    sketched,
    stale_rows,
    groups_in_parts,
    cases_not_compared,
)
