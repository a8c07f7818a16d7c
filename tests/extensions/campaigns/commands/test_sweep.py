import json
from pathlib import Path
from types import SimpleNamespace

import pytest
from processes import counts_in

from dds_trace.extensions.campaigns.plan.cells import Cell
from dds_trace.extensions.campaigns.plan.plan import Order
from dds_trace.extensions.campaigns.plan.plan_file import read_plan
from dds_trace.extensions.campaigns.plan.schedule import plan_seconds, schedule
from dds_trace.extensions.campaigns.search import MaxRate, RateAnswer
from dds_trace.extensions.campaigns.sweep import SweepOutcome

ROOT = Path(__file__).parents[4]
PLANS = sorted((ROOT / "plans").glob("*.toml"))

PLAN = """
[run]
messages = 100
warmup = 0
[axes]
size = ["33KB", "4MB"]
rate = [10, 1000]
[[exclude]]
size = "33KB"
rate = 1000
reason = "for the test"
"""


@pytest.fixture
def plan(tmp_path):
    path = tmp_path / "small.toml"
    path.write_text(PLAN)
    return path


def installed():
    return [("ros2", None), ("cyclonedds", None)]


def test_paper_plan_has_the_papers_cells():
    cells = read_plan(ROOT / "plans/paper.toml").cells
    for rmw, bridge in (
        ("rmw_fastrtps_cpp", "integration-service"),
        ("rmw_cyclonedds_cpp", "zenoh-bridge-dds"),
        ("rmw_connextdds", "routing-service"),
    ):
        of_vendor = [cell for cell in cells if cell.rmw == rmw]
        for domains in ("none", bridge):
            counts = {
                data: sum(cell.data == data and cell.bridge == domains for cell in of_vendor)
                for data in ("binary", "string", "imu")
            }
            # 9 sizes x 10 rates, 4 lengths x 8 rates, 8 rates
            assert counts == {"binary": 90, "string": 32, "imu": 8}
        assert len(of_vendor) == 260
    assert len(cells) == 780


def test_paper_plan_has_the_papers_sizes():
    cells = read_plan(ROOT / "plans/paper.toml").cells
    assert sorted({cell.size for cell in cells if cell.data == "binary"}) == [
        *(33_000, 67_000, 87_000, 145_000, 294_000, 502_000, 1_000_000, 2_000_000, 4_000_000)
    ]
    assert sorted({cell.size for cell in cells if cell.data == "string"}) == [4, 91, 1405, 2675]


def test_paper_plan_has_the_papers_rates_and_programs():
    plan = read_plan(ROOT / "plans/paper.toml")
    rates = {
        data: sorted({cell.rate for cell in plan.cells if cell.data == data}) for data in ("binary", "string", "imu")
    }
    of_text = [10, 20, 40, 80, 100, 200, 500, 1000]
    assert rates == {"binary": [1, 2, 4, 8, 10, 12, 15, 20, 100, 1000], "string": of_text, "imu": of_text}
    assert {(cell.serialization, cell.executor) for cell in plan.cells} == {("typed", "single")}
    assert min(plan.run.messages_at(cell.rate) for cell in plan.cells) == 400  # an interval for p99 takes 368
    assert plan.run.messages_at(1000) == 20_000


def test_paper_plan_as_run_has_what_its_programs_sent():
    plan, of_text = read_plan(ROOT / "plans/paper-as-run.toml"), read_plan(ROOT / "plans/paper.toml")
    assert (plan.run.messages, plan.run.warmup, plan.run.ping_domain, plan.run.domain) == (151, 0, 5, 10)
    sent = {data: sorted({cell.size for cell in plan.cells if cell.data == data}) for data in ("binary", "string")}
    # width x height x 3 of the images of its repository
    images = [(200, 109), (225, 225), (273, 204), (1175, 661), (1434, 954)]
    assert sent == {"binary": [3 * width * height for width, height in images], "string": [4, 91, 1397, 2671]}
    imu = read_plan(ROOT / "plans/paper-as-run-imu.toml")
    assert (imu.run.messages, imu.run.warmup, {cell.data for cell in imu.cells}) == (300, 0, {"imu"})
    for cells in (plan.cells, imu.cells):
        assert {cell.depth for cell in cells} == {1}
        assert {(cell.serialization, cell.executor) for cell in cells} == {("typed", "single")}
        assert {(cell.rmw, cell.bridge) for cell in cells} == {(cell.rmw, cell.bridge) for cell in of_text.cells}
    rates = {(cell.data, cell.rate) for cell in (*plan.cells, *imu.cells)}
    assert rates == {(cell.data, cell.rate) for cell in of_text.cells}


def test_paper_plan_on_a_link_is_a_part_of_both_in_twenty_minutes():
    plan = read_plan(ROOT / "plans/paper-link.toml")
    sizes = {depth: sorted({cell.size for cell in plan.cells if cell.depth == depth}) for depth in (1, 10)}
    as_run, of_text = (
        {cell.size for cell in read_plan(ROOT / f"plans/{name}.toml").cells} for name in ("paper-as-run", "paper")
    )
    assert len(sizes[1]) == len(sizes[10]) == 3
    assert (set(sizes[1]) <= as_run, set(sizes[10]) <= of_text) == (True, True)
    assert plan.link.rate_mbit_s == 100
    assert plan_seconds(plan).seconds <= 22 * 60


THREE_REPEATS = (
    "actions calls drive emulated-link fan-out gallery installed-bridges outages paper-claims paper-explain-rates "
    "paper-explain-size paper-link tsc tsc-wifi nodes"
)


@pytest.mark.parametrize("path", PLANS, ids=lambda path: path.stem)
def test_every_plan_that_we_ship_can_be_read(path):
    assert schedule(read_plan(path, installed))


@pytest.mark.parametrize("path", PLANS, ids=lambda path: path.stem)
def test_every_plan_that_we_ship_has_passes_in_alternating_order_five_where_nothing_hurries(path):
    asked = read_plan(path, installed).run
    repeats = 30 if path.stem == "stacks" else 3 if path.stem in THREE_REPEATS.split() else 5
    assert (asked.repeats, asked.order) == (repeats, Order.ALTERNATING)


def test_plan_of_the_results_takes_half_an_hour_at_most_with_what_runs_on_one_machine():
    middlewares = [(name, None) for name in ("ros2", "cyclonedds", "zenoh", "socket")]
    asked = read_plan(ROOT / "plans/loopback.toml", lambda: middlewares)
    # five sizes: four middlewares in one domain, and ROS 2 over two bridges
    assert len(asked.cells) == 5 * (4 + 2)
    assert {cell.rate for cell in asked.cells} == {20}
    assert sorted({cell.size for cell in asked.cells}) == [33_000, 145_000, 502_000, 1_000_000, 4_000_000]
    assert plan_seconds(asked).seconds <= 30 * 60


def test_demo_allows_verdicts_on_all_that_pip_brings_within_four_minutes():
    middlewares = [(name, None) for name in ("ros2", "cyclonedds", "zenoh", "socket")]
    asked = read_plan(ROOT / "plans/demo.toml", lambda: middlewares)
    assert {(cell.backend, cell.bridge) for cell in asked.cells} == {
        *((name, "none") for name, _ in middlewares),
        *(("ros2", bridge) for bridge in ("builtin", "builtin-zenoh")),
    }
    assert sorted({cell.size for cell in asked.cells}) == [33_000, 502_000]
    assert (asked.run.repeats, asked.run.order, len(asked.cells)) == (5, Order.ALTERNATING, 12)
    assert asked.run.repeats * asked.run.messages >= 100  # p99 takes 100
    assert plan_seconds(asked).seconds <= 4 * 60


def test_quick_plan_stays_a_matter_of_minutes():
    assert plan_seconds(read_plan(ROOT / "plans/quick.toml")).seconds <= 4 * 60
    assert plan_seconds(read_plan(ROOT / "plans/paper-claims.toml")).seconds <= 2 * 3600


def test_quick_plan_is_the_three_kinds_of_data_in_one_domain_and_two():
    cells = read_plan(ROOT / "plans/quick.toml").cells
    assert {(cell.data, cell.bridge) for cell in cells} == {
        (data, bridge) for data in ("binary", "string", "imu") for bridge in ("none", "builtin")
    }


@pytest.fixture
def unrehearsed(monkeypatch):
    refused = {}
    monkeypatch.setattr("dds_trace.extensions.campaigns.rehearsal.check_plan", lambda *_: refused)
    return refused


@pytest.mark.usefixtures("unrehearsed")
def test_dry_run_of_the_papers_plan_from_the_command_line(call):
    code, out, err = call(ROOT / "plans/paper.toml", "--dry-run")
    lines = out.splitlines()
    assert sum(line.startswith("  ros2-") for line in lines) == 5 * 780
    assert counts_in(lines[-1])[:3] == [3900, 0, 15]  # recordings, left out, starts of a relay
    assert (code, err) == (0, "")


def test_a_reason_is_told_once_for_all_its_cells(call, plan, unrehearsed, sentences):
    unrehearsed.update(dict.fromkeys(["one", "two", "three"], "not installed"), four="no licence")
    code, _, err = call(plan, "--dry-run")
    assert code == 10
    sentences(*err.splitlines())


@pytest.mark.usefixtures("unrehearsed")
@pytest.mark.parametrize("more", [(), ("--print", "relay")])
def test_dry_run_names_what_is_left_out_what_cannot_be_carried_and_a_history_too_short(call, plan, sentences, more):
    code, out, _ = call(plan, "--dry-run", *more)
    assert (code, out.count("warning: ")) == (0, 1)  # 10 Hz are fine
    sentences(*out.splitlines())


@pytest.mark.usefixtures("unrehearsed")
def test_dry_run_as_json(call, plan):
    _, out, _ = call(plan, "--dry-run", "--json")
    listed = json.loads(out)
    assert listed["plan"] == "small"
    assert listed["cells"][0]["name"] == "ros2_same_binary-33KB_10Hz"
    assert listed["cells"][0]["seconds"] == 10.0


def test_typo_in_a_plan_is_one_line_and_exit_code_2(call, tmp_path, sentences):
    path = tmp_path / "typo.toml"
    path.write_text("[run]\nmesages = 3\n")
    code, out, err = call(path)
    assert (code, out) == (2, "")
    sentences(err.replace(str(path), "PLAN"))


def test_exit_codes_tell_complete_from_incomplete(call, plan, monkeypatch, tmp_path):
    import dds_trace.extensions.campaigns.sweep

    outcomes = [SweepOutcome(tmp_path, 3, {}), SweepOutcome(tmp_path, 3, {"a": "no echo"})]
    monkeypatch.setattr(
        dds_trace.extensions.campaigns.sweep, "run_sweep", lambda *_arguments, **_options: outcomes.pop(0)
    )
    assert call(plan) == (0, f"Wrote {tmp_path}\n3 of 3 recordings are complete\n", "")
    assert call(plan) == (10, f"Wrote {tmp_path}\n2 of 3 recordings are complete\n", "a: no echo\n")


@pytest.mark.parametrize("more", [[], ["--against", "SAME", "--json"]])
def test_a_missing_middleware_is_one_line_and_no_recording_starts(call, tmp_path, monkeypatch, more):
    from dds_trace.extensions.campaigns.run import runner

    absent = SimpleNamespace(label="Zenoh", install="pip install zenoh", find_installed=list)
    monkeypatch.setattr(runner, "load_backend", lambda _: absent)
    path = tmp_path / "absent.toml"
    path.write_text('[axes]\nbackend = "zenoh"\nrate = [10, 20, 30, 40]\n')
    code, out, err = call(path, "--out", tmp_path / "runs", *more)
    lines = err.splitlines()
    sides = 2 if more else 1
    assert code == 10
    assert [line.rpartition("; ")[2] for line in lines[:sides]] == ["4 recordings are left out"] * sides
    assert len(lines) == 2 * sides
    assert all("and 3 more: Zenoh" in line for line in lines[sides:])
    assert "0 of 4" in out or json.loads(out)["cells"] == 8
    assert not list((tmp_path / "runs").rglob("*.mcap"))


def test_a_missing_ros_middleware_is_one_line_in_a_search_too(call, tmp_path, monkeypatch):
    from dds_trace.recorder.backends.ros2 import installation

    monkeypatch.setattr(installation, "has_package", lambda _: True)
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    path = tmp_path / "absent.toml"
    path.write_text('[axes]\nrmw = "rmw_of_somebody_cpp"\nsize = [100, 200, 300]\n')
    for more, last in (([], "100B_10Hz and 2 more: rmw_of_somebody_cpp is not here"), (["capacity"], "relay: ros2")):
        code, out, err = call(path, "--out", tmp_path / "runs", command=more[0] if more else "sweep")
        assert code == 10
        first, *others = err.splitlines()
        assert first.startswith("rmw_of_somebody_cpp is not here: apt install")
        assert first.endswith("; 3 recordings are left out")
        assert [last in line for line in others] == [True]
        assert out.count("rmw_of_somebody_cpp is not here") == 3 * len(more)
    assert not list((tmp_path / "runs").rglob("*.mcap"))


def test_interruption_has_the_shells_exit_code_and_says_how_to_go_on(call, plan, monkeypatch):
    import dds_trace.extensions.campaigns.sweep

    def interrupted(*_arguments, **_options):
        raise KeyboardInterrupt

    monkeypatch.setattr(dds_trace.extensions.campaigns.sweep, "run_sweep", interrupted)
    code, _, err = call(plan)
    assert code == 130
    assert "the same command continues" in err


def test_max_rate_prints_a_table_and_writes_it(call, plan, monkeypatch, tmp_path):
    import dds_trace.extensions.campaigns.sweep

    found = [MaxRate(Cell(size=33_000, rate=480.0), RateAnswer.FOUND, 510.0, (3, 3), "2 % lost")]
    monkeypatch.setattr(dds_trace.extensions.campaigns.sweep, "run_search", lambda *_arguments: (tmp_path, found))
    code, out, _ = call(plan, command="capacity")
    assert code == 0
    assert "480" in out
    assert f"Wrote {tmp_path / 'max_rate.svg'}" in out


def test_help_fits_80_columns(call, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    code, out, _ = call("--help")
    assert code == 0
    assert max(map(len, out.splitlines())) <= 80
