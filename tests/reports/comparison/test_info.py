from functools import cache

import polars as pl
import pytest
from roundtrip_frames import MS, in_runs, steady
from wording import numbers

from dds_trace.analyzer.verdicts.compare import CompareOptions, compare_roundtrips
from dds_trace.analyzer.verdicts.gate import parse_gate
from dds_trace.analyzer.verdicts.gates import judge_gates
from dds_trace.reports.comparison.info import comparison_info, mean_change

OPTIONS = CompareOptions(metrics=("latency",), statistics=("p50",))
BRIDGED = {"bridge": "builtin", "domain_mode": "different"}


def compared_at(new_ms, runs=in_runs, **parameters):
    spread = {"spread": 1e-3} if runs is in_runs else {}
    return compare_roundtrips(
        runs([5 * MS] * 40, **spread, **parameters), runs([new_ms * MS] * 40, **spread, **parameters), OPTIONS
    )


def several(new_ms):
    """Groups of growing size: 5 ms on the base, and a time of the new side for each; None is lost half of the time."""
    sides = [
        pl.concat(
            in_runs(times(ms), spread=1e-2, payload_bytes=1000 * (place + 1), **BRIDGED)
            for place, ms in enumerate(each)
        )
        for each in ([5] * len(new_ms), new_ms)
    ]
    return compare_roundtrips(*sides, CompareOptions(metrics=("latency",), statistics=("p50", "p90")))


def times(ms):
    return [5 * MS if n % 2 else None for n in range(100)] if ms is None else [round(ms * MS)] * 100


@cache
def mixed():
    return comparison_info(several([5, 6, None, 4, 7]))


def test_the_answer_says_what_is_lost_and_what_became_slower_and_most_where(sentences):
    sentences(mixed().said)
    assert numbers(mixed().said) == [1, 5, 3, 10, 100, 50, 2, 5, 5, 10, 40, 1]


def test_groups_come_worst_first_by_the_names_of_the_report():
    assert [(group.label, group.verdict) for group in mixed().groups] == [
        ("Binary 3 KB at 10 Hz", "loses more"),
        ("Binary 5 KB at 10 Hz", "slower"),
        ("Binary 2 KB at 10 Hz", "slower"),
        ("Binary 1 KB at 10 Hz", "the same"),
        ("Binary 4 KB at 10 Hz", "faster"),
    ]
    alone = comparison_info(compared_at(5, **BRIDGED))
    assert alone.groups[0].label == "Binary 33 KB at 10 Hz"
    both = pl.concat([in_runs([MS] * 9), in_runs([MS] * 9, **BRIDGED)])
    labels = [group.label for group in comparison_info(compare_roundtrips(both, both, OPTIONS)).groups]
    message = alone.groups[0].label
    assert sorted(labels) == [f"{message}, same domain", f"{message}, through our built-in bridge"]


def test_the_second_sentence_says_which_changes_would_not_be_seen(sentences):
    info, slower = comparison_info(compared_at(5)), comparison_info(compared_at(6)).said
    # The runs agree to 0.1 %, yet a change within 5 % is called the same.
    assert numbers(info.seen) == [80, 100, 4.84]
    assert numbers(slower) == [1, 1, 20]
    sentences(info.said, info.seen, slower)


def test_what_is_slower_everywhere_needs_no_smallest_change():
    info = comparison_info(compared_at(6))
    assert [group.verdict for group in info.groups] == ["slower"]
    assert "median" not in info.seen
    assert mean_change(info.groups, "p50") == pytest.approx(1.2, abs=0.01)


def test_too_few_runs_do_not_reassure(sentences):
    info = comparison_info(compared_at(5, runs=steady))
    assert (numbers(info.said), info.seen) == ([3], "")
    sentences(info.said)
    assert [group.verdict for group in info.groups] == ["too few runs"]


def test_sides_without_a_common_result_say_how_to_compare_them(sentences):
    info = comparison_info(compare_roundtrips(steady([MS]), steady([MS], **BRIDGED), OPTIONS))
    assert info.ignore == ("bridge", "domain_mode")
    unlike = comparison_info(
        compare_roundtrips(steady([MS]), steady([MS], vendor="zenoh", payload_bytes=1000), OPTIONS)
    )
    assert numbers(unlike.seen) == [33_000, 1000]
    sentences(info.said, info.seen, unlike.seen)


@pytest.mark.parametrize("new_ms", [5, 6])
def test_gates_are_named_as_the_groups_are(new_ms):
    found = several([new_ms, 5])
    gates = judge_gates(found, [parse_gate("latency_p50 > +10%")])
    info = comparison_info(found, gates)
    names = {group.label for group in info.groups}
    assert {gate.where for gate in info.gates} == names
    assert info.outcome.value == {5: "passed", 6: "regressed"}[new_ms]
    assert info.gates[0].line.startswith(f"{info.outcome.value}: latency_p50 > +10% (Binary ")


def test_a_missing_group_has_its_name_too():
    base = pl.concat([in_runs([MS] * 9), in_runs([MS] * 9, payload_bytes=7)])
    found = compare_roundtrips(base, in_runs([MS] * 9), OPTIONS)
    info = comparison_info(found, judge_gates(found, [parse_gate("latency_p50 > +10%")]))
    assert info.only_base == ("Binary 7 B at 10 Hz",)
    assert [gate.where for gate in info.gates if gate.result.outcome.value == "regressed"] == ["Binary 7 B at 10 Hz"]
