"""Data and scripts packed into a page, which unpacks them when it is opened (`assets/unpack.js`)."""

from __future__ import annotations

import base64
import gzip
import hashlib
import json
from dataclasses import fields
from functools import lru_cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


def json_island(value: object) -> str:
    """Encode JSON that cannot end its `<script>` element: sorted keys, no NaN."""
    text = json.dumps(
        value, separators=(",", ":"), sort_keys=True, ensure_ascii=False, allow_nan=False, default=_fields
    )
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    # A lone surrogate (of a file name) cannot be written as UTF-8.
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def _fields(record: DataclassInstance) -> dict[str, object]:
    # Not `asdict`, which copies every number of a campaign.
    return {field.name: getattr(record, field.name) for field in fields(record)}


@lru_cache(maxsize=4)  # plotly.js, and scripts of a watched folder
def packed_script(text: str) -> str:
    return packed(text)


def packed(text: str) -> str:
    """Return text as gzip in base64: letters, digits, `+`, `/` and `=`, which cannot end an element."""
    return base64.b64encode(gzip.compress(text.encode("utf-8"), mtime=0)).decode("ascii")


def unpacked(text: str) -> str:
    return gzip.decompress(base64.b64decode(text)).decode("utf-8")


def policy_hash(script: str) -> str:
    return f"sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}"
