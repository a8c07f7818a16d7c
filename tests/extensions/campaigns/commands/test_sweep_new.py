import io
import json
import sys

import jsonschema
import pytest
from commands import run_trace

from dds_trace.extensions.campaigns.plan.link import PRESETS
from dds_trace.extensions.campaigns.plan.plan_file import read_plan
from dds_trace.extensions.campaigns.plan.schema import plan_schema
from dds_trace.extensions.campaigns.plan.template import COMPARISONS

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

INSTALLED = [("ros2", "rmw_fastrtps_cpp"), ("zenoh", None)]


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture
def new(tmp_path, monkeypatch, capsys):
    """Call `dds-trace sweep new` on a file of the folder, with lines typed on a terminal or none; exit code, stdout, stderr."""

    def call(name, *options, typed=None):
        monkeypatch.setattr("sys.stdin", io.StringIO() if typed is None else Terminal("\n".join(typed) + "\n"))
        monkeypatch.setattr("sys.argv", ["dds-trace"])
        return run_trace("sweep", "new", tmp_path / name, *options), *capsys.readouterr()

    return call


def cells_of(path):
    jsonschema.validate(tomllib.loads(path.read_text()), plan_schema())
    return read_plan(path, lambda: INSTALLED)


def test_answers_on_a_terminal_are_a_plan_with_a_schema_beside_it(new, tmp_path):
    code, out, _ = new("mine.toml", typed=["binary 33KB @ 20, imu @ 100 Hz", "middleware, tuning", "wifi-54"])
    assert code == 0
    assert f"Wrote {tmp_path / 'mine.toml'}\n" in out
    plan = cells_of(tmp_path / "mine.toml")
    assert {(cell.data, cell.size, cell.rate) for cell in plan.cells} == {("binary", 33000, 20), ("imu", None, 100)}
    assert {cell.backend for cell in plan.cells} == {"ros2", "zenoh"}
    assert {cell.tuned for cell in plan.cells} == {True, False}
    assert plan.link == PRESETS["wifi-54"]
    assert (plan.run.messages, plan.run.repeats, plan.run.order.value) == (1000, 5, "alternating")
    text = (tmp_path / "mine.toml").read_text()
    assert text.startswith("#:schema ./plan.schema.json\n")
    assert "dds-trace sweep mine.toml --rehearse\n" in text
    assert max(map(len, text.splitlines())) <= 80
    assert json.loads((tmp_path / "plan.schema.json").read_text()) == plan_schema()


def test_enter_takes_the_answer_in_brackets_and_a_wrong_one_is_asked_again(new, tmp_path):
    code, out, _ = new("mine.toml", typed=["video @ 3", "", "middlware", "", "there", ""])
    assert code == 0
    for said in ("there is no data type 'video'", "did you mean 'middleware'?", "'there': write here, USER@HOST"):
        assert said in out
    shown = out.replace("]: ", "]: \n").splitlines()  # what is typed is not echoed here
    questions = [line for line in shown if not line.startswith(("Error: ", "Wrote "))]
    assert max(map(len, questions)) <= 80
    assert len(cells_of(tmp_path / "mine.toml").cells) == 4


def test_options_answer_where_nobody_types(new, tmp_path):
    code, _, _ = new("far.toml", "--send", "file:my photo.jpg @ 0.5", "--compare", "nothing", "--relay", "pi@robot")
    assert code == 0
    plan = cells_of(tmp_path / "far.toml")
    assert [(cell.data, cell.rate) for cell in plan.cells] == [("file:my photo.jpg", 0.5)]
    assert plan.relay.ssh == "pi@robot"


@pytest.mark.parametrize("word", COMPARISONS)
def test_everything_that_can_be_compared_makes_a_plan(new, tmp_path, word):
    new(f"{word}.toml", "--send", "string @ 10", "--compare", word, "--relay", "here")
    assert len(cells_of(tmp_path / f"{word}.toml").cells) == 2


@pytest.mark.parametrize(
    ("name", "options", "code", "said"),
    [
        ("x.toml", [], 2, "there is no terminal to ask on: give --send, for example"),
        ("x.toml", ["--send", "imu"], 2, "--send 'imu': write a kind, a size and a rate"),
        ("x.toml", ["--send", "imu @ 0"], 2, "--send the rate 0: a rate in messages a second"),
        ("x.toml", ["--send", "binary 2GB @ 1"], 2, "the size of a message in bytes must be between 0 and"),
        ("x.toml", ["--send", "binary 3 apples @ 1"], 2, "is not understood"),
        ("x.json", [], 2, "a plan is a .toml file"),
        ("no/x.toml", ["--send", "imu @ 1", "--compare", "", "--relay", "here"], 6, "cannot be written (No such file"),
    ],
)
def test_what_cannot_be_a_plan_is_one_line(new, tmp_path, name, options, code, said):
    ended, _, err = new(name, *options)
    assert ended == code
    assert said in err
    assert err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_overwritten(new, tmp_path):
    (tmp_path / "mine.toml").write_text("mine")
    (tmp_path / "plan.schema.json").write_text("theirs")
    code, _, err = new("mine.toml", typed=[])
    assert code == 5
    assert "is there already; choose another name" in err
    assert new("other.toml", "--send", "imu @ 1", "--compare", "nothing", "--relay", "here")[0] == 0
    assert [(tmp_path / name).read_text() for name in ("mine.toml", "plan.schema.json")] == ["mine", "theirs"]
