import ast
import json
from pathlib import Path

TESTS = Path(__file__).parent
SENTENCE_WORDS = 7
MOST_QUOTING = 1
"""The changes of mutants are code."""


def test_every_golden_sentence_has_its_test():
    golden = json.loads((TESTS / "data" / "sentences.json").read_text(encoding="utf-8"))
    named = {tuple(key.partition("[")[0].split("::")) for key in golden}
    assert [f"{file}::{test}" for file, test in sorted(named) if f"def {test}(" not in _text_of(file)] == []


def _text_of(file):
    path = TESTS / file
    return path.read_text(encoding="utf-8") if path.is_file() else ""


def test_asserts_quote_no_sentences():
    quoting = [
        f"{path.relative_to(TESTS)}:{node.lineno}"
        for path in TESTS.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Assert) and _quotes_a_sentence(node.test)
    ]
    assert len(quoting) <= MOST_QUOTING, quoting


def _quotes_a_sentence(condition):
    strings = [part.value for part in ast.walk(condition) if isinstance(part, ast.Constant)]
    return any(isinstance(string, str) and len(string.split()) >= SENTENCE_WORDS for string in strings)
