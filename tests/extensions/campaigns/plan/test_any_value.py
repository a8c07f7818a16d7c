import dataclasses
import itertools
import math
import re
import sys

import jsonschema
import pytest
from hostile_values import to_toml, toml_values
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from dds_trace.base.errors import OptionError
from dds_trace.extensions.campaigns.commands.dry_run import dry_run
from dds_trace.extensions.campaigns.plan.cells import AXES
from dds_trace.extensions.campaigns.plan.commands import ping_arguments, relay_arguments
from dds_trace.extensions.campaigns.plan.link import Link
from dds_trace.extensions.campaigns.plan.plan import DeviceSettings, RunSettings, Search
from dds_trace.extensions.campaigns.plan.plan_file import parse_plan, read_plan
from dds_trace.extensions.campaigns.plan.schedule import plan_seconds, schedule
from dds_trace.extensions.campaigns.plan.schema import PLAN_LIMITS, plan_schema

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ARRAYS = {"axes", "matrix", "exclude", "flows"}
MOST_SCHEDULED = 1000

SCHEMA = jsonschema.Draft202012Validator(plan_schema())
BEYOND_A_SCHEMA = (
    "share is a rate",
    r" is nan[;,]",  # JSON has none, and no bound of a schema refuses it
    r"CSV file|the name of the file",  # a link's file that is not there, or a folder's name
    r" is -?[\d.]+(e\+\d+)?, not a whole number",  # 1.0 is an integer of JSON
    r"\\n'; ",  # $ of Python, by which this test reads the patterns, allows one behind the end
    r"Exceeds the limit|nested deeper",  # no TOML
    r"size '|(size|buffer|segment|fragment) is (\d|a number)|--data ",  # what a text means: more than the largest size, no topic's name
    r"has nothing to record|is there twice|has a name of|are more than the|takes more than a year|has more than|would be repeat",
    r"are both|does not know where|needs? both devices|must be below max_rate|an outage has|ping_share needs|file has rate|needs the two sides|needs a \[link\]|\[\[flows\]\]",  # rules of several keys
)
"""Refusals of the parser that the schema does not make, each for the reason beside it."""


def names(record):
    return {each.name for each in dataclasses.fields(record)}


def test_every_key_of_a_plan_has_a_validator():
    for table in ("axes", "matrix"):
        assert set(PLAN_LIMITS[table]) == set(AXES)
    assert set(PLAN_LIMITS["exclude"]) == {*AXES, "reason"}
    assert set(PLAN_LIMITS["run"]) == names(RunSettings)
    assert set(PLAN_LIMITS["devices.relay"]) == {"ssh", *PLAN_LIMITS["devices.ping"]} == names(DeviceSettings)
    assert set(PLAN_LIMITS["search"]) == names(Search)
    assert set(PLAN_LIMITS["link"]) == {"preset", *names(Link)}


def test_axes_have_validators_of_their_own():
    assert {name for name, axis in AXES.items() if axis.kind is not str} >= {"size", "rate", "depth", "tuned"}
    assert AXES["size"].limit.fault(2**31) is not None
    assert AXES["rate"].limit.fault(math.nan) is not None
    assert AXES["depth"].limit.fault(0) is not None


def read_or_refuse(path):
    try:
        plan = read_plan(path)
    except OptionError as error:
        return str(error)
    assert math.isfinite(plan_seconds(dataclasses.replace(plan, run=dataclasses.replace(plan.run, repeats=1))).seconds)
    if len(plan.cells) * plan.run.repeats <= MOST_SCHEDULED:
        for group in schedule(plan):
            for text in relay_arguments(plan, group.need):
                text.encode()
            for cell in group.cells:
                for option, text in itertools.pairwise(ping_arguments(plan, cell, 20.0, "192.0.2.1")):
                    assert (option, text) not in (("--rate", "nan"), ("--wait", "nan"))
                    text.encode()
    return None


def check_plan(folder, text):
    path = folder / "plan.toml"
    path.write_text(text, encoding="utf-8")
    refusal = read_or_refuse(path)
    if refusal is None:
        assert [error.message for error in SCHEMA.iter_errors(tomllib.loads(text))] == []
    else:
        assert refusal.startswith(str(path))
        assert "\n" not in refusal
        assert len(refusal) < 1000
        if not any(re.search(reason, refusal) for reason in BEYOND_A_SCHEMA):
            assert not SCHEMA.is_valid(tomllib.loads(text)), refusal
    return refusal


@pytest.mark.keeps(24)
@pytest.mark.parametrize(("table", "key"), [(table, key) for table, keys in PLAN_LIMITS.items() for key in keys])
@example(value="~nobody-of-that-name")  # a home that is not there
@settings(max_examples=6, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(value=toml_values())
def test_any_value_of_any_key_is_taken_or_refused_in_one_line(tmp_path, table, key, value):
    heading = {"": ""}.get(table, f"[[{table}]]\n" if table in ARRAYS else f"[{table}]\n")
    check_plan(tmp_path, f"{heading}{key} = {to_toml(value)}\n")


@settings(max_examples=30, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.binary(max_size=200))
def test_any_bytes_are_no_plan_in_one_line(tmp_path, data):
    path = tmp_path / "plan.toml"
    path.write_bytes(data)
    refusal = read_or_refuse(path)
    assert refusal is None or (refusal.startswith(str(path)) and "\n" not in refusal)


def test_what_is_wrong_is_named_with_what_to_write(tmp_path, sentences):
    texts = [
        *(
            "[axes]\nrate = nan\n",
            "[axes]\nrate = inf\n",
            "[[exclude]]\nrate = inf\n",
            '[link]\nfile = "a.\\n"\n',
            "[axes]\nsize = '2GB'\n",
            "[axes]\ndepth = 0\n",
        ),
        *("[axes]\ndata = 'file:'\n", "[axes]\ndata = 'topic:'\n", "[axes]\ndata = 'video'\n"),
        *("[run]\nseconds = inf\n", "[run]\nsettle_seconds = -1\n", "[run]\ncutoff_seconds = nan\n"),
        *("[run]\nmessages = 1000000000000\n", f"[run]\nmessages = 1{'0' * 400}\n"),
        "[run]\nseconds = 1e7\n[axes]\nrate = 1000\n",
        "[run]\nmessages = 100000000\n[axes]\nrate = 1\n",
        *("[run]\ndomain = 233\n", "[search]\nresolution = 1\n", "[link]\ndelay_ms = nan\n"),
        *("[devices.relay]\nbridge_port = 99999\n", "name = '../x'\n", "x = " + "[" * 100_000),
    ]
    sentences(*(check_plan(tmp_path, text).replace(str(tmp_path), "FOLDER") for text in texts))
    assert "Exceeds the limit (4300 digits)" in check_plan(tmp_path, f"[run]\nmessages = 1{'0' * 5000}\n")


def test_what_is_no_plan_at_all_is_refused(tmp_path):
    (tmp_path / "latin.toml").write_bytes(b"name = '\xe9'\n")
    assert "a plan is UTF-8 text" in read_or_refuse(tmp_path / "latin.toml")
    with (tmp_path / "large.toml").open("wb") as file:
        file.truncate(17 << 20)
    assert "larger than any file of settings" in read_or_refuse(tmp_path / "large.toml")
    (tmp_path / "link.toml").symlink_to("/dev/zero")
    assert "not a regular file" in read_or_refuse(tmp_path / "link.toml")


@pytest.mark.parametrize(
    ("axes", "repeats", "word"),
    [((1000, 1000), 1, "largest sweep"), ((10, 10), 2001, "largest sweep"), ((150, 150), 1, "at most")],
)
def test_a_plan_without_end_is_refused_before_it_is_listed(tmp_path, axes, repeats, word):
    rates, sizes = ([*range(100, 100 + count)] for count in axes)
    text = f"[run]\nrepeats = {repeats}\n[axes]\nbackend = 'socket'\nrate = {rates}\nsize = {sizes}\n"
    with pytest.raises(OptionError, match=word):
        dry_run(parse_plan(text, "large", "large.toml"), tmp_path, None, None, as_json=False)
