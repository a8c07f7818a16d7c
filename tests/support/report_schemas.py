"""The JSON Schemas of reports and comparisons, and how a test makes them strict."""

import json
from pathlib import Path

ROOMS = Path(__file__).parents[2] / "reports"
REPORT = json.loads((ROOMS / "report.schema.json").read_text(encoding="utf-8"))
COMPARISON = json.loads((ROOMS.parent / "extensions/gates/comparison.schema.json").read_text(encoding="utf-8"))


def closed(schema):
    """The schema with no room for a field that it does not describe, except where traces may extend it."""
    if isinstance(schema, list):
        return [closed(part) for part in schema]
    if not isinstance(schema, dict):
        return schema
    made = {name: closed(part) for name, part in schema.items()}
    is_object = isinstance(made.get("properties"), dict) and "type" in made
    return made | {"additionalProperties": False} if is_object else made
