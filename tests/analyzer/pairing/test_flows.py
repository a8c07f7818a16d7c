from __future__ import annotations

from collections import Counter

from hypothesis import given
from hypothesis import strategies as st

from dds_trace.analyzer.pairing.flows import OVERLAP_NS, Overlap, RunSpan, count_flows, find_overlaps

S = 1_000_000_000


def spans(*seconds, machine="a"):
    return [RunSpan(begin * S, end * S, number, machine) for number, (begin, end) in enumerate(seconds, 1)]


def test_runs_in_the_middle_of_each_other_are_flows():
    drawn = spans((0, 10), (4, 12), (11, 21))
    assert count_flows(drawn) == {1: 2, 2: 2, 3: 1}
    # The first pair shares six of eight seconds; the last one a second, which is in the middle of neither.
    assert list(find_overlaps(drawn)) == [Overlap(1, 2, 0.75, True), Overlap(2, 3, 1 / 8, False)]


def test_runs_of_two_machines_do_not_disturb_each_other():
    drawn = [*spans((0, 10)), RunSpan(0, 10 * S, 2, "b")]
    assert count_flows(drawn) == {1: 1, 2: 1}
    assert list(find_overlaps(drawn)) == []


def test_a_run_with_two_relays_is_one_run():
    drawn = spans((0, 10))
    assert count_flows([*drawn, *drawn]) == {1: 1}
    assert list(find_overlaps([*drawn, *drawn])) == []


def test_a_run_of_one_message_overlaps_what_goes_on_around_it():
    assert list(find_overlaps(spans((0, 10), (5, 5)))) == [Overlap(1, 2, 1.0, True)]


def test_a_run_of_one_message_at_the_edge_of_another_run_overlaps_it():
    assert list(find_overlaps(spans((0, 10), (10, 10)))) == [Overlap(1, 2, 1.0, False)]
    assert list(find_overlaps(spans((5, 5), (5, 15)))) == [Overlap(1, 2, 1.0, False)]
    assert list(find_overlaps([RunSpan(0, 9, 1, "a"), RunSpan(10, 10, 2, "a")])) == []


instants = st.integers(0, 6 * OVERLAP_NS)


@given(st.lists(st.tuples(instants, instants), max_size=12))
def test_what_counts_as_a_flow_is_an_overlap(drawn):
    runs = [RunSpan(min(pair), max(pair), number, "a") for number, pair in enumerate(drawn)]
    of_run = Counter(run_id for overlap in find_overlaps(runs) for run_id in (overlap.one, overlap.other))
    flows = count_flows(runs)
    assert all(flows[run.run_id] - 1 <= of_run[run.run_id] for run in runs)
    mutual = Counter(
        run_id for overlap in find_overlaps(runs) if overlap.is_mutual for run_id in (overlap.one, overlap.other)
    )
    assert all(flows[run.run_id] - 1 >= mutual[run.run_id] for run in runs)
