from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path

import jsonschema
import pytest

from dds_trace.recorder.sweep.plan.schema import POINTER, SCHEMA_FILE_NAME, TABLES, plan_schema, schema_text

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

TOP = Path(__file__).parents[4]
PLANS = sorted((TOP / "plans").glob("*.toml"))
SCHEMA = jsonschema.Draft202012Validator(plan_schema())


def test_the_stored_schema_is_that_of_the_code():
    stored = (TOP / "plans" / SCHEMA_FILE_NAME).read_text(encoding="utf-8")
    assert stored == schema_text(), "run `just plan-schema`"


def test_the_schema_is_one_and_every_plan_of_ours_keeps_it():
    jsonschema.Draft202012Validator.check_schema(plan_schema())
    for path in PLANS:
        text = path.read_text(encoding="utf-8")
        assert text.startswith(POINTER + "\n")
        assert [error.message for error in SCHEMA.iter_errors(tomllib.loads(text))] == []


def test_every_key_is_in_the_reference_with_its_meaning_and_in_the_schema(monkeypatch):
    pytest.importorskip("sphinx", reason="the extra [docs] is not installed")
    monkeypatch.syspath_prepend(TOP / "docs")
    page, schema = import_module("generated.plan_keys").plan_keys(), plan_schema()
    for name, table in TABLES.items():
        place = schema
        for part in name.split(".") if name else ():
            place = place["properties"][part]
        if name != "thresholds":  # whose keys are names of metrics
            assert place["additionalProperties"] is False
        assert set(place["properties"]) == set(table.words)
        assert table.meaning in page
        for word, key in table.keys.items():
            assert f"| `{word}` |" in page
            assert key.meaning in page


@pytest.mark.parametrize(
    ("text", "is_refused"),
    [
        ("[axes]\nrate = [10, 20]\nsize = ['33KB', 91, '1.5 kib', '']\ntuned = [true, false]", False),
        ("[[axes]]\nrmw = ''\n[[axes]]\ndata = 'bag:x#/y'", False),
        ("[axes]\nrate = [10, '20']", True),
        ("[axes]\nsize = '33 apples'", True),
        ("[axes]\nbackend = 'installed'", False),
        ("[axes]\nrelay_backend = 'installed'", True),
        ("[axes]\nreason = 'x'", True),
        ("[[exclude]]\nreason = 'x'\nrate = 1", False),
        ("[run]\nmessages = 1\nseconds = 0", False),
        ("[run]\nmessages = 1\nseconds = 1", True),
        ("[run]\nmessages = 0", True),
        ("[run]\ndiscovery = 'lan'", True),
        ("[devices.ping]\nssh = 'me@there'", True),
        ("[devices.relay]\nssh = 'me@there'\nssh_options = '-4'", False),
        ("[search]\npercentile = 98", True),
        ("[search]\nresolution = 1", True),
        ("axes = 1", True),
        ("axes = [1]", True),
        ("axis = {}", True),
    ],
)
def test_the_schema_refuses_what_the_parser_refuses(text, is_refused):
    assert (not SCHEMA.is_valid(tomllib.loads(text))) == is_refused
