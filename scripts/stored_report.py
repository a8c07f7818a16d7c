"""HTML reports as `docs/results/` keeps them: compressed and without plotly.js, most of a page, which is installed anyway.

    python scripts/stored_report.py keep out/loopback/report.html docs/results/loopback/report.html.gz
    python scripts/stored_report.py open docs/results/*/report.html.gz --out out/results

`open` puts the installed plotly.js back, so that each page is one file again that works offline.
"""

from __future__ import annotations

import argparse
import gzip
import re
import sys
from pathlib import Path

from plotly.offline import get_plotlyjs, get_plotlyjs_version

from dds_trace.reports.html.page import packed_script, policy_hash

STAND_IN = '<p class="note" data-policy="{hash}">Kept without plotly.js {version}: just results draws the figures.</p>'
STAND_IN_PATTERN = re.compile(r'<p class="note" data-policy="(?P<hash>sha256-[^"]+)">Kept without plotly\.js .*?</p>')


def script() -> str:
    """Return the element that holds plotly.js in a page."""
    return f'<script type="text/plain" data-packed="plotly">{packed_script(get_plotlyjs())}</script>'


def keep(page: str) -> str:
    """Return the page with a sentence in the place of plotly.js.

    Raises:
        ValueError: the page does not hold the installed plotly.js once.
    """
    if page.count(script()) != 1:
        raise ValueError(f"no page of `dds-trace analyze --report html` with plotly.js {get_plotlyjs_version()}")
    stand_in = STAND_IN.format(hash=policy_hash(get_plotlyjs()), version=get_plotlyjs_version())
    return page.replace(script(), stand_in)


def put_back(stored: str) -> str:
    """Return the page with the installed plotly.js in its place and in its security policy.

    Raises:
        ValueError: no stored page.
    """
    found = STAND_IN_PATTERN.search(stored)
    if found is None:
        raise ValueError("no page that `keep` has written")
    before, after = stored[: found.start()], stored[found.end() :]
    return before.replace(found["hash"], policy_hash(get_plotlyjs())) + script() + after


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    actions = parser.add_subparsers(dest="action", required=True)
    keeping = actions.add_parser("keep", help="a report without plotly.js")
    keeping.add_argument("page", type=Path)
    keeping.add_argument("stored", type=Path)
    opening = actions.add_parser("open", help="stored reports with plotly.js again, each under its folder's name")
    opening.add_argument("stored", type=Path, nargs="+")
    opening.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    try:
        if given.action == "keep":
            kept = keep(given.page.read_text(encoding="utf-8"))
            given.stored.parent.mkdir(parents=True, exist_ok=True)
            given.stored.write_bytes(gzip.compress(kept.encode(), mtime=0))
            return 0
        for stored in given.stored:
            page = given.out / f"{stored.parent.name}.html"
            whole = put_back(gzip.decompress(stored.read_bytes()).decode())
            page.parent.mkdir(parents=True, exist_ok=True)
            page.write_text(whole, encoding="utf-8", newline="\n")
            print(page)
    except (OSError, ValueError) as err:
        print(f"stored_report: {given.page if given.action == 'keep' else stored}: {err}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
