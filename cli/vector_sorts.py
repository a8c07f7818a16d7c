"""numpy's sorts on AMD's Zen 4, five times slower with AVX-512 than with AVX2.

https://github.com/numpy/x86-simd-sort/issues/6. numpy reads the choice from the environment when it is imported.
"""

from __future__ import annotations

import os
import re
import sys
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path

VARIABLE, OTHER_VARIABLE = "NPY_DISABLE_CPU_FEATURES", "NPY_ENABLE_CPU_FEATURES"
AVX512 = "X86_V4"  # numpy's name, from 2.4 on
AMD, ZEN_3_AND_4 = "AuthenticAMD", 25
_HEAD_BYTES = 4096  # of a file with a part for each processor


def avoid_slow_sorts(cpuinfo: Path = Path("/proc/cpuinfo")) -> None:
    """Let numpy sort with AVX2 where AVX-512 is slower, unless the user has chosen or numpy is loaded."""
    if "numpy" in sys.modules or VARIABLE in os.environ or OTHER_VARIABLE in os.environ:
        return
    with suppress(OSError):  # no Linux
        with cpuinfo.open(encoding="utf-8", errors="replace") as file:
            is_slow = is_slow_with_avx512(file.read(_HEAD_BYTES))
        if is_slow and _is_wheel():
            os.environ[VARIABLE] = AVX512


def is_slow_with_avx512(cpuinfo: str) -> bool:
    fields = dict(re.findall(r"^([\w ]+?)\s*: (.*)$", cpuinfo, re.MULTILINE))
    return (
        fields.get("vendor_id") == AMD
        and fields.get("cpu family") == str(ZEN_3_AND_4)
        and "avx512f" in fields.get("flags", "").split()
    )


def _is_wheel() -> bool:
    """Return whether numpy is a wheel: a build for this processor refuses to work without its features."""
    numpy = find_spec("numpy")
    return bool(numpy and numpy.origin and (Path(numpy.origin).parents[1] / "numpy.libs").is_dir())
