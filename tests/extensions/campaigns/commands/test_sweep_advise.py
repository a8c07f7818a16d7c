"""`dds-trace advise`: what it refuses, and what it prints; benchmarks/bench_advise.py runs it on real links."""

import json
import math
from types import SimpleNamespace

import polars as pl
import pytest

from dds_trace.cli.trace import main
from dds_trace.extensions.campaigns.advice import bundles
from dds_trace.extensions.campaigns.commands import advise as module
from dds_trace.extensions.campaigns.commands.advise import advise
from dds_trace.extensions.campaigns.plan.plan_file import parse_plan
from dds_trace.extensions.gates.costs import LOST_NS, first_look, pays


def run(text, tmp_path, *options):
    plan = tmp_path / "mine.toml"
    plan.write_text(text)
    with pytest.raises(SystemExit) as ended:
        main(["advise", str(plan), "--out", str(tmp_path / "runs"), *options])
    return ended.value.code


@pytest.mark.parametrize(
    "text",
    [
        '[axes]\nbackend = "zenoh"\ntuned = true',
        '[axes]\nbackend = "cyclonedds"\nrelay_backend = "ros2"',
        '[axes]\nbackend = "cyclonedds"\nbridge = "builtin"',
        '[axes]\nconfiguration = "x.xml"',
        '[axes]\nbackend = "zenoh"\n[devices.relay]\nssh = "me@there"',
    ],
)
def test_plans_that_it_is_not_for(text, tmp_path, capsys):
    assert run(text, tmp_path) == 2
    assert "advise is not for" in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()


def test_a_vendor_without_known_settings_keeps_its_default(tmp_path, capsys):
    assert run('[axes]\nbackend = ["socket", "ros2"]', tmp_path) == 0
    printed = capsys.readouterr().out.splitlines()
    assert [line.partition(": ")[0] for line in printed] == ["socket", "fastdds"]


def test_a_dry_run_counts_for_each_vendor_its_own_bundles(tmp_path, capsys):
    run('[run]\nrepeats = 7\n[axes]\nbackend = ["socket", "cyclonedds", "zenoh"]', tmp_path, "--dry-run", "--json")
    cells = [cell["name"] for cell in json.loads(capsys.readouterr().out)["cells"]]
    for vendor in ("socket", "cyclonedds", "zenoh"):
        known = bundles(vendor, parse_plan(f'[axes]\nbackend = "{vendor}"', "x", "x.toml"))
        expected = module.LOOKS * (1 + len(known)) + 2 * 7 if known else 0
        assert sum(vendor in name for name in cells) == expected


@pytest.mark.parametrize(("looks", "proved"), [({"a": 0.5, "unbatched": 0.9}, "a"), ({"a": 0.99}, None), ({}, None)])
def test_only_the_best_look_is_proved(looks, proved, tmp_path, monkeypatch, capsys):
    proofs = []

    def prove(plan, _vendor, path, _folder):
        proofs.append((path.stem, plan.run.repeats))
        return {"kept": True, "reason": "it pays"}

    def written(_vendor, _texts, folder):
        return [folder / "a.json5", folder / "unbatched.json5"]

    monkeypatch.setattr(module, "_look", lambda *_: looks)
    monkeypatch.setattr(module, "_prove", prove)
    monkeypatch.setattr("dds_trace.extensions.campaigns.advice.write_bundles", written)
    plan = parse_plan('[axes]\nbackend = "zenoh"', "x", "x.toml")
    assert advise(plan, tmp_path, as_json=True) == (0 if looks else 10)
    (entry,) = json.loads(capsys.readouterr().out)
    assert proofs == ([(proved, module.PROOFS)] if proved else [])
    assert (entry["kept"], entry["first_look"]) == (bool(proved), looks)


def test_the_variables_are_printed_as_a_shell_takes_them():
    advice = {"vendor": "zenoh", "kept": True, "reason": "it pays", "variables": {"ZENOH_CONFIG_OVERRIDE": "a=1;b=2"}}
    assert "  export ZENOH_CONFIG_OVERRIDE='a=1;b=2'" in module.shown(advice)


MESSAGE = {"data_type": "binary", "payload_bytes": 145_000, "rate_hz": 8.0}


def proof(statistic, base_ns, new_ns, verdict, ratio=None, low=None, high=None):
    times = {"base_ns": base_ns, "new_ns": new_ns, "ratio": ratio, "ratio_low": low, "ratio_high": high}
    return {**MESSAGE, "statistic": statistic, **times, "verdict": verdict}


def received(base, new, verdict):
    shares = {"base_received_ratio": base, "new_received_ratio": new}
    return {**MESSAGE, **shares, "difference_high": new - base + 0.01, "verdict": verdict}


def test_what_was_received_comes_first_where_the_default_lost_most(sentences):
    rows = [proof("p50", math.inf, 82.4e6, "better", 0.0, 0.0, 0.0), proof("p99", None, None, "inconclusive")]
    advice = {"vendor": "fastdds", "kept": True, "reason": "it pays", "proof": rows}
    shown = module.shown({**advice, "received": [received(0.21, 1.0, "better")]})
    assert [line.split()[6] for line in shown[1:]] == ["received", "response", "response"]
    assert not [line for line in shown if "times" in line or "?" in line]
    sentences(*shown)


def test_what_does_not_pay_names_what_it_was_judged_by(sentences):
    moved = proof("p99", 135e6, 58e6, "inconclusive", 0.43, 0.1, 1.2)
    slower = proof("p50", 10e6, 12e6, "worse", 1.2, 1.1, 1.3)
    alike = received(1.0, 1.0, "same")
    said = [
        module._why_not(rows, [alike]) for rows in ([moved], [moved, slower], [proof("p50", 2e6, 1e6, "better", 0.5)])
    ]
    assert ["p99" in text for text in said] == [True, True, False]
    assert said[1].index("p50") < said[1].index("p99")
    assert "received" in module._why_not([moved], [received(1.0, 0.9, "worse")])
    sentences(*said)


def test_a_first_look_is_the_mean_over_results_and_a_lost_message_is_late():
    runs = {1: ("", 0), 2: ("", 1), 3: ("fast", 0), 4: ("fast", 1), 5: ("lossy", 0)}
    responses = {1: 4e6, 2: 16e6, 3: 1e6, 4: 4e6, 5: None}
    messages = pl.DataFrame(
        {
            "run_id": [run for run in runs for _ in range(10)],
            "response_ns": [responses[run] for run in runs for _ in range(10)],
        },
        {"run_id": pl.UInt64, "response_ns": pl.Float64},
    )
    means = first_look(messages, runs)
    assert means == {"": pytest.approx(8e6), "fast": pytest.approx(2e6), "lossy": pytest.approx(LOST_NS)}


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
