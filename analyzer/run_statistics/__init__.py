"""What can be said of a group of runs, where a run is one observation: intervals, changes, losses, detectors.

Everything is numpy in and frozen records out: no frame, no file. Numbers are in the unit of the values that come in.
"""

from ..statistics.intervals import MIN_EPISODES, MIN_RUNS, Basis, Interval
from ..statistics.power import (
    benjamini_hochberg_adjusted,
    holm_adjusted,
    messages_to_close,
    runs_to_decide,
    runs_to_narrow,
    smallest_shift,
)
from .between_runs import interval_of_runs, interval_within
from .change import Change, Verdict, change_of_runs
from .modes import Modes, Trend, WarmUp, find_modes, find_trend, find_warm_up
from .received import DeliveryChange, change_of_received, received_interval
from .runs import MEAN, Run, Statistic
from .spread import Spread, runs_to_settle_ratio, runs_to_settle_value, spread_of_runs

__all__ = [
    "MEAN",
    "MIN_EPISODES",
    "MIN_RUNS",
    "Basis",
    "Change",
    "DeliveryChange",
    "Interval",
    "Modes",
    "Run",
    "Spread",
    "Statistic",
    "Trend",
    "Verdict",
    "WarmUp",
    "benjamini_hochberg_adjusted",
    "change_of_received",
    "change_of_runs",
    "find_modes",
    "find_trend",
    "find_warm_up",
    "holm_adjusted",
    "interval_of_runs",
    "interval_within",
    "messages_to_close",
    "received_interval",
    "runs_to_decide",
    "runs_to_narrow",
    "runs_to_settle_ratio",
    "runs_to_settle_value",
    "smallest_shift",
    "spread_of_runs",
]
