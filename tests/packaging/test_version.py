import re
from pathlib import Path

from dds_trace.base.version import __version__

CHANGELOG = Path(__file__).parents[2] / "CHANGELOG.md"


def test_the_changelog_begins_with_this_version_and_has_a_heading_for_each_line():
    text = CHANGELOG.read_text(encoding="utf-8")
    latest = text.split("\n## ")[1]
    assert latest.startswith(f"{__version__} ")
    introduction, *groups = latest.split("\n### ")
    assert "\n- " not in introduction
    assert len(groups) > 5
    for group in groups:
        assert re.search(r"\n- \S", group), group
