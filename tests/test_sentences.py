"""The golden file of sentences holds those of tests that exist, and no others."""

from __future__ import annotations

import json
from pathlib import Path

TESTS = Path(__file__).parent


def test_every_golden_sentence_has_its_test():
    golden = json.loads((TESTS / "data" / "sentences.json").read_text(encoding="utf-8"))
    named = {tuple(key.partition("[")[0].split("::")) for key in golden}
    assert [f"{file}::{test}" for file, test in sorted(named) if f"def {test}(" not in _text_of(file)] == []


def _text_of(file: str) -> str:
    path = TESTS / file
    return path.read_text(encoding="utf-8") if path.is_file() else ""
