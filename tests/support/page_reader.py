"""The pages of the HTML report that tests open."""

import base64
import gzip
from functools import cache

from analyses import EVERY_ANALYSIS
from four_campaigns import CAMPAIGNS
from kept import kept
from wording import report_as

EVERY_PAGE = {**EVERY_ANALYSIS, **CAMPAIGNS}


@cache
def rendered(name, kind):
    return kept(lambda: report_as(kind, EVERY_PAGE[name]()), f"{kind} of {name}")()


def unpacked(text: str) -> str:
    return gzip.decompress(base64.b64decode(text)).decode("utf-8")
