"""Results of campaigns, kept in `$XDG_STATE_HOME/dds-trace/learned`."""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import polars as pl

from dds_trace.analyzer.model.parameters import CELL_COLUMNS, SETTING_COLUMNS
from dds_trace.analyzer.run_statistics.runs import Statistic
from dds_trace.analyzer.verdicts.cases import partition_groups
from dds_trace.analyzer.verdicts.job import Job
from dds_trace.analyzer.verdicts.setup_runs import SetupRuns
from dds_trace.base.errors import UNREADABLE, OptionError
from dds_trace.base.files import output_errors, read_regular, write_whole
from dds_trace.base.records import RecordReader, to_json
from dds_trace.base.streams import say
from dds_trace.base.units import counted

MOST_CAMPAIGNS = 100
"""The newest are read."""

_QUANTILES = (0.5, 0.9, 0.99)
_METRICS = ("response", "latency")


@dataclass(frozen=True, slots=True)
class Result:
    """What one setup took for one message, rate and link.

    Attributes:
        parameters: of the result (`SETTING_COLUMNS` and `CELL_COLUMNS`): devices, link, load and settings, too.
        times_ns: `metric quantile` (`response 0.99`) -> time, infinite if more were lost.
    """

    parameters: Mapping[str, str | int | float | None]
    times_ns: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Campaign:
    """`runs` are ids, by which the same recordings are known again."""

    runs: tuple[str, ...]
    results: tuple[Result, ...]


def results_folder() -> Path:
    state = os.environ.get("XDG_STATE_HOME") or Path(os.path.expanduser("~"), ".local", "state")  # noqa: PTH111
    return Path(state) / "dds-trace" / "learned"


def statistic_name(metric: str, quantile: float) -> str:
    return f"{metric} {quantile:g}"


def campaign_of(messages: pl.DataFrame, job: Job | None = None) -> Campaign:
    metrics = dict.fromkeys((*_METRICS, *((job.metric,) if job else ())))
    quantiles = sorted({*_QUANTILES, *((job.reliability,) if job else ())})
    results = []
    for rows in partition_groups(messages, (*SETTING_COLUMNS, *CELL_COLUMNS)):
        setup, times_ns = SetupRuns.of(rows), {}
        for metric in metrics:
            estimates = setup.estimates_of(metric, list(map(Statistic, quantiles)), 0.95)
            for quantile, estimate in zip(quantiles, estimates, strict=True):
                if estimate.interval.value is not None:
                    times_ns[statistic_name(metric, quantile)] = estimate.interval.value
        results.append(Result(rows.select(*SETTING_COLUMNS, *CELL_COLUMNS).row(0, named=True), times_ns))
    return Campaign(tuple(f"{run:016x}" for run in messages["run_id"].unique().sort()), tuple(results))


def keep(campaign: Campaign) -> str:
    """Keep a campaign in place of an earlier analysis of some of its runs; return a line that names the folder."""
    folder, text = results_folder(), json.dumps(to_json(campaign), separators=(",", ":"))
    name = hashlib.sha256("".join(campaign.runs).encode()).hexdigest()[:16]
    with output_errors(folder):
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        for path, other in _read_all(folder):
            if not {*campaign.runs}.isdisjoint(other.runs):
                path.unlink(missing_ok=True)
        write_whole(folder / f"{name}.json", f"{text}\n")
    results = counted(len(campaign.results), "result")
    return f"{results} kept for other sizes, rates and links in {folder}: remove it to forget what was measured"


def read_campaigns(other_than: Iterable[str] = ()) -> list[Campaign]:
    """Return what is kept, without the campaigns of these runs; a line on stderr names a file that is left out."""
    runs = {*other_than}
    return [campaign for _, campaign in _read_all(results_folder()) if runs.isdisjoint(campaign.runs)]


def _read_all(folder: Path) -> list[tuple[Path, Campaign]]:
    paths = sorted(folder.glob("*.json"), key=lambda path: path.lstat().st_mtime_ns)[-MOST_CAMPAIGNS:]
    return [(path, campaign) for path in paths if (campaign := _read(path)) is not None]


def _read(path: Path) -> Campaign | None:
    try:
        return _checked(json.loads(read_regular(path, _check_owner)))
    except (OptionError, *UNREADABLE) as err:
        say(f"{path} is left out: {getattr(err, 'strerror', None) or err}; remove it")
        return None


def _check_owner(owner: int) -> None:
    if owner != os.geteuid():
        raise OptionError("it belongs to another user")


def _checked(value: object) -> Campaign:
    campaign = RecordReader().read(Campaign, value)
    for result in campaign.results:
        sizes = [result.parameters[name] for name in ("payload_bytes", "rate_hz")]
        if not all(isinstance(size, int | float) and 0 <= size < 1e12 for size in sizes):
            raise ValueError(f"no size and rate of a message: {sizes}")
        if missing := {*SETTING_COLUMNS, "data_type"} - result.parameters.keys():
            raise ValueError(f"a result lacks {', '.join(sorted(missing))}")
        if not isinstance(result.parameters["setting"], str) or not all(
            0 < time_ns <= math.inf for time_ns in result.times_ns.values()
        ):
            raise ValueError("a result has no text of its settings, or a time that is not above 0")
    return campaign
