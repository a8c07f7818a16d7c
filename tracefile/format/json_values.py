"""JSON as Python has it, so that nobody needs `Any` for what `json.loads` returns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeAlias

Json: TypeAlias = "bool | int | float | str | Sequence[Json] | Mapping[str, Json] | None"
"""A value of JSON; objects are mappings, arrays are sequences, numbers are int or float."""

JsonObject: TypeAlias = Mapping[str, Json]
"""A JSON object, which is what every description and every sample is."""
