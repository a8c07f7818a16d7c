import os
import subprocess
import sys

import numpy as np
import pytest

from dds_trace.cli.vector_sorts import OTHER_VARIABLE, VARIABLE, avoid_slow_sorts, is_slow_with_avx512

ZEN_4 = """processor\t: 0
vendor_id\t: AuthenticAMD
cpu family\t: 25
model\t\t: 17
model name\t: AMD EPYC
flags\t\t: fpu avx2 avx512f avx512dq
bugs\t\t: sysret_ss_attrs

processor\t: 1
vendor_id\t: AuthenticAMD
"""
HAS_AVX512 = "X86_V4" in np.show_config("dicts").get("SIMD Extensions", {}).get("found", [])

FEATURES = """
import sys
from pathlib import Path
from dds_trace.cli import vector_sorts
vector_sorts.avoid_slow_sorts.__defaults__ = (Path(sys.argv[1]),)
from dds_trace.cli.dds_analyze import main
try:
    main(["--version"])
except SystemExit:
    pass
import numpy
print("X86_V4" in numpy.show_config("dicts")["SIMD Extensions"]["found"])
"""


def sorts_with_avx512(cpuinfo, text, **variables):
    """Whether numpy uses AVX-512 in a process that has run `dds-analyze` on a processor of this description."""
    cpuinfo.write_text(text)
    environment = {k: v for k, v in os.environ.items() if k not in {VARIABLE, OTHER_VARIABLE}} | variables
    command = [sys.executable, "-W", "error", "-c", FEATURES, str(cpuinfo)]
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return {"True": True, "False": False}[ran.stdout.split()[-1]]


def test_zen_4_alone_is_slow_with_avx512():
    assert is_slow_with_avx512(ZEN_4)
    assert not is_slow_with_avx512(ZEN_4.replace("AuthenticAMD", "GenuineIntel"))
    assert not is_slow_with_avx512(ZEN_4.replace(": 25", ": 26"))  # Zen 5
    assert not is_slow_with_avx512(ZEN_4.replace("avx512f", "avx512f_not"))  # Zen 3
    assert not is_slow_with_avx512("Processor\t: ARMv7\nFeatures\t: neon\n")
    assert not is_slow_with_avx512("")


@pytest.mark.skipif(not HAS_AVX512, reason="this processor, or this numpy, has no AVX-512 to do without")
def test_analysis_sorts_without_avx512_on_zen_4_alone(tmp_path):
    cpuinfo = tmp_path / "cpuinfo"
    assert not sorts_with_avx512(cpuinfo, ZEN_4)
    assert sorts_with_avx512(cpuinfo, ZEN_4.replace("AuthenticAMD", "GenuineIntel"))


@pytest.mark.skipif(not HAS_AVX512, reason="this processor, or this numpy, has no AVX-512 to do without")
def test_choice_of_the_user_stays(tmp_path):
    cpuinfo = tmp_path / "cpuinfo"
    assert sorts_with_avx512(cpuinfo, ZEN_4, **{VARIABLE: ""})
    assert not sorts_with_avx512(cpuinfo, ZEN_4, **{OTHER_VARIABLE: "X86_V3"})


def test_a_numpy_that_is_loaded_is_left_alone(monkeypatch, tmp_path):
    cpuinfo = tmp_path / "cpuinfo"
    cpuinfo.write_text(ZEN_4)
    monkeypatch.delenv(VARIABLE, raising=False)
    avoid_slow_sorts(cpuinfo)
    assert VARIABLE not in os.environ
    monkeypatch.delitem(sys.modules, "numpy")
    avoid_slow_sorts(tmp_path / "none")
    assert VARIABLE not in os.environ
    monkeypatch.setattr("dds_trace.cli.vector_sorts._is_wheel", lambda: False)
    avoid_slow_sorts(cpuinfo)
    assert VARIABLE not in os.environ
