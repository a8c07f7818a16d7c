"""The script that computes the tables of an analysis by itself."""

from __future__ import annotations

from pathlib import Path


def bare_analyzer() -> str:
    """Return the script with which the tests compare the analyzer."""
    script = Path(__file__).parents[2] / "tests" / "support" / "bare.py"
    return f"```python\n{script.read_text(encoding='utf-8')}```\n"
