"""Every answer that README and the pages quote is what the kept traces give today; `just readme` writes them again."""

import csv
import math
import re
import sys
from importlib import import_module
from pathlib import Path

import pytest
from commands import run_trace
from trace_files import Message, ping_session, relay_session, run, write_pair

from dds_trace.recorder.option_table import OPTIONS

ROOT = Path(__file__).parents[2]
MS = 1_000_000


@pytest.fixture
def quoted(monkeypatch):
    monkeypatch.setattr(sys, "path", [str(ROOT / "scripts"), *sys.path])
    monkeypatch.setenv("COLUMNS", "80")
    return import_module("quoted")


@pytest.mark.thorough
def test_pages_quote_what_their_traces_give(quoted):
    pages = [page for page in quoted.PAGES if "<!-- quoted:" in page.read_text(encoding="utf-8")]
    assert {page.name for page in pages} >= {"README.md", "loopback.md", "camera-late.md", "bag.md"}
    for page in pages:
        text = page.read_text(encoding="utf-8")
        assert text.count("<!-- quoted:") == len(quoted.QUOTE.findall(text))
        assert quoted.with_quotes(text) == text, f"{page}: run `just readme`"


@pytest.mark.parametrize("page", ["reference/columns", "results/security", "how-to/choose", "how-to/ci"])
def test_a_table_of_the_code_or_of_kept_rows_is_up_to_date(quoted, page):
    text = (ROOT / f"docs/{page}.md").read_text(encoding="utf-8")
    assert quoted.with_quotes(text) == text, "run `just readme`"


def result(setup, size, rate, *medians_ms):
    key = {"setup": setup, "link": "air-30", "device": "none", "data": "binary", "payload_bytes": size, "rate_hz": rate}
    late = dict.fromkeys(("beyond_1_ms", "beyond_10_ms", "beyond_100_ms"), 3)
    late |= dict.fromkeys(("upper_1_ms", "upper_10_ms", "upper_100_ms"), 0.75)
    return [{**key, "published": 6, "received": 6, "p50_ns": median_ms * MS, **late} for median_ms in medians_ms]


ACROSS, SIZE = "cyclonedds through builtin-zenoh", 502_000
SLOW = result(ACROSS, SIZE, 1.0, 10, 10, 10)
BASE = [*SLOW, *result(ACROSS, 1_000_000, 1.0, 10, 10, 10)]
ALIKE = [*result("fastdds", 33_000, 1.0, 10, 10.5, 11), *result("fastdds", 145_000, 1.0, 10, 10.5, 11)]


def both(rate, *medians_ms, setup=ACROSS, sizes=(SIZE, 1_000_000)):
    return [row for size in sizes for row in result(setup, size, rate, *medians_ms)]


def small(*medians_ms):
    return [*ALIKE, *both(4.0, *medians_ms, setup="fastdds", sizes=(33_000, 145_000))]


def wired(*medians_ms):
    """At both rates 10 ms of 33 KB, and of larger ones what their bytes take of it, or other medians at 4 Hz."""
    rows = []
    for size in (33_000, 145_000, SIZE, 1_000_000):
        times = [ms * size / 33_000 for ms in (10, 10.5, 11)]
        others = [ms * size / 33_000 for ms in medians_ms]
        rows += [*result(ACROSS, size, 1.0, *times), *result(ACROSS, size, 4.0, *others)]
    return [{**row, "link": "ethernet-100m", "device": "emulated-pi3"} for row in rows]


def rivals(size, fast_ms, cyclone_ms):
    setups = (("fastdds through builtin", fast_ms), (ACROSS, cyclone_ms))
    return [row for rate in (1.0, 4.0) for setup, ms in setups for row in result(setup, size, rate, ms, ms, ms)]


ACROSS_FASTER, ACROSS_SLOWER = rivals(33_000, 5, 9), rivals(SIZE, 9, 5)


def fits(cyclone, fast):
    need = {"need": "large files across, air", "link": "air-30", "device": "none", "response_ns": 5 * MS}
    setups = ((ACROSS, cyclone), ("fastdds through builtin", fast))
    return [{**need, "setup": setup, "fit": fit, "is_best": str(fit == "meets")} for setup, fit in setups]


@pytest.mark.parametrize(
    ("table", "number", "rows", "words", "verdict"),
    [
        ("claim", 1, [], "", "not recorded yet"),
        ("claim", 9, [], "RTI's licence", "not possible here"),
        ("claim", 1, [*BASE, *both(4.0, 30, 31, 32)], "2 of 2 (", "reproduced"),
        ("claim", 1, [*BASE, *both(4.0, 4, 5, 6)], "0 of 2 (", "contradicted"),
        ("claim", 1, [*BASE, *both(4.0, 9, 11, 30)], "0 of 2", "undecided"),
        ("claim", 1, [*SLOW, *result(ACROSS, SIZE, 4.0, 30, 31, 32)], "1 of 1 (", "undecided"),  # 1 in 20 by chance
        ("claim", 1, [*BASE, *both(4.0, *[math.inf] * 3)], "4 Hz lost, 1 Hz 10 ms", "reproduced"),
        ("claim", 13, small(10, 11, 11), "2 of 2", "reproduced"),
        ("claim", 13, small(14, 15, 16), "4 Hz 15 ms (14..16), 1 Hz 10.5 ms (10..11)", "contradicted"),
        ("claim", 18, BASE, "50, 50, 50 % (further runs: up to 75, 75, 75 %)", "reproduced at 1, 10, 100 ms"),
        (
            "claim",
            4,
            wired(10, 10.5, 11),
            "frequency: 4 of 4; no more than the wire's rate demands: 3 of 3",
            "reproduced",
        ),
        ("claim", 4, wired(40, 41, 42), "frequency: 0 of 4 (", "contradicted; no more"),
        ("claim", 16, [*ACROSS_FASTER, *ACROSS_SLOWER], "Fast DDS faster: 2 of 4 (", "reproduced"),
        ("claim", 16, ACROSS_SLOWER, "Fast DDS faster: 0 of 2", "Fast DDS faster: contradicted"),
        ("claim", 19, [], "DDSI-RTPS 120", "as calculated"),
        ("claim", 20, [], "`explain size", "not done: a GUI that learns"),
        ("need", 1, fits("meets", "misses"), "air: Cyclone DDS across", "same"),
        ("need", 1, fits("misses", "meets"), "air: Fast DDS across", "other"),
        ("need", 1, fits("misses", "misses"), "air: nothing", "other"),
        ("need", 1, fits("inconclusive", "misses"), "air: undecided", "not decidable"),
        ("need", 1, fits("meets", "meets"), "Cyclone DDS across or Fast DDS across", "not decidable"),
    ],
)
def test_a_claim_is_decided_by_the_ranges_of_the_runs(quoted, table, number, rows, words, verdict):
    line = getattr(quoted, f"{table}_table")(rows).splitlines()[number + 1]
    *_, shown, outcome, _ = (cell.strip() for cell in line.split("|"))
    assert outcome == verdict or (number in (4, 16, 20) and verdict in outcome)
    assert words in shown


def test_rows_of_a_sweep_have_lost_messages_as_infinitely_late(quoted, tmp_path):
    sent = [Message(s, t0=s * MS, t1=s * MS, t3=s * MS + 5, t4=s * MS + 5, t2=s * MS + 2 * MS) for s in range(2)]
    sent += [Message(s, t0=s * MS, t1=s * MS) for s in (2, 3, 4)]
    sides = {"device": "vm", "connectivity": "emulated-air-30", "vendor": "cyclonedds"}
    settings = {"link": "air-30(x,y)", "load": "emulated-pi3"}
    described = run(planned_messages=5, published=5, extra={**run().extra, "settings": settings})
    write_pair(tmp_path / "in", sent, ping=ping_session(**sides), relay=relay_session(**sides), runs=[described])
    quoted.keep_claims(tmp_path / "in", tmp_path)
    with (tmp_path / "claims.csv").open() as file:
        (row,) = csv.DictReader(file)
    assert (row["setup"], row["link"], row["device"]) == ("cyclonedds", "air-30", "emulated-pi3")
    assert (row["published"], row["received"], row["p50_ns"], row["beyond_1_ms"]) == ("5", "2", "inf", "3")
    assert not row["upper_1_ms"]  # one run


@pytest.mark.slow
def test_rows_of_the_claims_are_those_of_the_kept_traces(quoted, tmp_path):
    quoted.keep_claims(quoted.unpack("study/claims", tmp_path), tmp_path)
    for kept in (quoted.CLAIMS, quoted.CHOICES):
        assert (tmp_path / kept.name).read_text() == kept.read_text(), "run `just kept-claims`"


def test_a_ratio_above_its_bar_is_bold_and_a_throughput_has_its_finding(quoted):
    row = {"ours": "zenoh", "size_bytes": "64", "rate_hz": "100", "ratio": "1.3", "ratios": "1.4 1.2", "bar": "1.2"}
    most = {**row, "against": "max", "rate_hz": "0", "bar": "", "client_bound": "2"}
    rows = [{**row, "against": "bare"}, {**row, "against": "C", "bar": ""}, most]
    table = [line.split(" | ")[1:] for line in quoted.ratio_table(rows).splitlines()[2:]]
    assert table == [["bare", "**1.30**<br>1.20-1.40", "1.2 |"], ["C", "1.30<br>1.20-1.40", " |"]]
    assert quoted.ratio_table(rows, is_throughput=True).count("max | 1.30<br>1.20-1.40<br>`client_bound` in 2 |") == 1


def test_each_future_work_has_the_state_of_its_command_or_of_the_answers_to_it(quoted, tmp_path, monkeypatch):
    claims = sys.modules[quoted.claim_table.__module__]
    commands = [command for _, how, _ in claims.FUTURE for command in re.findall("`([^`]+)`", how)]
    for command in (command for command in commands if not command.startswith("-")):
        words = command.replace("{}", "").split()
        assert run_trace(*words[:1], "--help") == 0
        if plans := [word for word in words if word.endswith(".toml")]:
            monkeypatch.chdir(ROOT)
            assert run_trace(*words, "--dry-run", "--out", tmp_path) in (0, 10), plans
    options = [word for command in commands for word in re.findall(r"-o (\w+)", command)]
    assert {*options} <= OPTIONS.keys()
    monkeypatch.setattr(claims, "PAGE", page := tmp_path / "study.md")
    states = []
    for causes in (("buffer", "queue"), ("buffer", "not known"), ("not known",), ()):
        page.write_text("".join(f"  what moves it: {cause}\n" for cause in causes))
        states.append(claims.state_of("`explain size`", ()))
    assert states == ["done", "in part", "not done", "not done"]
    assert [claims.state_of(*work) for work in (("`sweep`", ("5g",)), ("`sweep`", ("load",)), ("", ()))] == [
        "emulated",
        "done",
        "not done",
    ]
