"""`dds-trace advise`: what it refuses, and what it prints; benchmarks/bench_advise.py runs it on real links."""

import math
import platform
from types import SimpleNamespace

import polars as pl
import pytest
from commands import run_trace

from dds_trace.base.errors import OptionError
from dds_trace.extensions.campaigns.commands.advise import shown_proof
from dds_trace.extensions.campaigns.plan.link import PRESETS
from dds_trace.extensions.campaigns.proof import why_not
from dds_trace.extensions.campaigns.question import ask
from dds_trace.extensions.gates.costs import pays


def run(text, tmp_path, *options):
    plan = tmp_path / "mine.toml"
    plan.write_text(text)
    return run_trace("advise", plan, "--out", tmp_path / "runs", *options)


@pytest.mark.parametrize(
    "text",
    [
        '[axes]\nbackend = "zenoh"\ntuned = true',
        '[axes]\nbackend = "cyclonedds"\nrelay_backend = "ros2"',
        '[axes]\nbackend = "cyclonedds"\nbridge = "builtin"',
        '[axes]\nconfiguration = "x.xml"',
        '[run]\nseconds = 1\n[axes]\nbackend = "zenoh"\nrate = "max"',
        '[run]\nseconds = 1\n[[flows]]\nname = "a"\n[[flows]]\nname = "b"',  # their verdicts would be one
    ],
)
def test_plans_that_it_is_not_for(text, tmp_path, capsys):
    assert run(text, tmp_path) == 2
    assert "advise is not for" in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ([], "give the messages"),
        (["--rate", "20"], "give --size"),
        (["--size", "1KB", "--rate", "0"], "--rate"),
        (["--size", "many", "--rate", "20"], "--size"),
        (["--size", "1KB", "--rate", "20", "--deadline", "soon"], "--deadline"),
        (["--size", "1KB", "--rate", "20", "--in-time", "2"], "--in-time"),
        (["--size", "1KB", "--rate", "20", "--link", "wifi-55"], "wifi-54"),
        (["--size", "1KB", "--rate", "20", "--link", "wifi-54", "--host", "robot"], "remove it or --host"),
        (["--size", "1KB", "--rate", "20", "--host", "robot", "--host", "arm"], "run the command on robot"),
        (["--size", "1KB", "--rate", "20", "--host", "robot.toml"], "robot.toml: No such file"),
        (["plan.toml", "--size", "1KB"], "a plan has its own"),
    ],
)
def test_a_question_that_is_none_is_one_line(words, reason, tmp_path, capsys):
    assert run_trace("advise", *words, "--out", tmp_path / "runs") == 2
    error = capsys.readouterr().err
    assert reason in error
    assert error.count("\n") == 1
    assert not (tmp_path / "runs").exists()


def test_this_machine_may_be_named_next_to_the_other(tmp_path):
    other = tmp_path / "robot.toml"
    other.write_text('[devices.relay]\nssh = "me@robot"\nsetup = ". setup.sh"\n')
    for hosts in ([str(other)], ["here", str(other)], [str(other), platform.node()]):
        plan = ask("502KB", "20", hosts=hosts)
        assert (plan.relay.ssh, plan.relay.setup, plan.has_two_devices) == ("me@robot", ". setup.sh", True)
    assert ask("502KB", "20", hosts=["robot"]).relay.ssh == "robot"
    assert not ask("502KB", "20", hosts=["here"]).has_two_devices


def test_a_link_is_a_preset_or_the_table_of_a_file(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text("[link]\nrate_mbit_s = 25\ndelay_ms = 5\n")
    assert ask("1KB", "20", link="wifi-54").link == PRESETS["wifi-54"]
    plan = ask("1KB", "20", link=str(file))
    assert (plan.link.rate_mbit_s, plan.namespaces, plan.discovery) == (25, True, "subnet")
    file.write_text("[run]\nmessages = 3\n")
    with pytest.raises(OptionError, match="there is no"):
        ask("1KB", "20", link=str(file))


MESSAGE = {"data_type": "binary", "payload_bytes": 145_000, "rate_hz": 8.0}


def proof(statistic, base_ns, new_ns, verdict, ratio=None, low=None, high=None):
    times = {"base_ns": base_ns, "new_ns": new_ns, "ratio": ratio, "ratio_low": low, "ratio_high": high}
    return {**MESSAGE, "statistic": statistic, **times, "verdict": verdict}


def received(base, new, verdict):
    shares = {"base_received_ratio": base, "new_received_ratio": new}
    return {**MESSAGE, **shares, "difference_high": new - base + 0.01, "verdict": verdict}


def test_what_was_received_comes_first_where_the_default_lost_most(sentences):
    rows = [proof("p50", math.inf, 82.4e6, "better", 0.0, 0.0, 0.0), proof("p99", None, None, "inconclusive")]
    advice = {"of": "Fast DDS paced", "against": "its default", "verdict": "better", "proof": rows}
    shown = shown_proof({**advice, "received": [received(0.21, 1.0, "better")]})
    assert [line.split()[6] for line in shown[1:]] == ["received", "response", "response"]
    assert not [line for line in shown if "times" in line or "?" in line]
    sentences(*shown)


def test_what_does_not_pay_names_what_it_was_judged_by(sentences):
    moved = proof("p99", 135e6, 58e6, "inconclusive", 0.43, 0.1, 1.2)
    slower = proof("p50", 10e6, 12e6, "worse", 1.2, 1.1, 1.3)
    alike = received(1.0, 1.0, "same")
    said = [why_not(rows, [alike]) for rows in ([moved], [moved, slower], [proof("p50", 2e6, 1e6, "better", 0.5)])]
    assert ["p99" in text for text in said] == [True, True, False]
    assert said[1].index("p50") < said[1].index("p99")
    assert "received" in why_not([moved], [received(1.0, 0.9, "worse")])
    sentences(*said)


def comparison(*rows, received=("same", -0.01, 0.01), **other):
    verdict, low, high = received
    delivery = {"verdict": [verdict], "difference_low": [low], "difference_high": [high], "is_dead": [False]}
    return SimpleNamespace(
        rows=pl.DataFrame(rows, {"verdict": pl.String, "ratio_low": pl.Float64}, orient="row"),
        delivery=pl.DataFrame(delivery),
        barred=other.get("barred", frozenset()),
        only_base=pl.DataFrame(other.get("only_base", {})),
    )


@pytest.mark.parametrize(
    ("made", "kept"),
    [
        (comparison(("better", 0.5), ("same", 0.98)), True),
        (comparison(("better", 0.5), ("inconclusive", None)), True),
        (comparison(("same", 0.98), ("inconclusive", 0.7)), False),
        (comparison(("better", 0.5), ("worse", 1.1)), False),
        (comparison(("better", 0.5), ("inconclusive", 1.01)), False),
        (comparison(("inconclusive", 0.9), received=("better", 0.1, 0.2)), True),
        (comparison(("better", 0.5), received=("inconclusive", -0.2, -0.01)), False),
        (comparison(("better", 0.5), barred=frozenset([("x",)])), False),
        (comparison(("better", 0.5), only_base={"vendor": ["zenoh"]}), False),
    ],
)
def test_what_pays(made, kept):
    assert pays(made) is kept
