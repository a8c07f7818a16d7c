#!/bin/bash
# polars: a column divided by a number is multiplied by the number's reciprocal
#
# version:  polars 2.1.0, numpy 2.4 (Linux, x86_64)
# expected: pl.Series([433333.0]) / 1e6 is 0.433333, as Python, numpy and IEEE 754 divide
# seen:     0.43333299999999997: three of ten whole numbers below 2,000,000 divided by 1e6 are off in the last place, and not
#           equal to what another program divides; a column divided by a column is exact
# source:   https://github.com/pola-rs/polars/issues/23741 (closed); https://github.com/pola-rs/polars/pull/1131
#
# Exits with 0 while it is so, with 1 once polars divides, with 2 where it cannot be tried.
set -u
folder=$(mktemp -d) && trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv" && "$folder/venv/bin/pip" install --quiet polars==2.1.0 numpy || exit 2
"$folder/venv/bin/python" - <<'P'
import sys

import numpy as np
import polars as pl

values = np.arange(1.0, 2_000_000)
column = pl.Series(values)
by_number = (column / 1e6).to_numpy() != values / 1e6
by_column = (column / pl.Series(np.full(len(values), 1e6))).to_numpy() != values / 1e6
print(f"polars {pl.__version__}: 433333 / 1e6 is {(pl.Series([433333.0]) / 1e6)[0]!r}, Python says {433333 / 1e6!r}")
print(f"unlike numpy: {by_number.mean():.1%} of quotients by a number, {by_column.mean():.1%} of quotients by a column")
sys.exit(0 if by_number.any() and not by_column.any() else 1)
P
