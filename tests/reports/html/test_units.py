import html
import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from page_reader import rendered

from dds_trace.base.units import counted
from dds_trace.reports.blocks import WITHIN_QUANTITY

UNITS = Path(__file__).parents[3] / "reports" / "html" / "assets" / "units.js"
COUNTS = (0, 1, 2, 1000)


@pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed")
def test_counts_of_the_page_are_those_of_the_reports():
    words = [["group"], ["reply", "replies"]]
    call = f"{list(COUNTS)}.map((count) => {json.dumps(words)}.map((word) => counted(count, ...word)))"
    script = f"const DATA = {{ units: {{}} }};\n{UNITS.read_text()}\nconsole.log(JSON.stringify({call}));"
    ran = subprocess.run(["node", "-e", script], capture_output=True, text=True, check=True)
    assert json.loads(ran.stdout) == [[counted(count, *word) for word in words] for count in COUNTS]


@pytest.mark.parametrize("name", ["demo", "lossy machine"])
def test_no_line_of_a_page_ends_between_a_number_and_its_unit(name):
    text = re.sub(r"(?s)<(style|script|svg)\b.*?</\1>|<[^>]*>", "", rendered(name, "html"))
    assert "\u00a0ms" in text
    assert [text[at.start() - 20 : at.end() + 5] for at in WITHIN_QUANTITY.finditer(html.unescape(text))] == []


def test_scripts_have_lines_of_at_most_120_characters():
    scripts = sorted((Path(__file__).parents[3] / "reports").rglob("assets/**/*.js"))
    assert len(scripts) > 15
    long = [
        f"{path.name}:{number}"
        for path in scripts
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if len(line) > 120
    ]
    assert long == []
