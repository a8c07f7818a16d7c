"""What is kept of campaigns, and what is not believed of it."""

import json
import math
import os

import polars as pl
import pytest
from roundtrip_frames import MS, in_runs

from dds_trace.analyzer.verdicts.job import Job
from dds_trace.extensions.campaigns.learning.results import campaign_of, keep, read_campaigns, results_folder

JOB = Job("binary", 33_000, 10.0, 50 * MS, 0.8, metric="rtt")


def measured(run_id=1, lost=0, **parameters):
    return campaign_of(in_runs([5 * MS] * (100 - lost) + [None] * lost, run_id=run_id, **parameters), JOB)


def test_a_campaign_comes_back_as_it_was_kept():
    campaign = measured(lost=20, setting="link=wifi(loss_percent=1,rate_mbit_s=54),load=busy")
    (result,) = campaign.results
    assert result.times_ns["response 0.5"] == pytest.approx(10 * MS, rel=0.01)
    assert result.times_ns["rtt 0.8"] > 0  # the job's own
    assert math.isinf(result.times_ns["response 0.9"])
    assert str(results_folder()) in keep(campaign)
    assert read_campaigns() == [campaign]
    assert read_campaigns(campaign.runs[:1]) == []


def test_a_campaign_that_went_on_takes_the_place_of_its_beginning():
    first, whole = measured(), campaign_of(pl.concat([in_runs([5 * MS] * 100, run_id=n) for n in (1, 2)]), JOB)
    for campaign in (first, measured(3), whole):
        keep(campaign)
    assert {campaign.runs for campaign in read_campaigns()} == {measured(3).runs, whole.runs}


def damaged(change):
    def write(path):
        value = json.loads(path.read_text())
        change(value["results"][0])
        path.write_text(json.dumps(value))

    return write


FAULTS = {
    "cut": lambda path: path.write_bytes(path.read_bytes()[:-9]),
    "binary": lambda path: path.write_bytes(b"\xff\0" * 99),
    "deep": lambda path: path.write_text("[" * 100_000),
    "list": lambda path: path.write_text("[]"),
    "long": lambda path: os.truncate(path, 1 << 40),
    "pipe": lambda path: (path.unlink(), os.mkfifo(path)),
    "folder": lambda path: (path.unlink(), path.mkdir()),
    "dangling": lambda path: (path.unlink(), path.symlink_to("nowhere")),
    "text as time": damaged(lambda result: result["times_ns"].update({"response 0.5": "quick"})),
    "time below 0": damaged(lambda result: result["times_ns"].update({"response 0.5": -1.0})),
    "not a number": damaged(lambda result: result["times_ns"].update({"response 0.5": "nan"})),
    "text as size": damaged(lambda result: result["parameters"].update(payload_bytes="large")),
    "rate": damaged(lambda result: result["parameters"].update(rate_hz="inf")),
    "no vendor": damaged(lambda result: result["parameters"].pop("vendor")),
    "number as setting": damaged(lambda result: result["parameters"].update(setting=7)),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_damaged_one_is_one_line_and_the_others_are_read(fault, capsys):
    keep(measured(1))
    (path,) = results_folder().iterdir()
    keep(measured(2))
    FAULTS[fault](path)
    assert read_campaigns() == [measured(2)]
    (line,) = capsys.readouterr().err.splitlines()
    assert str(path) in line
    assert line.endswith("remove it")


def test_of_another_user_nothing_is_believed(capsys, monkeypatch):
    keep(measured())
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    assert read_campaigns() == []
    assert "belongs to another user" in capsys.readouterr().err
