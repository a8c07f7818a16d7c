"""Which groups of two sides are compared: of equal parameters, or with `--against`."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence

import polars as pl

from dds_trace.analyzer.model.names import group_words, value_word, varying_parameters
from dds_trace.analyzer.model.parameters import DEVICE_COLUMNS, ParameterValue
from dds_trace.analyzer.model.runs import RunRows
from dds_trace.analyzer.model.setting import without_relay
from dds_trace.analyzer.run_statistics.change import Passes
from dds_trace.analyzer.verdicts.cases import partition_groups
from dds_trace.analyzer.verdicts.setup_runs import SetupRuns
from dds_trace.tracefile.format.descriptions import Run as RunDescription

Key = tuple[ParameterValue, ...]
"""Values of the match columns."""

RELAY_COLUMNS = ("relay_vendor", "relay_backend", "relay_device", "relay_domain_id")
"""Columns that are null without the relay's trace, and match any value then."""

SETTING = "setting"
"""Column with, among others, the relay's options that differ from the ping's, and the number of relays."""

CELL_LABEL = "cell"
"""Label of a run with the name of its cell, without the number of the repeat."""

AGAINST_LABEL = "against"
"""Label of a run with the name of the base's cell that it was interleaved with."""

MOST_BLOCKS, LEAST_OF_A_BLOCK = 10, 200
"""Of a recording of a topic; messages."""


def topics_in_blocks(rows: pl.DataFrame) -> pl.DataFrame:
    """Cut recordings of topics into blocks with run ids of their own: a limit of one recording rests on its parts."""
    blocks = (pl.len() // LEAST_OF_A_BLOCK).clip(1, MOST_BLOCKS).cast(pl.UInt64)
    number = pl.col("publish_ns").rank("ordinal").cast(pl.UInt64) - 1
    block = (number * blocks // pl.len().cast(pl.UInt64)).over("run_id")
    return rows.with_columns(
        run_id=pl.when(pl.col("data_type").str.starts_with("/")).then(pl.col("run_id") ^ block).otherwise("run_id")
    )


def passes_of(base: Sequence[RunRows], new: Sequence[RunRows], passes: Mapping[int, int]) -> Passes | None:
    """Return both sides' passes; None unless every run has one of its own on its side."""
    before, after = ([passes[run.run_id] for run in side if run.run_id in passes] for side in (base, new))
    return (before, after) if (len({*before}), len({*after})) == (len(base), len(new)) else None


def replaced_devices(base: pl.DataFrame, new: pl.DataFrame) -> Mapping[str, str]:
    """Return column -> name on the base that the only device of the new side takes; empty where a side has several."""
    names = {column: (_names(base, column), _names(new, column)) for column in DEVICE_COLUMNS}
    if any(len(side) > 1 for sides in names.values() for side in sides):
        return {}
    return {column: before[0] for column, (before, after) in names.items() if before and after}


def with_devices(frame: pl.DataFrame, names: Mapping[str, str]) -> pl.DataFrame:
    return frame.with_columns(
        pl.when(pl.col(column).is_not_null()).then(pl.lit(name)).alias(column) for column, name in names.items()
    )


def _names(frame: pl.DataFrame, column: str) -> list[str]:
    return [str(name) for name in frame[column].drop_nulls().unique().sort()]


def match_groups(
    roundtrips: pl.DataFrame, match: Sequence[str], unfinished: Collection[int] = ()
) -> dict[Key, SetupRuns]:
    """Split round trips into groups by the values of the match columns; sorted by these, null first.

    A run that received nothing may have no trace of its relay: it belongs to the only group that agrees in everything else.
    """
    parts = {part.select(match).row(0): part for part in partition_groups(roundtrips, match)}
    for key in [key for key in parts if not knows_relay(key, match)]:
        alike = [other for other in parts if knows_relay(other, match) and _agree(key, other, match)]
        if len(alike) != 1:
            continue
        part = parts.pop(key)
        is_answered = (pl.col("outcome") == "completed").any().over("run_id")
        parts[alike[0]] = pl.concat([parts[alike[0]], part.filter(~is_answered)])
        answered = part.filter(is_answered)
        if not answered.is_empty():
            parts[key] = answered

    ordered = sorted(parts, key=lambda key: [(value is not None, value) for value in key])  # nulls first
    return {key: SetupRuns.of(parts[key], unfinished) for key in ordered}


def pair_keys(before: Mapping[Key, object], after: Mapping[Key, object], match: Sequence[str]) -> dict[Key, Key]:
    """Return which group of the new side each group of the base is compared with.

    A key without a relay trace is paired with the only group left that agrees in everything else.
    """
    pairs = {key: key for key in before if key in after}
    open_after = [key for key in after if key not in pairs]
    open_before = [key for key in before if key not in pairs]
    for key in open_before:
        alike = [other for other in open_after if _agree(key, other, match)]
        if len(alike) == 1 and sum(_agree(column, alike[0], match) for column in open_before) == 1:
            pairs[key] = alike[0]
    return {key: pairs[key] for key in before if key in pairs}


def completed_key(key: Key, other: Key, match: Sequence[str]) -> Key:
    is_silent = not knows_relay(key, match)
    return tuple(
        theirs if value is None or (name == SETTING and is_silent) else value
        for name, value, theirs in zip(match, key, other, strict=True)
    )


def knows_relay(key: Key, match: Sequence[str]) -> bool:
    return all(value is not None for name, value in zip(match, key, strict=True) if name in RELAY_COLUMNS)


def _agree(key: Key, other: Key, match: Sequence[str]) -> bool:
    is_silent = not (knows_relay(key, match) and knows_relay(other, match))
    return all(
        without_relay(str(first)) == without_relay(str(two))
        if name == SETTING and is_silent
        else first == two or (name in RELAY_COLUMNS and None in (first, two))
        for name, first, two in zip(match, key, other, strict=True)
    )


def interleaved_keys(
    base: pl.DataFrame,
    new: pl.DataFrame,
    base_runs: Iterable[RunDescription],
    new_runs: Iterable[RunDescription],
    match: Sequence[str],
) -> dict[int, Key]:
    cells = {run.run_id: run.labels[CELL_LABEL] for run in base_runs if CELL_LABEL in run.labels}
    groups: dict[str, set[Key]] = defaultdict(set)
    for run_id, *key in base.select("run_id", *match).unique().iter_rows():
        if run_id in cells:
            groups[cells[run_id]].add(tuple(key))
    partners: dict[str, Key] = {}
    for cell, keys in groups.items():
        keys = {key for key in keys if knows_relay(key, match)} or keys  # noqa: PLW2901 - a run that lost all has no relay
        if len(keys) == 1:
            (partners[cell],) = keys
    measured = set(new["run_id"].unique().to_list())
    return {
        run.run_id: partners[cell]
        for run in new_runs
        if run.run_id in measured and (cell := run.labels.get(AGAINST_LABEL, "")) in partners
    }


def with_partners(new: pl.DataFrame, partners: Mapping[int, Key], match: Sequence[str]) -> pl.DataFrame:
    schema = {name: new.schema[name] for name in ("run_id", *match)}
    rows = [(run_id, *key) for run_id, key in partners.items()]
    theirs = pl.DataFrame(rows, schema=schema, orient="row")
    unpaired = new.join(theirs, on="run_id", how="anti", maintain_order="left")
    renamed = new.drop(match).join(theirs, on="run_id", how="inner", maintain_order="left")
    return pl.concat([unpaired, renamed.select(new.columns)])


def partner_groups(new: pl.DataFrame, partners: Mapping[int, Key], match: Sequence[str]) -> dict[Key, Key]:
    rows = new.select("run_id", *match).unique(maintain_order=True).iter_rows()
    return {tuple(key): partners[run_id] for run_id, *key in rows if run_id in partners}


def partner_differences(groups: Mapping[Key, Key], match: Sequence[str]) -> tuple[str, ...]:
    if not groups:
        return ()
    partners = pl.DataFrame(list(groups.values()), schema=list(match), orient="row")
    names = varying_parameters(partners, match)
    sentences = []
    for group_key, partner in groups.items():
        values = {name: sides for name, *sides in zip(match, group_key, partner, strict=True)}
        listed = [
            f"{name} {value_word(new)} instead of {value_word(base)}"
            for name, (new, base) in values.items()
            if new != base
        ]
        if listed and knows_relay(group_key, match):
            words = group_words(dict(zip(match, partner, strict=True)), names)
            sentences.append(f"{words}: the new side has {', '.join(listed)}.")
    return tuple(sentences)
