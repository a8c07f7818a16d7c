"""Every answer that README and the pages quote is what the kept traces give today; `just readme` writes them again."""

import csv
import math
import sys
from importlib import import_module
from pathlib import Path

import pytest
from trace_files import Message, ping_session, relay_session, run, write_pair

ROOT = Path(__file__).parents[2]
MS = 1_000_000


@pytest.fixture
def quoted(monkeypatch):
    monkeypatch.setattr(sys, "path", [str(ROOT / "scripts"), *sys.path])
    monkeypatch.setenv("COLUMNS", "80")
    return import_module("quoted")


def test_pages_quote_what_their_traces_give(quoted):
    pages = [page for page in quoted.PAGES if "<!-- quoted:" in page.read_text(encoding="utf-8")]
    assert {page.name for page in pages} >= {"README.md", "loopback.md", "camera-late.md", "bag.md"}
    for page in pages:
        text = page.read_text(encoding="utf-8")
        assert text.count("<!-- quoted:") == len(quoted.QUOTE.findall(text))
        assert quoted.with_quotes(text) == text, f"{page}: run `just readme`"


def result(setup, size, rate, *medians_ms):
    key = {"setup": setup, "link": "air-30", "device": "none", "data": "binary", "payload_bytes": size, "rate_hz": rate}
    late = dict.fromkeys(("beyond_1_ms", "beyond_10_ms", "beyond_100_ms"), 3)
    return [{**key, "published": 6, "received": 6, "p50_ns": median_ms * MS, **late} for median_ms in medians_ms]


ACROSS, SIZE = "cyclonedds through builtin-zenoh", 502_000
BASE = result(ACROSS, SIZE, 1.0, 10, 10, 10)
ALIKE = result("fastdds", 33_000, 1.0, 10, 10.5)
CROSSING = [
    *result("fastdds through builtin", 33_000, 1.0, 20, 21),
    *result("fastdds through builtin", SIZE, 1.0, 5, 6),
]


@pytest.mark.parametrize(
    ("number", "rows", "measured", "verdict"),
    [
        (1, [], "", "not recorded yet"),
        (9, [], "Connext: refused without RTI's licence", "not possible here"),
        (1, [*BASE, *result(ACROSS, SIZE, 4.0, 30, 31, 32)], "yes in 1 of 1, no in 0; ratios 3.1 to 3.1", "reproduced"),
        (1, [*BASE, *result(ACROSS, SIZE, 4.0, 4, 5, 6)], "yes in 0 of 1, no in 1; ratios 0.5 to 0.5", "contradicted"),
        (1, [*BASE, *result(ACROSS, SIZE, 4.0, 9, 11, 30)], "yes in 0 of 1, no in 0; ratios 1.1 to 1.1", "undecided"),
        (1, [*BASE, *result(ACROSS, SIZE, 4.0, math.inf, math.inf)], "yes in 1 of 1, no in 0", "reproduced"),  # lost
        (
            13,
            [*ALIKE, *result("fastdds", 33_000, 4.0, 10, 11)],
            "yes in 1 of 1, no in 0; ratios 1.02 to 1.02",
            "reproduced",
        ),
        (
            13,
            [*ALIKE, *result("fastdds", 33_000, 4.0, 14, 15)],
            "yes in 0 of 1, no in 1; ratios 1.41 to 1.41",
            "contradicted",
        ),
        (
            16,
            [*ALIKE, *result("fastdds", SIZE, 1.0, 9), *CROSSING],
            "yes in 1 of 2, no in 1; ratios 0.611 to 2",
            "in part",
        ),
        (18, CROSSING, "worst run: 50% beyond 1 ms, 50% beyond 10 ms, 50% beyond 100 ms", "reproduced"),
    ],
)
def test_a_claim_is_decided_by_the_ranges_of_the_runs(quoted, number, rows, measured, verdict):
    lines = quoted.claim_table(rows).splitlines()
    found = [cell.strip() for cell in lines[number + 1].split("|")]
    assert (found[1], found[3], found[4].removesuffix(", emulated")) == (str(number), measured, verdict)


def test_rows_of_a_sweep_have_lost_messages_as_infinitely_late(quoted, tmp_path):
    sent = [Message(s, t0=s * MS, t1=s * MS, t3=s * MS + 5, t4=s * MS + 5, t2=s * MS + 2 * MS) for s in range(2)]
    sent += [Message(s, t0=s * MS, t1=s * MS) for s in (2, 3, 4)]
    sides = {"device": "vm", "connectivity": "emulated-air-30", "vendor": "cyclonedds"}
    described = run(
        planned_messages=5,
        published=5,
        extra={**run().extra, "settings": {"link": "air-30(x)", "load": "emulated-pi3"}},
    )
    write_pair(tmp_path / "in", sent, ping=ping_session(**sides), relay=relay_session(**sides), runs=[described])
    quoted.keep_claims(tmp_path / "in", tmp_path / "claims.csv")
    with (tmp_path / "claims.csv").open() as file:
        (row,) = csv.DictReader(file)
    assert (row["setup"], row["link"], row["device"]) == ("cyclonedds", "air-30", "emulated-pi3")
    assert (row["published"], row["received"], row["p50_ns"], row["beyond_1_ms"]) == ("5", "2", "inf", "3")


def test_a_ratio_above_its_bar_is_bold(quoted):
    row = {"ours": "zenoh", "size_bytes": "64", "rate_hz": "100", "ratio": "1.3", "ratios": "1.4 1.2", "bar": "1.2"}
    text = quoted.ratio_table([{**row, "against": "bare"}, {**row, "against": "C", "bar": ""}])
    above, without = ([cell.strip() for cell in line.split("|")] for line in text.splitlines()[-2:])
    assert above[2:5] == ["bare", "**1.30** (1.20 to 1.40)", "1.2"]
    assert without[2:5] == ["C", "1.30 (1.20 to 1.40)", ""]
