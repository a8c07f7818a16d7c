import base64
import hashlib
import html
import io
import json
import math
import re
import unicodedata
from dataclasses import fields, replace
from itertools import pairwise

import numpy as np
import polars as pl
import pytest
from analyses import EVERY_ANALYSIS, HOSTILE, MS, Measured, make_analysis
from jsonschema import Draft202012Validator
from page_reader import rendered, unpacked
from report_schemas import REPORT, closed
from wording import numbers, report_as

from dds_trace import Details, make_job
from dds_trace.analyzer.analysis import DETAIL_FRAMES
from dds_trace.analyzer.details import details_not_requested
from dds_trace.base.errors import OptionError, OutputError
from dds_trace.base.streams import plain_console
from dds_trace.base.units import format_ratio
from dds_trace.extensions.campaigns.recommend import recommend_settings
from dds_trace.reports import document, terminal
from dds_trace.reports.blocks import PAGE, Column, Fold, Row, Section, Sentence, Span, Table
from dds_trace.reports.book.book import Book
from dds_trace.reports.book.groups import LATENCY_MEANING, format_count, markdown
from dds_trace.reports.book.numbers import intervals_info
from dds_trace.reports.book.screen import MOST_LINES
from dds_trace.reports.book.sizes import Threshold
from dds_trace.reports.document import _lines
from dds_trace.reports.figures.table import FIGURES
from dds_trace.reports.html.page import json_island
from dds_trace.reports.markdown import _fold
from dds_trace.reports.reporters import REPORT_MODULES, load_reporter, write_reports
from dds_trace.reports.terminal import INLINE_BAR


@pytest.fixture(scope="module", params=EVERY_ANALYSIS)
def name(request):
    return request.param


@pytest.mark.parametrize("kind", REPORT_MODULES)
def test_every_reporter_accepts_every_analysis_and_repeats_itself(name, kind):
    assert report_as(kind, EVERY_ANALYSIS[name]()) == rendered(name, kind)


@pytest.mark.parametrize(("kind", "file_name"), [("html", "report.html"), ("md", "report.md"), ("json", "report.json")])
def test_files_are_written_where_asked(tmp_path, kind, file_name):
    (path,) = write_reports(EVERY_ANALYSIS["ping without relay"](), [kind], tmp_path)
    assert path == tmp_path / file_name
    assert path.read_bytes().decode("utf-8") == rendered("ping without relay", kind)


def test_the_terminal_prints_the_answer_or_all_of_it_with_the_answer_last(tmp_path, capsys):
    analysis = EVERY_ANALYSIS["ping without relay"]()
    printed = []
    for shows_all in (False, True):
        assert write_reports(analysis, ["terminal"], tmp_path, shows_all=shows_all) == [None]
        printed.append("\n".join(line.rstrip() for line in capsys.readouterr().out.splitlines()))
    brief, whole = printed
    assert brief == terminal.render(Book(analysis)).rstrip("\n")
    assert whole == terminal.render(Book(analysis, shows_all=True)).rstrip("\n")
    *answer, hint = brief.splitlines()
    assert whole.splitlines()[-len(answer) :] == answer
    assert "--all" in hint
    assert list(tmp_path.iterdir()) == []


def test_the_answer_is_at_most_20_lines_of_80_columns(name):
    lines = terminal.render(Book(EVERY_ANALYSIS[name]())).splitlines()
    assert len(lines) <= MOST_LINES
    assert max(map(len, lines)) <= 80


def test_no_line_of_a_terminal_ends_between_a_number_and_its_unit_and_facts_are_a_column(name):
    lines = rendered(name, "terminal").splitlines()
    broken = [
        pair for pair in pairwise(lines) if re.search(r"\d$", pair[0]) and re.match(r" *([KM]?B|[µm]s|%|Hz)\b", pair[1])
    ]
    assert broken == []
    start = next(number for number, line in enumerate(lines) if re.match("(Devices|Traces) ", line))
    assert all(line[:20].strip() in FACTS for line in lines[start : lines.index("", start)])


FACTS = ("", "Devices", "Link", "Middleware", "Domains", "Messages", "Sent", "Rates", "When", "Traces", "Quality of service",
         "Settings", "Versions", "Cost of measuring", "Conditions")  # fmt: skip


@pytest.mark.parametrize("cells", [INLINE_BAR, 30])
def test_lengths_of_bars_have_the_ratio_of_their_numbers_to_an_eighth_of_a_column(cells):
    for value in (0.4, 3.42, 37.6, 120.0, 371.0, 448.0):
        bar = terminal._bar(value, 448.0, cells)
        eighths = sum(8 if column == "█" else " ▏▎▍▌▋▊▉".index(column) for column in bar)
        assert eighths == pytest.approx(max(8 * cells * value / 448.0, 1), abs=0.51)
    assert terminal._bar(3.42, 500.0, cells) != terminal._bar(37.6, 500.0, cells)


def test_the_answer_has_a_line_for_each_proven_fact_and_bars_of_the_medians():
    lines = terminal.render(Book(EVERY_ANALYSIS["small campaign"]())).splitlines()
    binary = lines.index("Fastest in the same domain (Binary)")
    fact, bars = lines[binary + 1], next(line for line in lines[binary:] if "█" in line)
    assert fact.startswith("✓ at every size: Zenoh (")
    short, long = (part.count("█") for part in bars.split("   ")[:2])
    assert short < long == INLINE_BAR
    assert bars.endswith("p99 15.1 ms   1 MB")
    assert next(line for line in lines if "were lost" in line).startswith("·")


def test_a_deadline_has_a_mark_for_each_setup():
    analysis = EVERY_ANALYSIS["small campaign"]()
    book = Book(analysis)
    rows = tuple(
        replace(place, thresholds=(*OUTCOMES, *[None] * (len(book.sizes.choices) - 2))) for place in book.sizes.places
    )
    book.sizes = replace(book.sizes, deadline="latency within 20 ms", places=rows)
    text = terminal.render(book)
    passed, failed = book.sizes.choices[:2]
    assert f"✓ {passed}" in text
    assert f"✗ {failed}: 1 of 3 results" in text


OUTCOMES = (Threshold("pass", ""), Threshold("fail", "1 of 3 results"))


def test_an_unknown_kind_and_a_missing_folder_are_errors(tmp_path):
    with pytest.raises(OptionError, match="'pdf'; choose from html, md, json, terminal"):
        write_reports(EVERY_ANALYSIS["empty folder"](), ["pdf"], tmp_path)
    with pytest.raises(OutputError, match="cannot write the md report"):
        write_reports(EVERY_ANALYSIS["empty folder"](), ["md"], tmp_path / "gone")


@pytest.mark.parametrize("kind", ["html", "md"])
def test_the_page_and_markdown_say_what_the_tail_of_the_latency_is_not(kind):
    text = html.unescape(rendered("small campaign", kind))
    assert LATENCY_MEANING in text.replace("\\", "").replace("\u00a0", " ")


# JSON


def test_the_json_report_follows_its_schema_which_describes_every_field(name):
    Draft202012Validator.check_schema(REPORT)
    schema = closed(REPORT)
    for field in ("sessions", "runs"):
        schema["properties"][field] = REPORT["properties"][field]
    Draft202012Validator(schema).validate(json.loads(rendered(name, "json")))


def test_the_json_report_has_every_frame_of_the_details():
    analysis = EVERY_ANALYSIS["small campaign"]()
    report = json.loads(document.render(Book(analysis)))
    for field in fields(Details):
        held = getattr(analysis.details, field.name)
        if isinstance(held, pl.DataFrame):
            assert len(report[field.name]) == held.height
            described = REPORT["properties"][field.name]["items"]["required"]
            assert described == held.columns, field.name
            assert all(list(row) == held.columns for row in report[field.name])
    assert [answer["clarity"] for answer in report["answers"]] == [
        answer.clarity.value for answer in analysis.details.answers
    ]
    first = report["intervals"][0]
    assert (first["group"], first["metric"], first["percentile"]) == (0, "rtt", "p50")
    assert first["low_ns"] < first["estimate_ns"] < first["high_ns"]
    assert report["clock_knots"][0]["run_id"] == "000000000000a000"


def test_the_json_report_of_an_analysis_without_details_has_null_for_them():
    report = json.loads(
        document.render(Book(replace(EVERY_ANALYSIS["one message"](), details=details_not_requested())))
    )
    assert all(report[name] is None for name in (*DETAIL_FRAMES, "answers", "recommendation"))
    Draft202012Validator(REPORT).validate(report)


def test_a_recommendation_is_in_the_json_report():
    analysis = EVERY_ANALYSIS["small campaign"]()
    job = make_job(data="binary", size="33KB", rate="10", deadline="50ms", reliability="0.9")
    recommended = replace(analysis.details, recommendation=recommend_settings(analysis.load_roundtrips(), job))
    report = json.loads(document.render(Book(replace(analysis, details=recommended))))
    Draft202012Validator(closed(REPORT)["properties"]["recommendation"]).validate(report["recommendation"])
    assert report["recommendation"]["job"]["deadline_ns"] == 50 * MS
    assert {candidate["fit"] for candidate in report["recommendation"]["candidates"]} <= {
        "meets",
        "likely",
        "inconclusive",
        "misses",
    }


def test_the_schema_is_strict_enough_to_miss_a_column():
    report = json.loads(rendered("one message", "json"))
    del report["groups"][0]["latency_p50_ns"]
    assert not Draft202012Validator(REPORT).is_valid(report)


def test_the_json_report_keeps_strings_whole_and_numbers_exact():
    long = "x" * 1000 + "\x1b</script>"
    report = json.loads(document.render(Book(make_analysis(Measured([MS, 2 * MS], ping_device=long)))))
    assert report["groups"][0]["ping_device"] == long
    assert report["groups"][0]["latency_p50_ns"] == 1_500_000.0
    assert report["groups"][0]["latency_p90_ns"] is None
    assert report["runs"][0]["run_id"] == "000000000000a000"


# Terminal


def test_the_terminal_report_fits_80_columns_and_has_no_control_character(name):
    text = rendered(name, "terminal")
    assert max(len(line) for line in text.splitlines()) <= 80
    assert {c for c in text if unicodedata.category(c) in {"Cc", "Cf", "Zl", "Zp"}} <= {"\n"}


def test_rows_of_one_line_are_drawn_as_a_grid_draws_them(monkeypatch):
    columns = [
        Column("Name"),
        Column("Value", right=True),
        Column("", is_cut=True, width=5),
        Column("Unit", right=True),
    ]
    texts = ["", "a", "b ", " c", "1.2 ms", "日本", "words that wrap " * 3, "d\ne", "\x1b[3m", [Span("f", "strong")]]
    for seed in range(40):
        cells = np.random.default_rng(seed).integers(0, len(texts), (6, 4)).tolist()
        table = Table(columns, [Row([texts[at] for at in row], part="p" * (row[0] % 2)) for row in cells])
        drawn = {}
        for is_short in (terminal._is_short, lambda *_: False):
            for width in (20, 80):
                monkeypatch.setattr(terminal, "_is_short", is_short)
                stream = io.StringIO()
                plain_console(file=stream, force_terminal=True, width=width).print(terminal._drawn([Section([table])]))
                drawn.setdefault(width, set()).add(stream.getvalue())
        assert [*map(len, drawn.values())] == [1, 1]


def test_a_sparkline_shows_where_the_messages_lie():
    fast, slow = [MS] * 10, [100 * MS] * 10
    text = terminal.render(Book(make_analysis(Measured(fast), Measured(slow, rate_hz=20.0)), shows_all=True))
    (fast_line,) = (line for line in text.splitlines() if "10 Hz" in line and "Binary  " in line)
    (slow_line,) = (line for line in text.splitlines() if "20 Hz" in line and "Binary  " in line)
    assert fast_line.endswith("1 ms █")
    assert slow_line.endswith("100 ms            █")


HALF_SENT = [Measured([MS + 1000 * (n * 7 % 60) for n in range(300)], unsent=300)]


def test_the_terminal_says_what_its_numbers_rest_on():
    text = terminal.render(Book(make_analysis(*HALF_SENT), shows_all=True))
    (heading,) = (line.split() for line in text.splitlines() if line.startswith("Data"))
    (row,) = (line.split() for line in text.splitlines() if line.startswith("Binary  "))
    cells = dict(zip(["Data", "Size", "", "Rate", "", "Runs"], row, strict=False))
    assert heading == ["Data", "Size", "Rate", "Runs", "Received", "p50", "p99", "Bur.", "max", "Distribution"]
    assert cells["Runs"] == "1*"
    episodes = intervals_info(make_analysis(*HALF_SENT)).tail_episodes("latency", "p99", 0)
    assert row[row.index("ms", row.index("ms") + 1) + 1] == str(episodes)
    assert "*, numbers hold within one run" in text.replace("\n", " ")


@pytest.mark.parametrize("kind", ["terminal", "md", "html"])
def test_messages_that_were_never_sent_are_mentioned(kind):
    text = " ".join(load_reporter(kind).render(Book(make_analysis(*HALF_SENT), shows_all=True)).split())
    assert "300 of them never sent" in text
    assert "300 received, 300 never sent" in text


@pytest.mark.parametrize("kind", ["terminal", "md", "html"])
def test_times_of_a_result_with_losses_are_named_those_of_the_received_messages(kind):
    analysis = make_analysis(*HALF_SENT)
    untyped = replace(analysis, details=details_not_requested())  # without intervals no run is typical
    for one, said in ((analysis, "a typical run"), (untyped, "all received messages")):
        text = " ".join(load_reporter(kind).render(Book(one, shows_all=True)).split())
        assert f"median latency of {said} 1." in text
        assert "of all messages that were received" in text


def test_markdown_counts_unsent_messages_next_to_the_received_ones_and_runs_even_without_intervals():
    analysis = make_analysis(*HALF_SENT)
    for one in (analysis, replace(analysis, details=details_not_requested())):
        assert "1&#42; | 50 % | 300" in load_reporter("md").render(Book(one))


def test_rich_markup_in_a_trace_stays_text():
    device = "[bold]pi[/bold]"
    assert device in terminal.render(Book(make_analysis(Measured([MS], ping_device=device)), shows_all=True))


# Markdown


def test_markdown_keeps_its_tables_whole():
    text = rendered("hostile strings", "md")
    tables = [block.splitlines() for block in text.split("\n\n") if block.startswith("| ")]
    assert tables
    for table in tables:
        assert len({len(re.findall(r"\|", line)) for line in table}) == 1


def test_markdown_has_no_block_of_the_page_within_a_fold():
    assert "of page" not in _fold(Fold("first", [Sentence("second"), Sentence("of page", media=PAGE)]))


def test_markdown_makes_hostile_strings_inert():
    text = rendered("hostile strings", "md")
    for syntax in ("<script", "<img", "](", "**d**", "`c`", "http://", "\x1b", "\u2028"):
        assert syntax not in text
    assert "@everyone" not in text


def test_markdown_has_the_cost_on_the_wire(sentences):
    text = rendered("over a lossy wire", "md")
    rows = [line.split(" | ")[4:] for line in text.partition("costs on the wire")[2].splitlines()[4:6]]
    assert rows[0] == ["1.1", "25 %", "not seen", "", "40 ms", " |"]
    assert [numbers(cell) for cell in rows[1]] == [[1.5], [25], [], [0, 0.25], [0.25], [3]]
    sentences(*rows[1])
    assert "on the wire" not in rendered("one message", "md")


def test_markdown_has_intervals_costs_of_bridges_and_clocks(sentences):
    text = load_reporter("md").render(
        Book(
            make_analysis(
                Measured([MS + 1000 * n for n in range(100)]),
                Measured([2 * MS + 1000 * n for n in range(100)], bridge="builtin", domain_mode="different"),
            )
        )
    )
    (row,) = (line for line in text.splitlines() if line.startswith("| Binary | 33 KB") and "same domain" in line)
    # A series that only rises is one burst, whose rarest messages have no upper end.
    assert numbers(html.unescape(row))[-10:] == [1.05, 1, 1.1, 1.09, 1.06, 1.1, 1.1, 1.09, 1, 1.1]
    costs = text.split("## What a bridge costs")[1]
    (cost,) = (line for line in costs.splitlines() if line.startswith("| Binary | 33 KB"))
    assert numbers(html.unescape(cost)) == [33, 10, 3, 3, 100, 1, 0.889, 1.11, 1, 0.886, 1.12, 1, 0.886, 1.12, 30]
    (clocks,) = (line for line in text.splitlines() if line.startswith("| pi-one"))
    assert numbers(html.unescape(clocks)) == [500, 50, 20, 1]
    sentences(row, cost, clocks)


# HTML, as bytes. What a browser makes of it: test_browser.py.


def scripts_of(page):
    (unpacking,) = re.findall(r"<script>(.*?)</script>", page, re.DOTALL)
    return [unpacking, *(unpacked(text) for text in re.findall(r'data-packed="(?:plotly|page)">(.*?)<', page))]


def test_the_policy_admits_the_scripts_of_the_page_and_nothing_else(name):
    page = rendered(name, "html")
    (policy,) = re.findall(r'Content-Security-Policy" content="([^"]*)"', page)
    policy = policy.replace("&#39;", "'")
    hashes = [
        f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'" for text in scripts_of(page)
    ]
    assert len(hashes) == 3
    assert policy.split("; ")[:2] == ["default-src 'none'", f"script-src {' '.join(hashes)}"]
    assert "unsafe-eval" not in policy


def test_the_page_refers_to_nothing_outside(name):
    page = rendered(name, "html")
    outside = page
    for script in scripts_of(page):
        outside = outside.replace(script, "")
    assert not re.search(r"""(?:src|href)\s*=\s*["']?(?:https?:)?//""", outside)
    assert "@import" not in outside
    assert "url(" not in outside


def test_hostile_strings_are_text_in_html():
    page = rendered("hostile strings", "html")
    for script in scripts_of(page):
        page = page.replace(script, "")
    assert "window.pwned" in page, "the text itself is shown"
    assert "<script>window.pwned" not in page
    assert "<img" not in page
    assert "\u2028" not in page
    assert "\x1b" not in page
    assert page.count("</script>") == 4


def test_hostile_strings_do_not_change_the_island():
    page = rendered("hostile strings", "html")
    island = unpacked(*re.findall(r'data-packed="data">(.*?)</script>', page))
    labels = [
        option["label"] for one in json.loads(island)["filters"] if one["key"] == "device" for option in one["options"]
    ]
    assert HOSTILE[0] in labels
    assert r"\x1b[31mred\x1b]0;title\x07" in labels


def test_plotly_is_in_the_page_once():
    _, *scripts = scripts_of(rendered("one message", "html"))
    assert [script.count("plotly.js v") for script in scripts] == [1, 0]


def test_a_campaign_of_the_paper_stays_below_three_and_a_half_mb():
    analysis = EVERY_ANALYSIS["500 groups"]()
    plans = {figure.name: plan for figure in FIGURES if (plan := figure.plan(Book(analysis))) is not None}
    for name in ("timeline", "host_load", "clock"):
        assert plans[name]["decimated"], f"the page is as large as it gets only with all of {name} in it"
    assert len(rendered("500 groups", "html").encode()) <= 3_500_000


TABLE = pl.DataFrame(
    {
        "run_id": pl.Series([2**64 - 1, 7], dtype=pl.UInt64),
        "count": pl.Series([None, -3], dtype=pl.Int64),
        "mean_ns": [0.1, 1e300],
        "worst_ns": [math.inf, math.nan],
        "device": ['a "b", ü', None],
        "same": [True, None],
        "nothing": [None, None],
        "parts": [[1, 2], []],
    }
)


def test_a_table_is_its_rows_as_json():
    rows = [
        ("ffffffffffffffff", None, 0.1, None, 'a "b", ü', True, None, [1, 2]),
        ("0000000000000007", -3, 1e300, None, None, None, None, []),
    ]
    expected = [dict(zip(TABLE.columns, row, strict=True)) for row in rows]
    assert _lines(TABLE) == "[\n" + ",\n".join(json.dumps(row) for row in expected) + "\n]"
    assert _lines(TABLE.head(0)) == "[]"


@pytest.mark.parametrize(
    ("ratio", "shown"),
    [
        (1.0, "100 %"),
        (0.999_99, "> 99.99 %"),
        (0.9967, "99.67 %"),
        (0.5, "50 %"),
        (0.153_846, "15.4 %"),
        (0.001_234, "0.123 %"),
        (0.000_04, "< 0.01 %"),
        (0.0, "0 %"),
        (None, "-"),
    ],
)
def test_percent_is_whole_only_where_it_is_exact(ratio, shown):
    assert format_ratio(ratio) == shown


def test_counts_have_groups_of_three_digits():
    assert format_count(12_000) == "12,000"
    assert format_count(None) == "-"


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("plain words, 33 KB (median)", "plain words, 33 KB (median)"),
        ("a|b`c`", "a&#124;b&#96;c&#96;"),
        ("**d**", "&#42;&#42;d&#42;&#42;"),
        ("<script>", "&#60;script&#62;"),
        ("@team #1", "@<!-- -->team #<!-- -->1"),
        ("[x](http://a.invalid)", "&#91;x&#93;(http&#58;//a.invalid)"),
        ("www.a.invalid", "www&#46;a.invalid"),
        ("keep_last 10", "keep&#95;last 10"),
        ("two\nlines", "two&#92;x0alines"),
    ],
)
def test_markdown_reads_no_syntax(text, shown):
    assert markdown(text) == shown


def test_an_island_cannot_end_its_element_and_holds_no_nan():
    value = {"a": "</script><!--\u2028&", "b": [None, 1.5, "\ud800"]}
    text = json_island(value)
    assert not set("<>&\u2028\u2029") & set(text)
    assert json.loads(text) == value
    with pytest.raises(ValueError, match="Out of range"):
        json_island(math.nan)
