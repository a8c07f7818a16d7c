import pytest
from campaigns import write_run
from trace_files import Message, evenly

from dds_trace.analyzer.pipeline import analyze
from dds_trace.extensions.gates.compare import CompareOptions, compare
from dds_trace.extensions.gates.gate import GateOutcome, parse_gate
from dds_trace.extensions.gates.gates import judge_gates, options_for
from dds_trace.extensions.gates.info import comparison_notes
from dds_trace.tracefile.format.descriptions import Qos

US = 1_000


def record(folder, first, rtts_us, cell, against=None, reliability="reliable", lost=(), **of_run):
    """One run a pass, of thirty messages that all take the run's time; of the passes in `lost` no message arrives."""
    for number, rtt_us in enumerate(rtts_us, 1):
        messages = evenly([rtt_us * US // 2] * 30, start_ns=number * 10_000_000_000)
        if number in lost:
            messages = [Message(one.sequence, one.t0, one.t1) for one in messages]
        labels = {"cell": cell, "pass": str(number)} | ({} if against is None else {"against": against})
        qos = Qos(reliability=reliability)
        write_run(folder / f"{cell}-{number}", first + number, messages, labels=labels, qos=qos, **of_run)


def sides(folder):
    return [analyze(folder / side, details=False) for side in ("base", "new")]


def rows_of(comparison):
    return comparison.rows.filter(metric="rtt", statistic="p50").to_dicts()


def test_a_cell_is_compared_with_its_partner_although_it_was_asked_otherwise(tmp_path):
    record(tmp_path / "base", 100, [1000, 1100, 900], "a")
    record(tmp_path / "base", 200, [2000, 2100, 1900], "b", payload_bytes=1000)
    record(tmp_path / "new", 300, [1200, 1320, 1080], "c", "a", reliability="best_effort")
    record(tmp_path / "new", 400, [1600, 1680, 1520], "d", "b", reliability="best_effort", payload_bytes=1000)
    found = compare(*sides(tmp_path))
    assert (found.only_base.height, found.only_new.height) == (0, 0)
    assert {row["payload_bytes"]: row["ratio"] for row in rows_of(found)} == {
        33_000: pytest.approx(1.2, rel=1e-3),
        1000: pytest.approx(0.8, rel=1e-3),
    }
    assert {row["reliability"] for row in rows_of(found)} == {"reliable"}
    notes = comparison_notes(found)
    assert sum("reliability best_effort instead of reliable" in note for note in notes) == 2
    assert all(note.startswith("Measured in turns: ") for note in notes)


def test_it_is_compared_pass_by_pass_without_being_told(tmp_path):
    """Passes drift by 20 %, the sides by 2 % in each of them: only pairs can see that."""
    record(tmp_path / "base", 100, [1000, 1200, 1440], "a")
    record(tmp_path / "new", 300, [1020, 1226, 1468], "c", "a", reliability="best_effort")
    (row,) = rows_of(compare(*sides(tmp_path)))
    assert row["pairs"] == 3
    assert row["p_value"] < 0.01


@pytest.mark.parametrize(("cell", "against"), [("a", None), ("d", "b")])
def test_a_result_without_a_recorded_partner_is_matched_by_what_was_asked_for(tmp_path, cell, against):
    record(tmp_path / "base", 100, [1000, 1100, 900], "a")
    record(tmp_path / "new", 300, [1200, 1320, 1080], cell, against, reliability="best_effort")
    found = compare(*sides(tmp_path))
    assert (rows_of(found), found.interleaved) == ([], ())
    assert (found.only_base.height, found.only_new.height) == (1, 1)


def test_a_finding_about_a_silent_relay_is_about_the_group_that_it_is_compared_with(tmp_path, sentences):
    """Nothing came back of one group on the new side, so its key lacks the relay; gates on this group have that reason."""
    for size, first in ((33_000, 100), (1000, 200)):
        record(tmp_path / "base", first, [1000, 1100, 900], f"{size}", payload_bytes=size)
        lost = (1, 2, 3) if size == 1000 else ()
        record(tmp_path / "new", first + 300, [1000, 1100, 900], f"{size}", payload_bytes=size, lost=lost)
    gate = parse_gate("rtt_p50 > 5ms")
    found = compare(*sides(tmp_path), options_for([gate], CompareOptions()))
    assert found.delivery["relay_vendor"].to_list() == ["fastdds"] * 2
    results = judge_gates(found, [gate], allow_missing=True)
    outcomes = {
        row["payload_bytes"]: result for row, result in zip(found.delivery.iter_rows(named=True), results, strict=True)
    }
    assert outcomes[33_000].outcome is GateOutcome.PASSED
    assert outcomes[1000].outcome is GateOutcome.INCONCLUSIVE
    (first,) = (note for note in comparison_notes(found) if ": new: no_relay (run " in note)
    assert "and 2 more): " in first  # a finding for each run
    sentences(outcomes[1000].reason, first)
