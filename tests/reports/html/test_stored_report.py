"""The pages of docs/results: small enough to be kept, and whole again with plotly.js put back."""

import base64
import gzip
import hashlib
import re
import subprocess
import sys
from html import unescape
from pathlib import Path

import pytest
from analyses import small_campaign

from dds_trace.reports.book.book import Book
from dds_trace.reports.html import page

ROOT = Path(__file__).parents[3]
SCRIPT = ROOT / "scripts" / "stored_report.py"
STORED = sorted((ROOT / "docs" / "results").glob("*/report.html.gz"))


def stored_report(*arguments):
    return subprocess.run([sys.executable, SCRIPT, *map(str, arguments)], capture_output=True, text=True, check=False)


def test_a_page_comes_back_as_it_was(tmp_path):
    whole = tmp_path / "report.html"
    whole.write_text(page.render(Book(small_campaign())), encoding="utf-8")
    kept = tmp_path / "campaign" / "report.html.gz"
    assert stored_report("keep", whole, kept).returncode == 0
    assert kept.stat().st_size < whole.stat().st_size - 1_900_000
    done = stored_report("open", kept, "--out", tmp_path / "out")
    assert done.stdout == f"{tmp_path}/out/campaign.html\n"
    assert (tmp_path / "out" / "campaign.html").read_bytes() == whole.read_bytes()


@pytest.mark.parametrize("action", [("keep", "x.html", "y.html"), ("open", "x.html", "--out", "out")])
def test_another_page_is_refused(tmp_path, action, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page = b"<html></html>"
    Path("x.html").write_bytes(gzip.compress(page) if action[0] == "open" else page)
    done = stored_report(*action)
    assert done.returncode == 1
    assert done.stderr.startswith("stored_report: x.html: no page ")
    assert not Path("y.html").exists()


@pytest.mark.parametrize("stored", STORED, ids=lambda path: path.parent.name)
def test_stored_pages_are_small_and_run_what_their_policy_allows(tmp_path, stored):
    assert stored.stat().st_size < 1_000_000
    assert stored_report("open", stored, "--out", tmp_path).returncode == 0
    whole = (tmp_path / f"{stored.parent.name}.html").read_text(encoding="utf-8")
    scripts = re.findall(r"<script>(.*?)</script>", whole, re.DOTALL)
    assert len(scripts) == 1
    assert whole.count('data-packed="plotly"') == 1
    policy = unescape(whole.partition("Content-Security-Policy")[2].partition(">")[0])
    for script in scripts:
        held = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
        assert f"'sha256-{held}'" in policy
