"""Checks of what an analysis leaves out because of a campaign's size, or of `--sketch`."""

from __future__ import annotations

from collections.abc import Iterator

from dds_trace.base.units import counted

from ..groups.batch import WHOLE_GROUP_EVENTS
from ..model.finding import Severity, Subject
from ..model.parameters import BRIDGE_MATCH_COLUMNS, CASE_COLUMNS
from ..statistics.histogram import RELATIVE_ERROR
from ..verdicts.cases import MOST_COMPARED_ROWS, is_too_large, partition_groups
from .evidence import Evidence, Observation, check, some


@check(
    "sketched",
    Severity.INFO,
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


@check(
    "earlier_rows",
    Severity.INFO,
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


@check("group_in_parts", Severity.INFO, Subject.RESULT, "Analyze a folder with fewer of their runs to see these.")
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


@check(
    "not_compared", Severity.INFO, Subject.RESULT, "Analyze a folder with fewer runs of each result to compare them."
)
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
