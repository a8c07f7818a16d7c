import re
from dataclasses import replace
from pathlib import Path

import pytest

from dds_trace.base.errors import OptionError
from dds_trace.extensions.bridges import BRIDGE_MODULES
from dds_trace.extensions.campaigns.plan.commands import ping_arguments, relay_arguments
from dds_trace.extensions.campaigns.plan.link import PRESETS
from dds_trace.extensions.campaigns.plan.plan import Order
from dds_trace.extensions.campaigns.plan.plan_file import parse_plan, read_plan

RUN = "[run]\nmessages = 10\n"

FULL = """
name = "all"
description = "every table once"

[run]
seconds = 2.5
warmup = 3
order = "shuffled"
seed = 7
repeats = 2
domain = 30
ping_domain = 31

[axes]
rmw = ["rmw_fastrtps_cpp", "rmw_cyclonedds_cpp"]
bridge = ["none", "builtin"]

[[matrix]]
data = "binary"
size = ["33KB", "4MB"]
rate = [1, 0.5]

[[matrix]]
data = "imu"
reliability = "best_effort"

[[exclude]]
size = "4MB"
rmw = "rmw_cyclonedds_cpp"
reason = "not today"

[link]
preset = "wifi-54"
delay_ms = 3

[search]
deadline_ms = 20
"""


def parse(text, **options):
    return parse_plan(text, "plan", "plan.toml", **options)


def test_plan_is_every_combination_without_the_excluded_ones():
    plan = parse(FULL)
    # 2 rmw x 2 bridges x (2 sizes x 2 rates + 1 imu) = 20, of which cyclone x 2 bridges x 4 MB x 2 rates = 4 are excluded
    assert len(plan.cells) == 16
    assert [reason for _, reason in plan.excluded] == ["not today"] * 4
    assert {(cell.size, cell.rate) for cell in plan.cells} == {
        (33_000, 1.0),
        (33_000, 0.5),
        (4_000_000, 1.0),
        (4_000_000, 0.5),
        (None, 10.0),
    }
    assert all(cell.reliability == "best_effort" for cell in plan.cells if cell.data == "imu")
    assert plan.name == "all"
    assert plan.run.order is Order.SHUFFLED
    assert plan.search.deadline_ms == 20


def test_seconds_become_messages_by_the_rate():
    run = parse(FULL).run
    assert run.messages_at(10.0) == 25
    assert run.messages_at(0.1) == 1
    assert run.planned_seconds(10.0) == pytest.approx(2.8)  # 25 and 3 of warm-up


def test_link_takes_a_preset_with_changes_and_says_so():
    plan = parse(FULL)
    assert plan.link is not None
    assert plan.link.rate_mbit_s == PRESETS["wifi-54"].rate_mbit_s
    assert plan.link.delay_ms == 3
    assert plan.connectivity == "emulated-wifi-54-changed"
    assert plan.namespaces
    assert plan.discovery == "subnet"


def test_one_machine_stays_on_loopback():
    plan = parse(RUN)
    assert plan.connectivity == "loopback"
    assert plan.discovery == "localhost"
    assert len(plan.cells) == 1


def test_installed_middlewares_are_asked_for_when_the_plan_does():
    plan = parse(
        RUN + '[axes]\nbackend = "installed"\nrate = [1, 2]\n',
        installed=lambda: [("ros2", "rmw_fastrtps_cpp"), ("socket", None)],
    )
    assert [(cell.backend, cell.rmw, cell.rate) for cell in plan.cells] == [
        ("ros2", "rmw_fastrtps_cpp", 1.0),
        ("ros2", "rmw_fastrtps_cpp", 2.0),
        ("socket", None, 1.0),
        ("socket", None, 2.0),
    ]


def test_wrong_key_or_value_is_named_with_the_nearest_remedy(sentences):
    texts = [
        *("[rum]\n", "[run]\nmesages = 1\n", "run = 1\n", "matrix = [1]\n"),
        *(RUN + "[axes]\nsizes = 1\n", RUN + "[[matrix]]\nrates = 1\n", RUN + "[[exclude]]\nbrigde = 'x'\n"),
        *(RUN + "[link]\npreset = 'wifi54'\n", RUN + "[link]\ndelay = 1\n"),
        *(RUN + "[link]\nloss_percent = 101\n", RUN + "[link]\noutage_ms = 10\n"),
        *(RUN + "[axes]\nsize = 'big'\n", RUN + "[axes]\nrate = '10'\n", RUN + "[axes]\nrate = 0\n"),
        *(RUN + "[axes]\ntuned = 1\n", RUN + "[axes]\ndepth = true\n", RUN + "[axes]\ntransport = 'upd'\n"),
        *(RUN + "[axes]\nreliability = 'relaible'\n", RUN + '[axes]\nbridge = "bultin"\n'),
        *(RUN + "[axes]\nrate = [1, 1]\n", RUN + "[axes]\nrate = []\n"),
        *("[run]\nmessages = 1\norder = 'shufled'\n", "[run]\nmessages = 1\nseconds = 1\n"),
        *("[run]\nmessages = 0\n[axes]\nrate = 1\n", "[run]\nmessages = 1\nrepeats = 0\n"),
        "[run]\nmessages = 1\ndiscovery = 'here'\n",
        "[run]\nmessages = 1\ndomain = 5\n[axes]\nbridge = 'builtin'\n",
        *(RUN + "[devices.realy]\nssh = 'x'\n", RUN + "[devices.ping]\nssh = 'x'\n"),
        RUN + "[devices.relay]\nssh = 'x'\n[network]\nnamespaces = true\n",
        RUN + "[search]\nmin_rate = 100\nmax_rate = 10\n",
    ]
    sentences(*map(refusal, texts))
    assert refusal("[run\n").startswith("plan.toml: ")


def refusal(text):
    with pytest.raises(OptionError, match=r"^plan\.toml") as raised:
        parse(text)
    return str(raised.value)


@pytest.mark.parametrize(
    "text",
    [
        "[run]\ncutoff_seconds = inf\n",
        "[run]\nsettle_seconds = -1\n",
        "[run]\nseconds = nan\n",
        "[run]\nsettle_seconds = 1e300\n",
        "[axes]\nrate = inf\n",
        "[axes]\nrate = 1e-300\n",
        f"[axes]\nrate = 1{'0' * 400}\n",
        "[link]\nrate_mbit_s = nan\n",
        f"[run]\nmessages = 1{'0' * 400}\n",
    ],
)
def test_times_and_rates_without_end_are_refused(text):
    with pytest.raises(OptionError, match=r"plan\.toml"):
        parse_plan(text + '[[matrix]]\ndata = "imu"\n', "plan", "plan.toml")


def test_a_plan_that_is_no_utf8_is_named(tmp_path):
    (tmp_path / "plan.toml").write_bytes(b'name = "\xf0\x04"\n')
    with pytest.raises(OptionError, match=r"plan\.toml.*UTF-8"):
        read_plan(tmp_path / "plan.toml")


def test_missing_file_is_a_clear_error(tmp_path):
    with pytest.raises(OptionError, match=r"none\.toml: No such file"):
        read_plan(tmp_path / "none.toml")


def test_digest_changes_with_the_settings_and_not_with_more_cells():
    plan = parse(RUN)
    assert parse(RUN + "[axes]\nrate = [1, 2]\n").digest == plan.digest
    assert parse(f"{RUN}attempts = 5\n").digest == plan.digest
    assert parse("[run]\nmessages = 11\n").digest != plan.digest
    assert parse(f"{RUN}wire = true\n").digest != plan.digest
    assert parse(RUN + "[link]\npreset = '5g'\n").digest != plan.digest


def test_a_plan_of_an_older_version_keeps_its_digest():
    assert parse(RUN).digest == "07a0d250d757d10b"


def test_the_wire_is_captured_on_both_sides():
    plan = parse(RUN + "wire = true\n")
    (cell,) = plan.cells
    assert "--wire" in ping_arguments(plan, cell, 1.0, None)
    assert "--wire" in relay_arguments(plan, cell.relay)
    assert "--wire" not in relay_arguments(parse(RUN), cell.relay)


def test_own_cost_is_measured_in_the_first_passes_alone():
    for passes, measured in ((0, [True] * 3), (1, [True, False, False]), (2, [True, True, False])):
        plan = parse(f"{RUN}repeats = 3\nown_cost_passes = {passes}\n")
        assert plan.digest == parse(RUN).digest
        for number, measures in enumerate(measured, 1):
            cell = replace(plan.cells[0], repeat=number)
            for arguments in (ping_arguments(plan, cell, 1.0, None), relay_arguments(plan, cell.relay, number)):
                assert ("--no-own-cost" not in arguments) is measures


def test_examples_of_the_documentation_are_plans():
    text = (Path(__file__).parents[4] / "docs" / "how-to" / "sweep.md").read_text()
    whole, *parts = re.findall(r"```toml\n(.*?)```", text, re.DOTALL)
    # 2 rmw x 2 bridges x (2 sizes x 2 rates + 2 rates of imu), without 2 bridges x 2 rates of Cyclone at 4 MB
    assert len(parse(whole).cells) == 20
    for part in parts:
        parse(RUN + part)


def test_bridges_and_backends_of_a_plan_are_those_of_the_tables(monkeypatch):
    with pytest.raises(OptionError, match=r"\[axes\]: relay_backend is 'dds'; choose one of ros2, cyclonedds"):
        parse(RUN + '[axes]\nrelay_backend = "dds"\n')
    monkeypatch.setitem(BRIDGE_MODULES, "added-later", "no_module_is_loaded_for_this")
    plan = parse(RUN + '[axes]\nbridge = ["none", "added-later"]\n')
    assert [cell.bridge for cell in plan.cells] == ["none", "added-later"]


def test_a_rate_of_max_lasts_for_the_seconds_of_the_plan():
    plan = parse("[run]\nseconds = 2.5\n[axes]\nrate = ['max', 10]\n[[exclude]]\nrate = 10\n")
    (cell,) = plan.cells
    assert cell.name == "ros2_same_binary_max"
    assert plan.run.planned_seconds(cell.rate) == 2.5
    arguments = ping_arguments(plan, cell, 20, None)
    assert [arguments[arguments.index(name) + 1] for name in ("--rate", "--duration")] == ["max", "2.5"]
    assert "--messages" not in arguments


@pytest.mark.parametrize(
    "text",
    [
        RUN + "[axes]\nrate = 'max'\n",
        "[run]\nseconds = 1\n[network]\nnamespaces = true\n[axes]\nrate = 'max'\noutage = 1\n",
        RUN + "[axes]\nping_share = 0.5\n",
    ],
)
def test_a_rate_of_max_needs_a_time_and_a_share_needs_it(text):
    with pytest.raises(OptionError, match="max"):
        parse(text)
