import ast
import re
from pathlib import Path

import pytest

from dds_trace.base.errors import TraceError
from dds_trace.extensions.bags import command as topics
from dds_trace.extensions.campaigns import sweep
from dds_trace.extensions.campaigns.commands import common as sweep_command
from dds_trace.extensions.gates.gate import GateOutcome
from dds_trace.recorder import errors as recorder_errors
from dds_trace.reports.figures.figure import Scope
from dds_trace.reports.figures.table import FIGURES

ROOT = Path(__file__).parents[1]
PAGES = sorted(
    [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("sample_traces/*.md"), *ROOT.glob("benchmarks/*.md")]
)
ROOMS = ("src/dds_trace/base", "tracefile", "recorder", "analyzer", "reports", "cli", "extensions")
READING, GLOSSARY, TROUBLESHOOTING = (
    ROOT / "docs" / name for name in ("reading-the-report.md", "glossary.md", "troubleshooting.md")
)

LINK = re.compile(r"\]\(([^)\s]+)\)")
HEADING = re.compile(r"^#{1,6} (.+)$", re.MULTILINE)
FENCE = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
QUOTED = re.findall(r"^> (.+)$", TROUBLESHOOTING.read_text(encoding="utf-8"), re.MULTILINE)
MEANINGFUL = 12  # characters of the longest fragment of a quoted line: shorter ones are anywhere


def prose_of(page):
    return FENCE.sub("", page.read_text(encoding="utf-8"))


def sources_of_rooms():
    return sorted(path for room in ROOMS for path in (ROOT / room).rglob("*.py"))


def anchors_of(page):
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in HEADING.findall(prose_of(page))}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_within_the_repository_lead_somewhere(page):
    dead = []
    for link in LINK.findall(prose_of(page)):
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        if "://" not in link and (not target.exists() or (anchor and anchor not in anchors_of(target))):
            dead.append(link)
    assert dead == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_sentences_begin_with_capitals_or_names_with_a_mark_in_them(page):
    prose = re.sub(r"^(?: {4}|[#!<|>])[^\n]*$", "", prose_of(page), flags=re.MULTILINE)
    starts = r"(?:\A|\n\n|^\s*(?:-|\d+\.) |[a-z)%`]\. )[*_\[(]*(?!dds-trace )([a-z][a-z'-]*(?:[\s;,]|: ).*)"
    assert re.findall(starts, prose, re.MULTILINE) == []


LITERAL = re.compile(r"(`+).+?\1|\]\([^)\s]*\)")
SENTENCE_END = re.compile(r"[\w`%\])*\"][.!?](?:\*\*|[)\"])? +(?=[*_\[(\"]*[A-Z`…])")
ABBREVIATED = re.compile(r"\b(?:e\.g|i\.e|cf|vs|al|No)\.$")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_prose_has_one_sentence_a_line(page):
    """A change of a sentence is a change of one line. The change log is left out: an entry is a line there."""
    if page.name == "CHANGELOG.md":
        pytest.skip("an entry a line")
    prose = re.sub(r"<!--.*?-->", "", prose_of(page), flags=re.DOTALL)
    wrong = []
    for paragraph in re.split(r"\n(?: *\n| *(?=[-*|#>] |\d+\. ))", prose):
        if paragraph.startswith("    ") or paragraph.lstrip().startswith(("|", "#", ">")):
            continue
        *lines, last = re.sub(r"^ *(?:[-*]|\d+\.) +", "", paragraph.strip("\n")).splitlines() or [""]
        wrong += [
            line for line in lines if not re.search(r"[.!?:](?:\*\*|[)\"])?$", line) and not line.startswith(("#", "["))
        ]
        for line in (*lines, last):
            masked = LITERAL.sub(lambda match: "`" * len(match[0]), line)
            ends = [match.start() + 2 for match in SENTENCE_END.finditer(masked)]
            wrong += [line for end in ends if not ABBREVIATED.search(line[:end])]
    assert wrong == []


def test_every_figure_is_explained_under_its_title_in_the_order_of_the_report():
    shown = [figure for scope in Scope for figure in FIGURES if figure.scope is scope]
    sections = READING.read_text(encoding="utf-8").split("\n### ")[1:]
    assert [section.partition("\n")[0] for section in sections] == [
        f"{figure.title} (`{figure.name}`)" for figure in shown
    ]
    for section in sections:
        told = re.findall(r"^- \*\*(\w+):\*\* ", section, re.MULTILINE)
        assert told == ["Answers", "Misleads", "Next"], section


@pytest.fixture(scope="module")
def said_by_the_code():
    """Every text of the code but docstrings, with … in the place of what an f-string puts in."""
    texts = []
    for path in sources_of_rooms():
        nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
        docstrings = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
        for node in nodes:
            if isinstance(node, ast.JoinedStr):
                texts.append("".join(part.value if isinstance(part, ast.Constant) else "…" for part in node.values))
            elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docstrings:
                texts.append(node.value)
    return texts


@pytest.mark.parametrize("line", QUOTED)
def test_a_quoted_line_is_what_the_code_says(line, said_by_the_code):
    fragments = [fragment.strip() for fragment in line.split("…") if fragment.strip()]
    assert max(map(len, fragments)) >= MEANINGFUL
    assert [part for part in fragments if not any(part in text for text in said_by_the_code)] == []


def test_the_table_of_exit_codes_is_that_of_the_code():
    errors, more = {TraceError}, {TraceError}
    while more:
        more = {below for each in more for below in each.__subclasses__()}
        errors |= more
    known = {
        (each.exit_code, each.__name__)
        for each in errors
        if each.__module__ in (TraceError.__module__, recorder_errors.__name__)
    }
    known |= {(each.exit_code, each.name) for each in GateOutcome if each.exit_code}
    for module in (sweep_command, sweep, topics):
        known |= {(code, name) for name, code in vars(module).items() if name.endswith("_EXIT_CODE")}
    page = (ROOT / "docs/reference/exit-codes.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\d+) \| `(\w+)` \|", page, re.MULTILINE)
    assert len(rows) == len(set(rows))
    assert {(int(code), name) for code, name in rows} == known
    codes = [int(code) for code, _ in rows]
    assert codes == sorted(codes)


@pytest.mark.parametrize("page", [READING, GLOSSARY, TROUBLESHOOTING], ids=lambda page: page.stem)
def test_the_readme_leads_to_a_page_and_its_names_of_findings_and_columns_are_those_of_the_code(page):
    """A name in backticks with an underscore is a finding, a figure, a column or a setting; one that was renamed is none."""
    sources = "\n".join(path.read_text(encoding="utf-8") for path in sources_of_rooms())
    names = set(re.findall(r"`([a-z]+(?:_[a-z0-9]+)+)`", page.read_text(encoding="utf-8")))
    assert names
    assert f"docs/{page.name}" in LINK.findall(prose_of(ROOT / "README.md"))
    assert {name for name in names if not re.search(rf"\b{name}\b", sources)} == set()
