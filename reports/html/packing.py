"""Data and scripts packed into a page, which unpacks them when it is opened (`assets/unpack.js`)."""

from __future__ import annotations

import base64
import gzip
import hashlib
from functools import lru_cache


@lru_cache(maxsize=4)  # plotly.js, and scripts that stay the same while a folder is watched
def packed_script(text: str) -> str:
    """Return a script as `packed` does."""
    return packed(text)


def packed(text: str) -> str:
    """Return text as gzip in base64: letters, digits, `+`, `/` and `=`, which cannot end an element."""
    return base64.b64encode(gzip.compress(text.encode("utf-8"), mtime=0)).decode("ascii")


def unpacked(text: str) -> str:
    """Return what `packed` was given."""
    return gzip.decompress(base64.b64decode(text)).decode("utf-8")


def policy_hash(script: str) -> str:
    """Return the name of a script in a security policy; a page runs what a script of it inserts under the same rule."""
    return f"sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}"
