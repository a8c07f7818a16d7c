"""A drive: what a link did over time, from a CSV file."""

from __future__ import annotations

import csv
import hashlib
import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TypeAlias

from dds_trace.base import limits
from dds_trace.base.errors import OptionError
from dds_trace.base.files import read_regular
from dds_trace.base.units import SECOND_NS, counted

Row: TypeAlias = tuple[float, float, float, float, float]
"""Values of `COLUMNS`."""


COLUMNS = ("time_s", "rate_mbit_s", "delay_ms", "loss_percent", "jitter_ms")
"""Columns of the file; `time_s` is required, a missing one is 0 in every row (no limit of the rate)."""

MOST_ROWS = 100_000
_LIMITS = (limits.WAIT_S, limits.LINE_MBIT_S, limits.DELAY_MS, limits.PERCENT, limits.DELAY_MS)


@dataclass(frozen=True, slots=True)
class Drive:
    """The rows of a file, each valid from its time on; the last one starts it over. A rate of 0 lets nothing pass."""

    rows: tuple[Row, ...]
    has_rate: bool
    sha256: str

    @property
    def length_s(self) -> float:
        return self.rows[-1][0]

    def between(self, started_ns: int, first_ns: int, last_ns: int) -> Iterator[tuple[int, Row]]:
        length_ns = round(self.length_s * SECOND_NS)
        valid: Row | None = None
        for turn in itertools.count(max(0, (first_ns - started_ns) // length_ns)):
            for row in self.rows[:-1]:
                at_ns = started_ns + turn * length_ns + round(row[0] * SECOND_NS)
                if at_ns < first_ns:
                    valid = row
                    continue
                if valid is not None:
                    yield first_ns, valid
                if at_ns > last_ns:
                    return
                valid = None
                yield at_ns, row


@cache
def read_drive(path: str) -> Drive:
    try:
        data = read_regular(Path(path))
        lines = data.decode().splitlines()
    except OSError as err:
        raise OptionError(f"{path}: {err.strerror}; give the path of a CSV file, from the folder of the plan") from err
    except UnicodeDecodeError as err:
        raise OptionError(f"{path}: {err}; a drive is a CSV file of UTF-8 text") from err
    if len(lines) > MOST_ROWS:
        raise OptionError(f"{path} has more than {MOST_ROWS:,} lines; thin it out")
    numbered = [(number, line) for number, line in enumerate(lines, 1) if line.strip() and not line.startswith("#")]
    names, *records = [[cell.strip() for cell in record] for record in csv.reader(line for _, line in numbered)] or [[]]
    if "time_s" not in names or not set(names) <= {*COLUMNS} or len({*names}) < max(2, len(names)):
        unknown = f" ({', '.join(names)})" if "time_s" in names else ""  # nothing of a file that is no drive is printed
        raise OptionError(
            f"{path}: the first line{unknown} does not name columns of a drive; write {','.join(COLUMNS)}"
        )
    rows = [_row(f"{path}:{number}", names, record) for (number, _), record in zip(numbered[1:], records, strict=True)]
    times = [row[0] for row in rows]
    if len(rows) < 2 or times[0] != 0:
        raise OptionError(f"{path} has {counted(len(rows), 'row')}; write at least two, the first at time_s 0")
    for (number, _), before, after in zip(numbered[2:], times, times[1:], strict=False):
        if after <= before:
            raise OptionError(f"{path}:{number}: time_s {after:g} does not follow {before:g}; sort the rows by time")
    return Drive(tuple(rows), "rate_mbit_s" in names, hashlib.sha256(data).hexdigest())


def _row(where: str, names: list[str], record: list[str]) -> Row:
    if len(record) != len(names):
        raise OptionError(f"{where} has {counted(len(record), 'value')} for {len(names)} columns; write one for each")
    values = dict.fromkeys(COLUMNS, 0.0)
    for name, text in zip(names, record, strict=True):
        try:
            values[name] = float(text)
        except ValueError:
            raise OptionError(f"{where}: {name} is {limits.shown(text)}, not a number") from None
        fault = _LIMITS[COLUMNS.index(name)].fault(values[name])
        if fault is not None:
            raise OptionError(f"{where}: {name} is {text}; {fault}")
    return values["time_s"], values["rate_mbit_s"], values["delay_ms"], values["loss_percent"], values["jitter_ms"]
