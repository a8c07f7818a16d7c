"""A Gaussian process over what was measured: the time of sizes, rates and links between, with an interval.

The interval is conformal (V. Vovk, A. Gammerman, G. Shafer, 2005): errors at campaigns that were left out, over the process's own
spread, of which 90 % are within.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from importlib.util import find_spec
from typing import Any, TypeAlias

import numpy as np
import polars as pl
from numpy.typing import NDArray

from dds_trace.analyzer.model.parameters import QOS_DEFAULTS
from dds_trace.analyzer.model.setting import CONDITIONS, parse_setting
from dds_trace.analyzer.statistics.intervals import MIN_RUNS
from dds_trace.analyzer.statistics.percentiles import planned_messages
from dds_trace.analyzer.verdicts.job import Guess, Job
from dds_trace.base import limits
from dds_trace.base.units import counted

from ..plan.cells import Cell
from ..plan.link import Link
from ..plan.plan import Plan, RunSettings
from ..plan.schedule import plan_seconds
from .results import Campaign, campaign_of, read_campaigns, statistic_name

Parameters: TypeAlias = "Mapping[str, Any]"

SHARE = 0.9
"""Share of left-out results that the interval has to contain."""
RIGHT, FACTOR = 0.85, 2.0
"""Share of left-out results that have to be within this factor of the estimate; sizes that no campaign has are the harder ones."""
MOST_QUANTILE = 0.9
"""Largest quantile with an estimate: of p99 too few left-out results were within their ranges (docs/results/learning.md)."""
LEAST_ERRORS = 20
"""Left-out results below which nothing is estimated."""
LEAST_OF_ODD = 5
OUTSIDE, UNMEASURED = "it is outside of what was measured", "nobody measured "
FILLED = 0.9
"""Offered load, over the link's rate, from which a queue grows as long as a run lasts."""
MOST_RESULTS = 1500
"""The latest; time and memory of a process grow with the cube and the square of their number."""

_LOOPBACK_MBIT_S = 1e5
_ROUND_TRIP_NS = 3e5
"""Of an empty message."""
_WIDTHS = np.array([0.7, 0.7, 1.0, 0.5, 1.0, 1.0])
"""Length scales of `Question.numbers` against each other; a word that differs is 1 to 2 apart."""
_WORD_WIDTHS = {"backend": 1.5, "data_type": 2.0}


@dataclass(frozen=True, slots=True)
class Question:
    """What the model sees of a result.

    Attributes:
        numbers: logarithms of size, rate, link rate and load over the link's rate, and loss and delay.
        words: middleware, bridge and settings.
        site: what has to be equal: middleware, bridge, data, devices and conditions.
        least_ns: time that the link takes.
    """

    numbers: tuple[float, ...]
    words: frozenset[str]
    site: tuple[object, ...]
    least_ns: float
    load: float

    @property
    def position(self) -> NDArray[np.float64]:
        """Size, rate, link rate, loss, delay."""
        return np.array([*self.numbers[:3], *self.numbers[4:]])


def link_numbers(setting: str) -> dict[str, float]:
    """Return the numbers of the emulated link in a result's settings, which anybody may have written."""
    _, _, inner = parse_setting(setting).get("link", "").rstrip(")").partition("(")
    numbers = {}
    for key, _, text in (pair.partition("=") for pair in inner.split(",")):
        with suppress(ValueError):
            if limits.LINE_MBIT_S.fault(float(text)) is None:
                numbers[key] = float(text)
    return numbers


def link_of(setting: str) -> Link:
    numbers = link_numbers(setting)
    rate_mbit_s, loss_percent = numbers.get("rate_mbit_s", 0.0), numbers.get("loss_percent", 0.0)
    return Link(rate_mbit_s=rate_mbit_s, loss_percent=loss_percent, shared="shared" in numbers)


def overload(setting: str, payload_bytes: float, rate_hz: float) -> str:
    """Return words, none where the link carries it."""
    link, mbit_s = link_of(setting), 8e-6 * payload_bytes * rate_hz
    return link.load_words(mbit_s) if link.load(mbit_s) > 1 else ""


def question_of(parameters: Parameters) -> Question:
    link, settings = link_numbers(parameters["setting"]), parse_setting(parameters["setting"])
    loss_percent, delay_ms = link.get("loss_percent", 0.0), link.get("delay_ms", 0.0)
    size, rate_hz = max(1.0, parameters["payload_bytes"]), max(1e-6, parameters["rate_hz"])
    mbit_s = link.get("rate_mbit_s") or _LOOPBACK_MBIT_S
    load = 8e-6 * size * rate_hz * (1 + link.get("shared", 0.0)) / mbit_s
    middleware = {name: parameters[name] for name in ("vendor", "backend", "bridge", "data_type")}
    conditions = {key: text for key, text in settings.items() if key in CONDITIONS - {"link"}}
    choices = {
        **{name: parameters[name] for name, usual in QOS_DEFAULTS.items() if parameters[name] != usual},
        **{key: text for key, text in settings.items() if key not in CONDITIONS and key != "wire"},
    }
    if "configuration" in choices:  # its file is in a variable of the middleware, too
        choices = {key: text for key, text in choices.items() if not key.isupper()}
    devices = parameters["ping_device"], parameters["relay_device"], parameters["connectivity"] == "loopback"
    logarithms = (math.log(value) for value in (size, rate_hz, mbit_s, max(load, 0.01)))
    return Question(
        numbers=(*logarithms, math.log1p(10 * loss_percent), math.log1p(delay_ms)),
        words=frozenset(f"{key}={text}" for key, text in {**middleware, **conditions, **choices}.items()),
        site=(*middleware.values(), *devices, *sorted(conditions.items())),
        least_ns=_ROUND_TRIP_NS + 2e6 * (8e-3 * size / mbit_s + delay_ms),
        load=load,
    )


class Process:
    """The process of some results; `kernel` is that of an earlier fit, or None to fit one."""

    def __init__(self, questions: Sequence[Question], times_ns: NDArray[np.float64], kernel: Any = None) -> None:
        from sklearn.gaussian_process import GaussianProcessRegressor
        from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

        self.questions, self.times_ns = questions, times_ns
        self._words = sorted(frozenset().union(*(question.words for question in questions)))
        is_finite = np.isfinite(times_ns)
        fitted = [question for question, fits in zip(questions, is_finite, strict=True) if fits]
        usual = ConstantKernel(2.0, (0.1, 100)) * Matern(4.0, (0.3, 5), nu=1.5) + WhiteKernel(0.02, (0.01, 1))
        optimizer = "fmin_l_bfgs_b" if kernel is None else None
        self._process = GaussianProcessRegressor(kernel or usual, normalize_y=True, optimizer=optimizer)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a bound of the kernel is reached
            self._process.fit(self._features(fitted), np.log(times_ns[is_finite]) - _least(fitted))
        self.kernel = self._process.kernel_

    def _features(self, questions: Sequence[Question]) -> NDArray[np.float64]:
        widths = [_WORD_WIDTHS.get(word.partition("=")[0], 1.0) for word in self._words]
        words = [[word in question.words for word in self._words] for question in questions]
        numbers = np.array([question.numbers for question in questions])
        return np.hstack([numbers / _WIDTHS, np.array(words) / widths])

    def predict(self, questions: Sequence[Question]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the logarithm of the time in ns, and its spread; float64 of shape (questions,)."""
        log_ns, spread = self._process.predict(self._features(questions), return_std=True)
        return log_ns + _least(questions), spread

    def why_unknown(self, question: Question) -> str:
        """Return why nothing can be said, or an empty text."""
        near = [number for number, other in enumerate(self.questions) if other.site == question.site]
        positions = np.array([self.questions[number].position for number in near]).reshape(-1, 5)
        is_below, is_above = positions <= question.position + 1e-9, positions >= question.position - 1e-9
        if not (is_below.any(0) & is_above.any(0)).all():
            return OUTSIDE
        if unknown := question.words - {*self._words}:
            return f"{UNMEASURED}{', '.join(sorted(unknown))}"
        if question.load >= FILLED:
            return f"it fills {100 * question.load:.0f} % of the link"
        distances = np.abs(positions - question.position).sum(1)
        nearest = np.array(near)[distances <= distances.min() + 1e-9]
        if not np.isfinite(self.times_ns[nearest]).all():
            return "too many messages are lost next to it"
        return ""


def _least(questions: Sequence[Question]) -> NDArray[np.float64]:
    return np.log([question.least_ns for question in questions])


@dataclass(frozen=True, slots=True)
class Errors:
    """Errors at left-out results: of the logarithm of the time (infinite: lost), and the process's spread there."""

    errors: NDArray[np.float64]
    spreads: NDArray[np.float64]

    @property
    def widest(self) -> float:
        """Largest spread up to which `RIGHT` of them were within `FACTOR`; 0 if none."""
        order = np.argsort(self.spreads)
        shares = np.cumsum(self.errors[order] <= math.log(FACTOR)) / np.arange(1, len(order) + 1)
        fine = np.flatnonzero(shares >= RIGHT)
        return float(self.spreads[order][fine[-1]]) if len(fine) and fine[-1] + 1 >= LEAST_ERRORS else 0.0

    @property
    def held_out(self) -> int:
        return int((self.spreads <= self.widest).sum())

    def half_width(self, spread: float) -> float:
        """Return the logarithm from the estimate to an end of its interval.

        The usual error is added to each spread: two campaigns differ, however near one is to the other (H. Papadopoulos and others, 2002).
        """
        is_near = self.spreads <= self.widest
        usual = float(np.median(self.errors[is_near]))
        scores = np.sort(self.errors[is_near] / (self.spreads[is_near] + usual))
        rank = math.ceil((len(scores) + 1) * SHARE)
        return float(scores[rank - 1]) * (spread + usual) if rank <= len(scores) else math.inf


class Learned:
    """What campaigns say of one statistic (`response 0.99`)."""

    def __init__(self, campaigns: Sequence[Campaign], statistic: str) -> None:
        rows = _rows(campaigns, statistic)
        self.process: Process | None = None
        self.errors = Errors(np.empty(0), np.empty(0))
        while sum(math.isfinite(time_ns) for _, _, time_ns in rows) > LEAST_ERRORS:
            numbers, questions, times_ns = zip(*rows, strict=True)
            self.process = Process(questions, np.array(times_ns))
            if (odd := _odd_campaign(self.process, numbers)) is None:
                self.errors = _left_out_errors(self.process, _folds(numbers, questions))
                break
            rows = [row for row in rows if row[0] != odd]
        self.campaigns = len({number for number, _, _ in rows})

    def guess(self, question: Question) -> tuple[float, float, float] | str:
        """Return time, lower and upper end in ns, or why there is none."""
        if self.process and (why := self.process.why_unknown(question)):
            return why
        if self.process is None or not self.errors.widest:
            return "too little was measured to know how far an estimate is off"
        (log_ns,), (spread,) = self.process.predict([question])
        if spread > self.errors.widest:
            return "what was measured is too far from it"
        half = self.errors.half_width(float(spread))
        return math.exp(log_ns), math.exp(log_ns - half), math.exp(log_ns + half)


def _rows(campaigns: Sequence[Campaign], statistic: str) -> list[tuple[int, Question, float]]:
    return [
        (number, question_of(result.parameters), result.times_ns[statistic])
        for number, campaign in enumerate(campaigns)
        for result in campaign.results
        if statistic in result.times_ns and result.parameters["rate_hz"]
    ][-MOST_RESULTS:]


def _folds(campaigns: Sequence[int], questions: Sequence[Question]) -> Iterator[NDArray[np.bool_]]:
    """Yield what is left out in turn: each campaign, where there are three, and each size and rate, in all of them."""
    messages = [question.numbers[:2] for question in questions]
    numbers = np.unique(messages, axis=0, return_inverse=True)[1].reshape(-1)
    for parts in (np.array(campaigns), numbers) if len({*campaigns}) >= MIN_RUNS else (numbers,):
        yield from (parts == part for part in np.unique(parts))


def _odd_campaign(process: Process, campaigns: Sequence[int]) -> int | None:
    """Return the campaign that the others are off most, by more than `FACTOR` at its median."""
    medians = {}
    for campaign in sorted({*campaigns}) if len({*campaigns}) > MIN_RUNS else ():
        errors = _left_out_errors(process, [np.array(campaigns) == campaign]).errors
        if len(errors) >= LEAST_OF_ODD:
            medians[campaign] = float(np.median(errors))
    worst = max(medians, key=medians.__getitem__, default=None)
    return worst if worst is not None and medians[worst] > math.log(FACTOR) else None


def _left_out_errors(process: Process, folds: Iterable[NDArray[np.bool_]]) -> Errors:
    errors, spreads = [], []
    for is_out in folds:
        if np.isfinite(process.times_ns[~is_out]).sum() < LEAST_ERRORS:
            continue
        within, out = (np.flatnonzero(part).tolist() for part in (~is_out, is_out))
        others = Process([process.questions[number] for number in within], process.times_ns[within], process.kernel)
        answered = [number for number in out if not others.why_unknown(process.questions[number])]
        if answered:
            log_ns, spread = others.predict([process.questions[number] for number in answered])
            errors.append(np.abs(log_ns - np.log(process.times_ns[answered])))
            spreads.append(spread)
    return Errors(np.concatenate([*errors, []]), np.concatenate([*spreads, []]))


def can_learn() -> bool:
    return find_spec("sklearn") is not None


@dataclass
class Estimator:
    """Guesses for a job: from the messages of an analysis, and what is kept of other campaigns."""

    messages: pl.DataFrame
    job: Job

    def __call__(self, parameters: Parameters, why: str = "") -> Guess:
        """Return a guess of a result with these values of `SETTING_COLUMNS` and `CELL_COLUMNS`, none with a reason `why`."""
        if words := overload(*(parameters[name] for name in ("setting", "payload_bytes", "rate_hz"))):
            return Guess(f"no setting makes this fit: {words}", lower_ns=math.inf)
        if self.job.reliability > MOST_QUANTILE:
            why = why or f"estimates end at --reliability {MOST_QUANTILE:g}"
        answer = why if why or not can_learn() else self._learned.guess(question_of(parameters))
        if isinstance(answer, str):
            minutes = counted(minutes_to_measure(parameters, self.job.reliability), "minute")
            return Guess(": ".join(filter(None, (f"not known: measure it ({minutes})", answer))))
        errors, campaigns = self._learned.errors.held_out, self._learned.campaigns
        reason = f"not measured: learned from {counted(campaigns, 'campaign')}; {100 * SHARE:g} % of {errors} left-out results were in such a range"
        return Guess(reason, *answer, errors)

    @cached_property
    def _learned(self) -> Learned:
        present = campaign_of(self.messages, self.job)
        return Learned([*read_campaigns(present.runs), present], statistic_name(self.job.metric, self.job.reliability))


def minutes_to_measure(parameters: Parameters, reliability: float) -> int:
    """Return the time of the least sweep that gives a result an interval."""
    size, rate_hz = parameters["payload_bytes"], parameters["rate_hz"]
    cell = Cell(backend=parameters["backend"], bridge=parameters["bridge"], size=size, rate=rate_hz)
    run = RunSettings(messages=math.ceil(planned_messages(reliability) / MIN_RUNS), repeats=MIN_RUNS)
    link = link_of(parameters["setting"]) if link_numbers(parameters["setting"]) else None
    return math.ceil(plan_seconds(Plan("measure", (cell,), run=run, link=link)).seconds / 60)


def order(candidates: Sequence[Parameters], campaigns: Sequence[Campaign], statistic: str) -> list[Parameters]:
    """Return candidates (mappings as of `question_of`), the one that is likely the quickest first.

    They stay in order where scikit-learn is missing, or too little was measured. What was lost took ten times the longest.
    """
    rows = _rows(campaigns, statistic)
    times_ns = np.array([time_ns for _, _, time_ns in rows])
    is_finite = np.isfinite(times_ns)
    if not can_learn() or is_finite.sum() < LEAST_ERRORS:
        return list(candidates)
    times_ns[~is_finite] = 10 * times_ns[is_finite].max()
    log_ns, _ = Process([question for _, question, _ in rows], times_ns).predict([*map(question_of, candidates)])
    return [candidates[number] for number in np.argsort(log_ns, kind="stable")]
