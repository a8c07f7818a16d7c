import platform
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import polars as pl
import pytest

import dds_trace.analyzer.engines.batches
from dds_trace.analyzer.engines.batches import groups_in_parts, plan_batches
from dds_trace.analyzer.groups.batch import AnalysisOptions, Grouping


@pytest.fixture(autouse=True)
def small_bounds(monkeypatch):
    monkeypatch.setattr(dds_trace.analyzer.engines.batches, "BATCH_EVENTS", 100)
    monkeypatch.setattr(dds_trace.analyzer.engines.batches, "WHOLE_GROUP_EVENTS", 200)


def plan(*groups):
    """Batches of groups of (run_id, events) pairs: positions of exchanges, group of each, and whether whole."""
    runs = {run_id: SimpleNamespace(run_id=run_id) for group in groups for run_id, _ in group}
    exchanges = tuple(
        SimpleNamespace(run=runs[run_id], counts=(events, 0, 0, 0)) for group in groups for run_id, events in group
    )
    group_of_exchange = np.repeat(np.arange(len(groups), dtype=np.uint32), [len(group) for group in groups])
    parameters = pl.DataFrame({"payload_bytes": [1000 * number for number in range(len(groups))]})
    batches = plan_batches(Grouping(parameters, exchanges, group_of_exchange), AnalysisOptions())
    place = {id(exchange): position for position, exchange in enumerate(exchanges)}
    assert {batch.all_exchanges for batch in batches} == {len(exchanges)}
    return batches, [
        ([place[id(e)] for e in batch.exchanges], batch.group_of_exchange.tolist(), batch.whole) for batch in batches
    ]


def test_small_groups_share_a_batch_until_it_is_full():
    _, cut = plan([(1, 40), (2, 20)], [(3, 40)], [(4, 1)])
    assert cut == [([0, 1, 2], [0, 0, 1], True), ([3], [2], True)]


def test_many_small_groups_are_several_batches(monkeypatch):
    monkeypatch.setattr(dds_trace.analyzer.engines.batches, "BATCH_GROUPS", 3)
    _, cut = plan(*([(run, 1)] for run in range(1, 6)))
    assert cut == [([0, 1, 2], [0, 1, 2], True), ([3, 4], [3, 4], True)]


def test_a_group_above_a_batch_stays_whole_up_to_its_own_bound():
    batches, cut = plan([(1, 10)], [(2, 120), (3, 80)], [(4, 10)])
    assert cut == [([0], [0], True), ([1, 2], [1, 1], True), ([3], [2], True)]
    assert groups_in_parts(batches) == []


def test_a_group_too_large_comes_in_parts_of_whole_runs():
    # Run 2 has two relays, which stay together though they are more than a batch.
    batches, cut = plan([(1, 10)], [(2, 90), (2, 90), (3, 30), (4, 60), (5, 20)], [(6, 10)])
    assert cut == [
        ([0], [0], True),
        ([1, 2], [1, 1], False),
        ([3, 4], [1, 1], False),
        ([5], [1], False),
        ([6], [2], True),
    ]
    assert groups_in_parts(batches) == [1]


def test_one_run_is_never_cut():
    _, cut = plan([(1, 500), (1, 500)])
    assert cut == [([0, 1], [0, 0], True)]


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="what other C libraries keep is their own affair")
def test_the_memory_of_one_array_is_that_of_the_next():
    def pages_touched(preparation):
        code = f"""
import resource
import numpy as np
from dds_trace.analyzer.engines.batches import keep_freed_memory
{preparation}
for _ in range(3):  # the first ones find no memory that was freed
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    arrays = [np.ones(200_000) for _ in range(10)]
    del arrays
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""
        told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
        return int(told.stdout)

    assert pages_touched("keep_freed_memory()") < 0.2 * pages_touched("")
