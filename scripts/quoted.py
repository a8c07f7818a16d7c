"""Answers quoted in README and the pages, made from the traces that docs/results/ keeps: `just readme`.

    python scripts/quoted.py            # writes each quote again; names the pages that changed
    python scripts/quoted.py runs/paper-claims   # and keeps the rows of that sweep for docs/results/study.md

A quote follows a comment that says what it is: `<!-- quoted: analyze loopback -->` the terminal's answer, `topics drive` the card of
a bag, `advice lossy-link` what `dds-trace advise` proved, each in a block; `table loopback` the table of sizes, `further bridges` that of the other rates; `columns roundtrips` and `columns summary` those of the code, `security runs` that of its kept runs, `links presets` those of a plan; `ratios
node` and `ratios throughput` those of `bench_node.py` and `bench_throughput.py --csv`, `speed rows` that of `just bench-speed DIR`, `claims study` and `needs study` those of a
sweep of plans/paper-claims.toml; `learned results` that of `bench_learning.py --csv`, `evidence harmless` and `evidence losses` those of `bench_evidence.py --csv`; `explained PLAN` what `dds-trace explain` says of the traces of that plan; `compared FOLDER` what
`dds-trace compare base new --paired` says of two sides, `failed FOLDER` its answer and gates with `--fail-if default`; `costs gates` the runs that gates take.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tarfile
import tempfile
from functools import cache
from pathlib import Path
from unittest.mock import patch

from claims import CHOICES, CLAIMS, claim_table, keep_claims, need_table
from stored_tables import (
    EVIDENCE,
    LEARNING,
    RATIOS,
    SECURITY,
    SPEED,
    column_table,
    cost_table,
    evidence_table,
    learning_table,
    ratio_table,
    read_rows,
    security_table,
    speed_table,
)
from stored_tables import markdown as table_of

from dds_trace.analyzer.model.columns import ROUNDTRIP_COLUMNS, SUMMARY_COLUMNS
from dds_trace.analyzer.pipeline import analyze
from dds_trace.extensions.bags.analyze import analyze_topics
from dds_trace.extensions.bags.report import BagReport
from dds_trace.extensions.campaigns import explain
from dds_trace.extensions.campaigns.commands.advise import shown_proof
from dds_trace.extensions.campaigns.commands.common import plan_of
from dds_trace.extensions.campaigns.commands.explain import answer, answer_lines
from dds_trace.extensions.campaigns.plan.link import PRESETS
from dds_trace.extensions.campaigns.proof import proof_of
from dds_trace.reports import markdown
from dds_trace.reports.book.book import Book
from dds_trace.reports.book.sizes import size_block
from dds_trace.reports.terminal import render

TOP = Path(__file__).parents[1]
PAGES = (TOP / "README.md", TOP / "benchmarks" / "performance.md", *sorted((TOP / "docs").rglob("*.md")))
QUOTE = re.compile(
    r"(?P<head><!-- quoted: (?P<kind>\w+) (?P<campaign>[\w-]+) -->\n)(?P<text>```text\n.*?```\n|(?:\|[^\n]*\n)+)",
    re.DOTALL,
)
FOLDER_OF = {
    "robot-and-laptop": "two-machines",
    "jazzy-kilted": "stacks/jazzy-kilted",
    **{f"paper-explain-{of}": f"study/explain-{of}" for of in ("size", "rates")},
}
"""Folder that a person analyzes, or plan -> folder of docs/results/, where the two differ."""
EXPLAINED_SIZES = {"paper-explain-size": "145KB..1MB"}


def unpack(campaign: str, into: Path) -> Path:
    """Unpack the traces of a campaign; return its folder, which has the campaign's name."""
    folder = into / campaign
    for path in sorted((TOP / "docs" / "results" / FOLDER_OF.get(campaign, campaign)).glob("*.tar.xz")):
        with tarfile.open(path) as archive:
            archive.extractall(
                into if all(name.startswith(campaign) for name in archive.getnames()) else folder, filter="data"
            )
    return folder


def explained(plan_name: str, folder: Path) -> list[str]:
    """Return the answer of `dds-trace explain` to the traces of a plan, whatever can be varied on this machine."""
    plan, sizes = plan_of(TOP / "plans" / f"{plan_name}.toml", folder), EXPLAINED_SIZES.get(plan_name)
    with patch.multiple(explain, read_limits=dict, _refused_conditions=lambda _slow_hz: {}):
        explanation = explain.explain_size(plan, sizes) if sizes else explain.explain_rates(plan)
    answers, _ = answer(explanation, folder)
    return [line for setup in explanation.setups for line in answer_lines(explanation, setup, answers[setup.name])]


@cache
def quote(kind: str, campaign: str) -> str:
    """Return what is quoted: the block or the table, as it is on the page."""
    stored = {
        "ratios": (RATIOS, lambda rows: ratio_table(rows, is_throughput=campaign == "throughput")),
        "claims": (CLAIMS, claim_table),
        "learned": (LEARNING, learning_table),
        "evidence": (EVIDENCE, lambda rows: evidence_table(rows, campaign)),
        "needs": (CHOICES, need_table),
        "security": (SECURITY, security_table),
        "speed": (SPEED, speed_table),
    }
    if kind == "columns":
        return column_table(ROUNDTRIP_COLUMNS if campaign == "roundtrips" else SUMMARY_COLUMNS)
    if kind == "links":
        presets = (str(link).rstrip(")").partition(" (")[::2] for link in PRESETS.values())
        return table_of(("preset", "what it is"), ([f"`{name}`", words] for name, words in presets))
    if kind == "costs":
        return cost_table()
    if kind in stored:
        rows, table = stored[kind]
        return table(read_rows(rows))
    with tempfile.TemporaryDirectory() as scratch:
        folder = unpack(campaign, Path(scratch))
        if kind == "topics":
            here = Path.cwd()
            os.chdir(scratch)  # the card names the path as it is given
            try:
                lines = render(BagReport(analyze_topics([Path(campaign)]))).splitlines()
            finally:
                os.chdir(here)
        elif kind in ("compared", "failed"):
            command = [Path(sys.executable).with_name("dds-trace"), "compare", "base", "new", "--paired"]
            command += ["--fail-if", "default"] if kind == "failed" else []
            said = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=kind == "compared")
            answer, gates, *_ = said.stdout.split("\n\n")
            lines = (f"{answer}\n\n{gates}" if kind == "failed" else said.stdout).splitlines()
        elif kind == "explained":
            lines = explained(campaign, folder)
        elif kind == "advice":
            (path,) = folder.glob("*.xml")
            proof = proof_of(path.stem, folder / "base", folder / "new")
            lines = shown_proof({"of": f"Fast DDS {path.stem}", "against": "its default", **proof})
        else:
            book = Book(analyze(folder))
            if kind in ("table", "further"):
                sizes = markdown._table(size_block(book.sizes, is_further=kind == "further"))  # noqa: SLF001
                return re.findall(r"(?:^\|.*\n)+", f"{sizes}\n", re.MULTILINE)[0]
            lines = render(book).splitlines()
    return "".join(f"{line.rstrip()}\n" for line in ["```text", *lines, "```"])


def with_quotes(text: str) -> str:
    """Return a page with each quote as its source gives it today."""
    return QUOTE.sub(lambda found: found["head"] + quote(found["kind"], found["campaign"]), text)


def main() -> int:
    """Write the quotes again, after the rows of a sweep of the claims, if its folder is given."""
    if len(sys.argv) > 1:
        keep_claims(Path(sys.argv[1]))
    os.environ["COLUMNS"] = "80"
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        if (quoted := with_quotes(text)) != text:
            page.write_text(quoted, encoding="utf-8")
            print(f"Wrote {page.relative_to(TOP)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
