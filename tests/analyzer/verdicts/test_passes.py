import pytest
from campaigns import write_run
from trace_files import evenly

from dds_trace import analyze

MS = 1_000_000
MESSAGES = 60
PASS_FACTORS = (1.0, 1.3, 0.8, 1.6, 1.1)
"""The machine's speed in each pass: it varies by far more than the 10 % that lie between the ways."""


def record(folder, *, labelled, in_turn=True, factors=PASS_FACTORS):
    """Fast DDS, Cyclone DDS 10 % quicker, and Fast DDS through a bridge 10 % slower, in each pass."""
    setups = (("fastdds", "none", 1.0), ("cyclonedds", "none", 0.9), ("fastdds", "builtin", 1.1))
    number = 0
    for place, factor in enumerate(factors, 1):
        for setup_number, (vendor, bridge, share) in enumerate(setups):
            number += 1
            start = (number if in_turn else 10 * setup_number + place) * 100_000 * MS
            domain_id = 5 if bridge == "none" else 10
            ways = [int(10 * MS * factor * share) + (s * 37 % 101) * 1000 for s in range(MESSAGES)]
            write_run(
                folder / str(number),
                number,
                evenly(ways, start_ns=start),
                ping={"vendor": vendor},
                relay={"vendor": vendor, "relay_id": 900 + number, "domain_id": domain_id},
                bridge=bridge,
                relay_domain_id=domain_id,
                labels={"pass": str(place)} if labelled else {},
            )
    return analyze(folder)


@pytest.mark.parametrize(("labelled", "verdict", "pairs"), [(True, "worse", 5), (False, "inconclusive", 0)])
def test_bridge_costs_are_paired_where_runs_tell_their_pass_and_answers_are_not(tmp_path, labelled, verdict, pairs):
    details = record(tmp_path, labelled=labelled).details
    (answer,) = (one for one in details.answers if one.domain_mode == "same")
    assert (answer.clarity.value, answer.fewest_runs) == ("inconclusive", 5)
    (cost,) = details.bridge_costs.filter(statistic="p50", metric="latency").iter_rows(named=True)
    assert (cost["verdict"], cost["pairs"]) == (verdict, pairs)
    spread = details.intervals.filter(metric="latency", percentile="p50")
    assert spread["between"].min() > 0.2  # of the logarithms of 0.8 to 1.6
    assert spread["within"].max() < 0.01


@pytest.mark.parametrize("in_turn", [True, False])
def test_setups_recorded_one_after_the_other_are_found(tmp_path, in_turn):
    analysis = record(tmp_path, labelled=False, in_turn=in_turn)
    (answer,) = (one for one in analysis.details.answers if one.domain_mode == "same")
    found = [finding for finding in analysis.findings if finding.code == "recorded_in_sequence"]
    assert answer.interleaved is in_turn
    assert len(found) == (not in_turn)
    for finding in found:
        assert len(finding.groups) == 2
        assert "--trust-order" in finding.action
        assert f"a drift of {100 * (answer.drift_ratio - 1):.3g} % between them" in finding.what


@pytest.mark.parametrize(("order", "leader"), [((0, 1, 2, 3, 4, 5), ""), ((3, 0, 5, 2, 4, 1), "cyclonedds")])
def test_passes_that_depend_on_each_other_are_a_finding_and_name_no_leader(tmp_path, order, leader):
    analysis = record(tmp_path, labelled=True, factors=[1 + 0.01 * step for step in order])
    (answer,) = (one for one in analysis.details.answers if one.domain_mode == "same")
    assert answer.leader_p50 == leader
    assert ("dependent_passes" in {finding.code for finding in analysis.findings}) is (leader == "")
