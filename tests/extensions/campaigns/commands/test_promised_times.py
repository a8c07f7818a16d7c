"""What `--dry-run` promises, against what the same commands took: recorded on two cores, where they came before all others (SCHED_RR).

A row is a command, its plan, and what `sweep`, `capacity`, `explain` or `advise` then took as a user called it, start and analysis included.
"""

import json

import pytest
from commands import run_trace

from dds_trace.extensions.campaigns import explain

LEAST, MOST = 0.7, 1.4
LOSSY, FULL = "[link]\nrate_mbit_s = 54\nloss_percent = 1\n", "[link]\nrate_mbit_s = 20\n"
WIRE = "[link]\nname = 'ethernet-100m'\nrate_mbit_s = 100\n"


def plan(run, axes, size, more=""):
    run += "" if "warmup" in run else "\nwarmup = 0"
    return f"[run]\n{run}\n{more}[axes]\n{axes}\n[[matrix]]\nsize = {size}\n"


ROS = "backend = ['ros2', 'zenoh']\nrate = 50"
TWO = "backend = ['socket', 'cyclonedds']\nrate = "
THREE = "backend = ['ros2', 'cyclonedds', 'zenoh']\nreliability = ['reliable', 'best_effort']\nrate = "
BRIDGED = "backend = 'cyclonedds'\nbridge = ['none', 'builtin']\n"
LEFT_OUT = "[[exclude]]\nbridge = 'builtin'\nreason = 'left out'\n"
ONE = plan("seconds = 3", "backend = 'socket'\nrate = 10", "'1KB'")
RECORDED = {
    "one": ("sweep", ONE, 1, 6),
    "two sides": ("sweep --against SAME", ONE, 2, 13),
    "repeats and warm-up": (
        "sweep",
        plan("seconds = 2\nwarmup = 20\nrepeats = 2", TWO + "[20, 100]", "['1KB', '33KB']"),
        16,
        85,
    ),
    "two middlewares": ("sweep", plan("seconds = 3\nrepeats = 2", ROS, "'33KB'"), 4, 28),
    "a bridge left out": ("sweep", LEFT_OUT + plan("seconds = 2\nrepeats = 2", BRIDGED + "rate = 50", "'1KB'"), 2, 11),
    "a bridge": ("sweep", plan("seconds = 2\nrepeats = 2", BRIDGED + "rate = 50", "'1KB'"), 4, 33),
    "a lossy link": ("sweep", plan("seconds = 4\nrepeats = 2", TWO + "20", "['1KB', '33KB']", LOSSY), 8, 57),
    "a lossy link, DDS": ("sweep", plan("seconds = 4", THREE + "10", "['1KB', '33KB', '145KB']", LOSSY), 18, 163),
    "a full link": ("sweep", plan("seconds = 4", "backend = 'socket'\nrate = [20, 50]", "'145KB'", FULL), 2, 24),
    "a full link, DDS": ("sweep", plan("seconds = 4", THREE + "40", "'145KB'", FULL), 6, 86),
    "all rates work": (
        "capacity",
        plan(
            "messages = 50",
            "backend = 'socket'",
            "'33KB'",
            "[search]\nmin_rate = 50\nmax_rate = 400\ndeadline_ms = 100\npercentile = 90\n",
        ),
        7,
        52,
    ),
    "a link ends the search": (
        "capacity",
        plan(
            "seconds = 2",
            "backend = 'socket'",
            "'145KB'",
            f"[search]\nmin_rate = 10\nmax_rate = 400\nseconds = 2\n{WIRE}",
        ),
        10,
        52,
    ),
    "the usual search": ("capacity", plan("settle_seconds = 0.3", "backend = 'socket'", "'145KB'", WIRE), 12, 125),
    "a bridge ends the search": (
        "capacity",
        plan(
            "repeats = 1", BRIDGED, "'33KB'", "[search]\nmin_rate = 20\nmax_rate = 500\nseconds = 1\npercentile = 90\n"
        ),
        23,
        196,
    ),
    "rates": (
        "explain rates",
        plan("messages = 40\nwarmup = 5\nrepeats = 3", "backend = 'cyclonedds'\nrate = [10, 100]", "'33KB'"),
        33,
        163,
    ),
    "sizes": (
        "explain size 33KB..500KB",
        plan("messages = 40\nwarmup = 5\nrepeats = 3", "backend = 'cyclonedds'\nrate = 20", "'33KB'"),
        24,
        108,
    ),
    "advice for Fast DDS": (
        "advise --minutes 3",
        plan(
            "messages = 20\nrepeats = 5",
            "backend = 'ros2'\nrmw = 'rmw_fastrtps_cpp'\nrate = 8",
            "'145KB'",
            "[link]\nrate_mbit_s = 40\ndelay_ms = 3\nloss_percent = 1\n",
        ),
        17,
        187,
    ),
    "advice": (
        "advise --minutes 3",
        plan("seconds = 3\nrepeats = 2", "backend = 'cyclonedds'\nrate = 10", "'33KB'", LOSSY),
        22,
        171,
    ),
}


@pytest.mark.parametrize("name", RECORDED)
def test_a_promise_is_what_the_run_took(name, tmp_path, capsys, monkeypatch):
    words, text, recordings, seconds = RECORDED[name]
    for module in ("extensions.campaigns.rehearsal", "extensions.campaigns.run.runner"):
        monkeypatch.setattr(f"dds_trace.{module}.missing_here", lambda *_: None)
    monkeypatch.setattr(explain, "_refused_conditions", lambda _: {})
    monkeypatch.setattr(explain, "read_limits", lambda: {"net.core.rmem_max": 4 << 20})
    (tmp_path / "plan.toml").write_text(text)
    assert run_trace(*words.split(), tmp_path / "plan.toml", "--dry-run", "--json", "--out", tmp_path) == 0
    promised = json.loads(capsys.readouterr().out)
    assert LEAST < promised["seconds"] / seconds < MOST
    if "recordings" in promised:
        assert promised["recordings"]["least"] <= recordings <= promised["recordings"]["most"]
        assert promised["least_seconds"] * LEAST < seconds < promised["most_seconds"] * MOST
    elif "runs" in promised:
        assert LEAST < promised["runs"] / recordings < MOST
        assert seconds < promised["most_seconds"] * MOST
    else:
        assert len(promised["cells"]) == recordings
