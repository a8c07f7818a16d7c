import json
from dataclasses import replace
from xml.etree import ElementTree as ET

import pytest
from campaigns import write_run
from commands import run_main
from trace_files import evenly, ping_session, write_pair

MS = 1_000_000
PERIOD = 100 * MS


def drawn(slower=1, count=600, number=0):
    ways = [int(slower * (MS + (s * 7 % 60) * 1000)) for s in range(count)]
    return evenly(ways, start_ns=number * 1000 * PERIOD)


def printed(capsys):
    return " ".join(capsys.readouterr().out.split())


def record(folder, runs=3, **how):
    """Runs of one group, each in a folder of its own, 1 % slower and faster in turn."""
    first = how.get("first", 0)
    count, vendor, slower = how.get("count", 600), how.get("vendor", "fastdds"), how.get("slower", 1)
    sent = how.get("sent", count)
    for number in range(runs):
        write_run(
            folder / str(number),
            first + number,
            drawn(slower * (0.99 + 0.01 * number), sent, first + number),
            ping={"vendor": vendor},
            planned_messages=count,
            extra={"ended_ns": ((first + number) * 1000 + count - 1) * PERIOD},
        )


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    folder = tmp_path_factory.mktemp("folders")
    record(folder / "base")
    record(folder / "same")
    record(folder / "slow", slower=2)
    record(folder / "few", count=20)
    record(folder / "one", runs=1, slower=2)
    record(folder / "other", vendor="zenoh")
    return folder


@pytest.mark.parametrize(
    ("new", "gate", "status", "said"),
    [
        ("same", "latency_p90 > +10%", 0, "passed"),
        ("slow", "latency_p90 > +10%", 20, "regressed"),
        ("one", "latency_p90 > +10%", 21, "undecided"),
        ("few", "latency_p99 > +10%", 21, "undecided"),
        ("other", "latency_p90 > +10%", 22, "nothing to compare"),
    ],
)
def test_every_outcome_has_its_exit_code(folders, capsys, new, gate, status, said):
    given = "compare", folders / "base", folders / new, "--fail-if", gate
    assert run_main(*given, "--strict") == status
    assert capsys.readouterr().err == f"dds-trace: {said}\n"
    assert run_main(*given) == (0 if status == 21 else status)
    assert ("warning" in capsys.readouterr().err) == (status == 21)


@pytest.mark.parametrize("gate", ["latency_p90 > +10%", "received_ratio < 99%"])
@pytest.mark.parametrize("barred", ["base", "new"])
def test_a_gate_on_a_group_whose_setting_was_not_applied_is_inconclusive(tmp_path, capsys, gate, barred):
    words = "asked for UDP, the bytes went through shared memory"
    for side in ("base", "new"):
        extra = {"not_applied": [{"words": words}]} if side == barred else {}
        write_pair(tmp_path / side, drawn(slower=1 + (side == "new")), ping=ping_session(extra=extra))
    assert run_main("compare", tmp_path / "base", tmp_path / "new", "--fail-if", gate, "--strict") == 21
    shown = capsys.readouterr()
    assert shown.err.startswith(f"{tmp_path / barred}: ")
    assert words in shown.err
    assert "a requested setting was not applied" in " ".join(shown.out.split())


def test_without_a_gate_it_shows_and_passes(folders, capsys, sentences):
    assert run_main("compare", folders / "base", folders / "slow") == 0
    shown = capsys.readouterr()
    sentences(shown.out.splitlines()[0])
    assert shown.err == ""


@pytest.mark.parametrize("report", ["terminal", "md"])
def test_the_output_names_how_verdicts_and_gates_are_adjusted(folders, capsys, report):
    record(folders / "other run", first=3)
    sides, gate = (folders / "base", folders / "other run"), ("--fail-if", "default")
    run_main("compare", *sides, "--report", report, "--all")
    shown = printed(capsys)
    assert "Benjamini-Hochberg over groups" in shown
    assert "Holm" not in shown
    run_main("compare", *sides, *gate, "--report", report, "--all")
    shown = printed(capsys)
    assert "Benjamini-Hochberg over groups" in shown
    assert "Holm over groups" in shown
    assert "smallest" in shown.lower()


def test_the_same_recordings_pass_every_change_and_fail_a_limit(folders, capsys):
    """Even twenty messages, of which no change could be seen."""
    for side in ("base", "few"):
        given = "compare", folders / side, folders / side, "--strict", "--fail-if"
        assert run_main(*given, "default") == 0
        assert "the same recordings" in capsys.readouterr().out
        assert run_main(*given, "latency_p50 > 1us") == 20


def test_a_dead_group_regresses_unless_that_is_allowed(folders, capsys):
    for number in range(3):
        write_run(folders / "dead" / str(number), number, [replace(m, t4=None, t2=None) for m in drawn(number=number)])
    assert run_main("compare", folders / "base", folders / "dead", "--allow-missing") == 0
    capsys.readouterr()
    assert run_main("compare", folders / "base", folders / "dead") == 20
    shown = capsys.readouterr()
    assert "no reply was received" in " ".join(shown.out.split())
    assert "100 % → 0 %" in shown.out
    assert shown.err == "dds-trace: regressed\n"


@pytest.mark.parametrize("side", ["base", "new"])
def test_a_finding_of_severity_error_makes_a_gate_inconclusive(tmp_path, capsys, side):
    for name, slower in (("base", 1), ("new", 1.001)):
        record(tmp_path / name, slower=slower)
    write_run(tmp_path / side / "0", 0, drawn(0.99), ping={"dropped_events": 7})
    gate = ("--strict", "--fail-if", "latency_p90 > +10%")
    assert run_main("compare", tmp_path / "base", tmp_path / "new", *gate) == 21
    assert "not fit to be judged" in printed(capsys)
    record(tmp_path / side)
    assert run_main("compare", tmp_path / "base", tmp_path / "new", *gate) == 0


def test_a_side_that_stops_sending_regresses(tmp_path, capsys):
    record(tmp_path / "base", slower=5)
    record(tmp_path / "new", sent=300)
    gates = ("--fail-if", "latency_p90 > +10%", "--fail-if", "received_ratio < 99%")
    assert run_main("compare", tmp_path / "base", tmp_path / "new", *gates) == 20
    shown = capsys.readouterr().out
    assert "100 % → 50 %" in shown
    assert shown.count("\n✗ ") == 2


def test_tables_say_what_the_tails_rest_on_and_what_was_received(folders, capsys):
    assert run_main("compare", folders / "base", folders / "same", "--report", "md", "--all") == 0
    shown = capsys.readouterr().out
    assert "| 100 % |" in shown
    rows = [line for line in shown.splitlines() if not line.startswith("| Result ")]
    tails = [line for line in rows if "Latency p9" in line]
    medians = [line for line in rows if "Latency median" in line]
    assert tails
    assert all("burst" in line for line in tails if "p99.9" not in line)
    assert medians
    assert not any("burst" in line for line in medians)


def test_unlike_folders_are_told_apart_and_compared_without_what_they_differ_in(folders, capsys, sentences):
    sides = folders / "base", folders / "other"
    assert run_main("compare", *sides) == 22
    shown = printed(capsys)
    assert "vendor (fastdds against zenoh). --ignore vendor" in shown
    out = folders / "compared.json"
    assert run_main("compare", *sides, "--ignore", "vendor", "--report", "json", "--out", out) == 0
    told = json.loads(out.read_text())
    sentences(told["notes"][0])
    assert [group["verdict"] for group in told["groups"]] == ["the same"]


def test_one_side_is_judged_by_its_own_limits(folders, capsys):
    gates = ("--fail-if", "latency_p50 < 1ns", "--fail-if", "received_ratio < 99%")
    out = folders / "gates.xml"
    assert run_main("compare", folders / "base", *gates, "--report", "junit", "--out", out) == 0
    root = ET.parse(out).getroot()
    assert (root.get("tests"), root.get("failures"), root.get("skipped")) == ("2", "0", "0")
    late = ("--fail-if", "latency_p50 > 1us")
    assert run_main("compare", folders / "base", *late, "--report", "github", "--out", out) == 20
    assert out.read_text().startswith("::error title=latency_p50 > 1us::")
    assert run_main("compare", folders / "base", *late, "--report", "badge") == 20
    assert '"message": "regressed"' in capsys.readouterr().out
    run_main("compare", folders / "base", *gates, *late)
    assert "1 of 3 limits" in printed(capsys)
    for wrong in ((), ("--fail-if", "latency_p50 > +10%")):
        assert run_main("compare", folders / "base", *wrong) == 2
        assert "without NEW" in capsys.readouterr().err


def test_a_text_that_is_no_gate_is_one_line_before_anything_is_read(tmp_path, capsys):
    assert run_main("compare", tmp_path / "no", tmp_path / "such", "--fail-if", "latncy_p99 > +10%") == 2
    shown = capsys.readouterr().err
    assert "did you mean 'latency_p99'" in shown
    assert shown.count("\n") == 1


def test_limits_are_written_once_and_judge_one_side_or_two(tmp_path, capsys):
    record(tmp_path / "good")
    record(tmp_path / "slow", slower=3, first=5)
    limits = tmp_path / "limits.toml"
    assert run_main("compare", tmp_path / "good", "--write-limits", limits) == 0
    assert run_main("compare", tmp_path / "good", "--write-limits", limits) == 6
    assert run_main("compare", tmp_path / "good", "--limits", limits) == 0
    capsys.readouterr()
    assert run_main("compare", tmp_path / "slow", "--limits", limits) == 20
    assert run_main("compare", tmp_path / "good", tmp_path / "slow", "--limits", limits) == 20
    assert "latency_p50 < +" in capsys.readouterr().out
