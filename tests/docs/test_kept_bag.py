"""docs/results/drive: the tutorial quotes what the kept bag gives."""

from __future__ import annotations

import re
import tarfile
from pathlib import Path

from dds_trace.analyzer.recordings.topics import analyze_topics
from dds_trace.reports.topics.renderers import print_topics

DOCS = Path(__file__).parents[2] / "docs"


def test_the_tutorial_quotes_the_card_of_the_kept_bag(tmp_path, monkeypatch, capsys):
    archive = DOCS / "results" / "drive" / "traces.tar.xz"
    assert archive.stat().st_size <= 1_000_000
    with tarfile.open(archive) as bag:
        bag.extractall(tmp_path, filter="data")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    print_topics(analyze_topics([Path("drive")]))
    shown = [line.rstrip() for line in capsys.readouterr().out.splitlines()]
    text = (DOCS / "tutorials" / "bag.md").read_text(encoding="utf-8")
    quoted = re.findall(r"```text\n(.*?)```", text, re.DOTALL)[0]
    assert [line.rstrip() for line in quoted.splitlines() if line.rstrip() not in shown] == []
