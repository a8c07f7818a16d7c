"""The schemas in the repository are what `just schemas` makes of the records, and the results of docs/results follow them."""

import importlib.util
import json
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def recipe():
    spec = importlib.util.spec_from_file_location("report_schemas", ROOT / "scripts/report_schemas.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["report_schemas"] = module
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("file", ["reports/report.schema.json", "reports/comparison/comparison.schema.json"])
def test_a_schema_is_what_its_records_make(recipe, file):
    made = recipe.schema_text(recipe.SCHEMAS[file]())
    assert (ROOT / file).read_text(encoding="utf-8") == made, "run `just schemas`, and read what changed"


def test_every_field_that_may_be_missing_or_is_narrowed_exists(recipe):
    for record, names in recipe.ADDED.items():
        assert names <= set(record.__dataclass_fields__)
    properties = recipe.report_schema()["properties"]
    for name in recipe.NARROW:
        part, _, field = name.partition(".")
        described = properties[part]
        assert field in described.get("items", described)["properties"], name
    columns = {name for part in properties.values() for name in part.get("items", {}).get("properties", {})}
    assert columns >= recipe.NEVER_NULL | recipe.NULL_PARAMETERS


def test_the_schemas_describe_most_fields(recipe):
    text = json.dumps([make() for make in recipe.SCHEMAS.values()])
    assert text.count('"description"') > 150
