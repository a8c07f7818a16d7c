"""The answer to a question: which middleware with which settings, searched and proven in runs."""

from __future__ import annotations

import json
import math
import re
import shlex
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, ExitStack, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from statistics import fmean
from typing import Any, TypeAlias

from dds_trace.base.records import to_json
from dds_trace.base.units import counted, joined

from .folder import replace_text
from .halving import (
    FIRST_SECONDS,
    MOST_FIRST_SECONDS,
    MOSTLY,
    NO_MORE_TIME,
    NO_TIME,
    PASSES,
    Candidate,
    Event,
    Measurer,
    Race,
    Standing,
    Tell,
)
from .link_probe import PROBE_S, probe_link
from .plan.flows import recorded_together
from .plan.link import Link
from .plan.plan import Plan
from .proof import proof_of
from .question import Question, as_learned, check_advisable, find_candidates, fits_words, settings_of
from .search import Bisection, RateAnswer, round_rate
from .trials import Imagined, open_trials

Answer: TypeAlias = "dict[str, Any]"
"""What `answer.json` has: see `answer`."""

PROOFS, LEAST_PROOFS = 5, 3
"""Fresh runs of each side of the proof, and fewest where time is short."""

JUDGE_S = 2.0
"""Time to compare two sides of the proof."""

PROOF_SHARE, PROOF_MESSAGES, PROOF_SECONDS = 0.45, 100, (2.0, 15.0)
"""Most of the time for the proof, or the least for what fits, messages of its runs, and their shortest and longest length."""

FIT_SECONDS, FIT_FRESH, FIT_SPAN, FIT_RESOLUTION = 2.0, 3, 64, 1.2
"""Length of the runs of the search for what fits, and number of fresh ones of what it found, between the request and a 64th of it, exact within 20 %."""

FILLED_SHARE = 0.7
"""Share of the link's rate at which the candidates are compared where the requested load does not fit."""

_FRESH = 1000
"""Number of the runs before the fresh ones."""

OpenTrials: TypeAlias = (
    "Callable[[Plan, Path, Callable[[str], None], float, dict[str, list[float]]], AbstractContextManager[Measurer]]"
)


def answer(question: Question, out: Path, tell: Tell = lambda _: None, *, began_s: float | None = None) -> Answer:
    """Search and prove the best setup for a question in the folder `out`/NAME, and write `answer.json` there.

    The folder of an interrupted search is continued; a finished one is kept, and a new one made.

    Args:
        tell: gets each step, in this thread, between runs. What it raises, and Ctrl-C, end the search with its recordings kept.
        began_s: time of `time.monotonic` from which the minutes count, by default now.

    Returns:
        `question`, `link` (measured or emulated, null on one machine), `load` (payload over the link's rate), `sentence`, `recommended`
        (`middleware`, `vendor`, `bundle`, `configuration`, `variables`, `exports`) or null, `candidates` (best first: an `Event.to_dict()`
        of the first looks, and `dropped`), `proofs` (of the best `against` another: `kept`, `verdict`, `reason`, `proof`, `received`,
        `command`), `fits` (highest `rate_hz` at the size and largest `size_bytes` at the rate, null if not found) or null, `seconds`, `folder`.

    Raises:
        OptionError: the plan has what cannot be advised on, or needs a right that is missing.
        TraceError: nothing can be recorded at all.
    """
    check_advisable(question.plan)
    search = Search(question, new_folder(out, question.plan.name), tell, time.monotonic)
    search.began_s = search.began_s if began_s is None else began_s
    return search.answer()


def promise(question: Question) -> tuple[int, float]:
    """Return the recordings and seconds of a search in which the candidates hardly differ."""
    check_advisable(question.plan)
    trials = Imagined(question.plan)
    with tempfile.TemporaryDirectory(prefix="dds-trace-advise-") as folder:
        search = Search(question, Path(folder), lambda _: None, lambda: trials.now_s, trials.open)
        if question.plan.has_two_devices:
            trials.now_s += PROBE_S
        ranking = search.look(search.fitted(question.plan), question.plan.link)
        search.record_proof(search.sides(ranking))
    return trials.recordings, trials.now_s


def new_folder(out: Path, name: str) -> Path:
    number = 1
    while (folder := out / (name if number == 1 else f"{name}-{number}")).joinpath("answer.json").exists():
        number += 1
    return folder


@dataclass(slots=True)
class Search:
    """The steps of an answer; `open` yields what measures in a folder, and `order` puts the most promising candidates first."""

    question: Question
    folder: Path
    tell: Tell
    clock: Callable[[], float]
    open: OpenTrials = open_trials
    order: Callable[[Plan, Sequence[Candidate]], Sequence[Candidate]] = as_learned
    link: Link | None = field(default=None, init=False)
    began_s: float = field(init=False)
    cut_short: set[str] = field(default_factory=set, init=False)
    overheads_s: dict[str, list[float]] = field(default_factory=dict, init=False)
    ranking: list[Standing] = field(default_factory=list, init=False)
    fresh: list[Standing] = field(default_factory=list, init=False)
    proofs: list[Answer] = field(default_factory=list, init=False)

    def __post_init__(self) -> None:
        self.began_s = self.clock()
        self.link = self.question.plan.link

    def answer(self) -> Answer:
        plan = self.question.plan
        if plan.has_two_devices:
            self._note("link", f"measuring the link and the clocks, {PROBE_S:.0f} s")
            self.link = probe_link(plan, self.folder, partial(self._note, "link"))
        if self.link is not None:
            self._note("link", str(self.link))
        if self.load > 1:
            self._note("fit", f"no setting makes this fit: {self._load_words()}")
        limits = self.question.limits
        self.ranking = self.look(self.fitted(plan), self.link)
        sides = self.sides(self.ranking)
        if self.load <= 1 and (racing := self._racing(sides)):
            fresh = self.record_proof(racing)
            self.fresh = fresh or racing
            self._judge([*self.fresh[1:], *(side for side in sides if side not in racing)], is_recorded=bool(fresh))
        chosen, fits = self._choose(), None
        measured = [standing for standing in self.fresh or sides if standing.looks]
        if chosen is None and measured:
            chosen = min(measured, key=lambda standing: standing.rank(limits))
            fits = self._fit(chosen.candidate)
        result = self._result(chosen, fits)
        if chosen is not None:  # else the same command goes on
            text = json.dumps(to_json(result, not_finite=lambda _: None), indent=1)
            replace_text(self.folder / "answer.json", f"{text}\n")
        self._say(Event("answer", result["sentence"], None if chosen is None else chosen.candidate))
        return result

    @property
    def load(self) -> float:
        return 0.0 if self.link is None else self.link.load(self.question.load_mbit_s)

    def _load_words(self) -> str:
        return "" if self.link is None else self.link.load_words(self.question.load_mbit_s)

    def _open(self, plan: Plan, stage: str, folder: Path) -> AbstractContextManager[Measurer]:
        return self.open(plan, folder, partial(self._note, stage), FIRST_SECONDS, self.overheads_s)

    def _note(self, stage: str, text: str) -> None:
        self._say(Event(stage, text))

    def _say(self, event: Event) -> None:
        self.tell(replace(event, left_s=max(0.0, self._until_s - self.clock())))

    @property
    def _until_s(self) -> float:
        return self.began_s + 60 * self.question.minutes

    def fitted(self, plan: Plan) -> Plan:
        """Return the plan, with rates that the link carries."""
        if self.load <= 1:
            return plan
        scale = FILLED_SHARE / self.load
        return replace(plan, cells=tuple(replace(cell, rate=float(f"{cell.rate * scale:.3g}")) for cell in plan.cells))

    def look(self, plan: Plan, link: Link | None) -> list[Standing]:
        """Return the candidates, best first."""
        candidates = self.order(plan, find_candidates(plan, link, self.folder / "configurations"))
        looks = replace(plan, name="looks", cells=tuple(cell for candidate in candidates for cell in candidate.cells))
        with self._open(looks, "look", self.folder / "looks") as trials:

            def proof_s() -> float:
                expected_s = partial(trials.expected_s, seconds=self.proof_seconds(trials, candidates))
                turn_s = 3 * fmean(map(expected_s, candidates))
                turns = min(PROOFS, max(LEAST_PROOFS, int(PROOF_SHARE * 60 * self.question.minutes / turn_s)))
                return max(turns * turn_s + 2 * JUDGE_S, PROOF_SHARE * 60 * self.question.minutes * (self.load > 1))

            race = Race(trials, self.question.limits, self._until_s, self._say, self.clock, reserve_s=proof_s)
            passes_s = PASSES * sum(trials.expected_s(candidate, FIRST_SECONDS) for candidate in candidates)
            spare_s = (self._until_s - self.clock() - proof_s() - passes_s) / (PASSES * len(looks.cells))
            return race.halve(candidates, min(MOST_FIRST_SECONDS, FIRST_SECONDS + max(0.0, spare_s)))

    def proof_seconds(self, trials: Measurer, candidates: Sequence[Candidate]) -> float:
        shortest_s, longest_s = PROOF_SECONDS
        cells = candidates[0].cells
        recordings = len(recorded_together(cells))
        overhead_s = fmean(trials.expected_s(candidate, longest_s) for candidate in candidates) - longest_s * recordings
        left_s = min(PROOF_SHARE * 60 * self.question.minutes, self._until_s - 2 * JUDGE_S - self.clock())
        allowed_s = left_s / (3 * PROOFS) - overhead_s
        enough_s = PROOF_MESSAGES / min(cell.rate for cell in cells)
        return max(shortest_s, min(enough_s, allowed_s / recordings, longest_s))

    @staticmethod
    def sides(ranking: Sequence[Standing]) -> list[Standing]:
        """Return the best, the default of its middleware, had that time or not, and the best of the others."""
        measured = [standing for standing in ranking if standing.looks]
        waiting = [standing for standing in ranking if standing.dropped == NO_TIME]
        defaults = [standing for standing in (*measured[1:], *waiting) if _is_default(standing, measured[0])]
        others = [standing for standing in measured[1:] if standing not in defaults]
        return [*measured[:1], *defaults[:1], *others[:1]]

    def _racing(self, sides: Sequence[Standing]) -> list[Standing]:
        """Those that lost little; none if the best breaks a limit."""
        excesses = [side.excess(self.question.limits)[0] for side in sides]
        return [side for side, excess in zip(sides, excesses, strict=True) if excess <= MOSTLY and not excesses[0]]

    def record_proof(self, sides: Sequence[Standing]) -> list[Standing]:
        """Record fresh runs of each side in turns, none of the runner-up where time is short; return none without one of each."""
        fresh = [Standing(side.candidate) for side in sides]
        until_s = self._until_s - JUDGE_S * (len(sides) - 1)
        with ExitStack() as stack:
            races = []
            for standing in fresh:
                plan = replace(self.question.plan, name="proof", cells=standing.candidate.cells)
                trials = stack.enter_context(self._open(plan, "proof", self._side_folder(standing)))
                races.append(Race(trials, self.question.limits, until_s, self._say, self.clock, "proof"))
            seconds = self.proof_seconds(races[0].measurer, [side.candidate for side in sides])
            fresh = self._take_turns(list(zip(fresh, races, strict=True)), seconds, until_s)
        return fresh if all(row.looks or row.dropped for row in fresh) else []

    def _take_turns(self, turns: list[tuple[Standing, Race]], seconds: float, until_s: float) -> list[Standing]:
        for number in range(PROOFS):
            turn_s = sum(race.measurer.expected_s(row.candidate, seconds) for row, race in turns)
            if (LEAST_PROOFS - number) * turn_s > until_s - self.clock():
                del turns[2:]  # the default precedes the runner-up
            for row, race in turns if number % 2 == 0 else reversed(turns):
                if not row.dropped and race.has_time(row.candidate, seconds):
                    race.run(row, seconds)
                elif not row.dropped:
                    return [row for row, _ in turns]
        return [row for row, _ in turns]

    def _side_folder(self, standing: Standing) -> Path:
        return self.folder / "proof" / re.sub(r"[^\w.+-]", "-", standing.candidate.name)

    def _judge(self, others: Sequence[Standing], *, is_recorded: bool) -> None:
        """Compare the best with each other side of the proof, if it was recorded, and name what is out of it."""
        for other in others:
            best, folders = self.fresh[0], [self._side_folder(side) for side in (other, self.fresh[0])]
            proof: Answer = {"of": best.candidate.name, "against": other.candidate.name}
            failed = next((side for side in (best, other) if side.dropped), None)
            if failed or not is_recorded:
                reason = f"{failed.candidate.name} is out: {failed.dropped}" if failed else ""
                proof |= {"kept": is_recorded and failed is other, "verdict": "incomplete", "proof": [], "received": []}
                proof["reason"] = reason if is_recorded else "there was no time for fresh runs"
            else:
                proof |= proof_of(best.candidate.name, *folders)
                ignore = ["--ignore", ",".join(proof["ignored"])] if proof["ignored"] else []
                proof["command"] = shlex.join(["dds-trace", "compare", *map(str, folders), "--paired", *ignore])
            self.proofs.append(proof)

    def _choose(self) -> Standing | None:
        """Return what keeps the limits in the fresh runs: a default unless a bundle is proven better, and what was faster."""
        limits = self.question.limits
        fitting = [row for row in self.fresh if row.looks and not row.excess(limits)[0]]
        if not fitting or self.fresh[0] not in fitting:
            return min(fitting, key=lambda row: row.level, default=None)
        best = chosen = self.fresh[0]
        for other, proof in zip(self.fresh[1:], self.proofs, strict=False):
            is_open, is_faster = proof["verdict"] != "better", other.level < chosen.level
            is_as_simple = bool(chosen.candidate.bundle) or not other.candidate.bundle
            is_better = _is_default(other, best) or (is_faster and is_as_simple) or proof["verdict"] == "worse"
            if other in fitting and is_open and is_better:
                chosen = other
        return chosen

    def _fit(self, candidate: Candidate) -> Answer:
        """Search the highest rate at the size and the largest size at the rate, each proven in fresh runs; None where there is none."""
        plan = replace(self.question.plan, name="fit", cells=candidate.cells)
        requested = max(self.question.plan.cells, key=lambda cell: cell.payload_bit_s or 0.0)
        axes = {"rate_hz": ("rate", requested.rate)}
        if requested.size:
            axes["size_bytes"] = ("size", float(requested.size))
        fits: Answer = {}
        with self._open(plan, "fit", self.folder / "fit") as trials:
            race = Race(trials, self.question.limits, self._until_s, self._say, self.clock, "fit")
            for number, (name, (axis, value)) in enumerate(axes.items(), 1):
                race.until_s = self.clock() + (self._until_s - self.clock()) * number / len(axes)
                is_cut_short, fits[name] = self._fitting(race, candidate, axis, value)
                self.cut_short |= {name} if is_cut_short else set()
        return fits

    def _fitting(self, race: Race, candidate: Candidate, axis: str, requested: float) -> tuple[bool, float | None]:
        """Return whether time ran out, and the highest value that keeps the limits in fresh runs, too."""
        until_s, seconds, highest = race.until_s, self.proof_seconds(race.measurer, [candidate]), 0.0
        is_cut_short = False

        def why_not(value: float, number: int, seconds: float = FIT_SECONDS, runs: int = 1) -> str:
            nonlocal highest, is_cut_short
            cells = [
                replace(cell, **{"rate": message.rate, axis: _scaled(getattr(message, axis), value / requested)})  # type: ignore[arg-type]  # two axes
                for cell, message in zip(candidate.cells, self.question.messages, strict=True)
            ]
            standing = Standing(replace(candidate, cells=tuple(cells)))
            for turn in range(runs):
                if not race.has_time(standing.candidate, seconds):
                    is_cut_short = True
                    raise _TimeUpError
                race.run(standing, seconds, number + turn)
                if standing.dropped:
                    return standing.dropped
            if not (reason := standing.excess(self.question.limits)[1]):
                highest = max(highest, value)
            return reason

        race.until_s -= FIT_FRESH * race.measurer.expected_s(candidate, seconds)
        with suppress(_TimeUpError):
            knee = Bisection(requested / FIT_SPAN, requested / max(1.0, self.load), FIT_RESOLUTION, 1, why_not).run()
            highest = 0.0 if knee.answer is RateAnswer.BELOW else knee.rate_hz
        race.until_s, value = until_s, highest
        with suppress(_TimeUpError):
            while value >= requested / FIT_SPAN:
                if not why_not(value, _FRESH, seconds, FIT_FRESH):
                    return is_cut_short, value
                value = round_rate(value / FIT_RESOLUTION)
        return is_cut_short, None

    def _result(self, chosen: Standing | None, fits: Answer | None) -> Answer:
        question, limits, host = self.question, self.question.limits, self.question.plan.relay.ssh
        is_unproven = fits is not None and not any(fits.values())
        messages = [
            {"data": cell.data, "size": cell.size, "rate_hz": cell.rate, **({"flow": cell.flow} if cell.flow else {})}
            for cell in question.messages
        ]
        return {
            "question": {"messages": messages, "limits": limits, "minutes": question.minutes, "host": host},
            "link": None if self.link is None else self.link.to_dict(),
            "load": self.load,
            "sentence": self._sentence(chosen, fits),
            "recommended": None if chosen is None or is_unproven else settings_of(chosen.candidate),
            "candidates": [{**row.event("look", limits).to_dict(), "dropped": row.dropped} for row in self.ranking],
            "proofs": self.proofs,
            "fits": fits,
            "seconds": round(self.clock() - self.began_s, 1),
            "folder": str(self.folder),
        }

    def _sentence(self, chosen: Standing | None, fits: Answer | None) -> str:
        limits = self.question.limits
        if chosen is None:
            failed = next(row for row in (*self.fresh, *self.ranking) if row.dropped)
            return (
                f"No answer: {failed.candidate.name} was not measured{' again' * bool(self.fresh)}: {failed.dropped}."
            )
        name = chosen.candidate.name
        more = self._missing_words(is_compared=fits is None)
        if fits is not None:
            rows = [row for row in (*self.ranking, *self.fresh) if row.looks]
            tried = {row.candidate.name for row in rows}
            breaking = {row.candidate.name for row in rows if row.excess(limits)[0]}
            nearest = f"{name} was nearest: {chosen.excess(limits)[1]}"
            reason = f"None of {counted(len(tried), 'setup')} fits ({nearest})"
            if tried - breaking:  # others were slower when nothing had broken a limit
                reason = f"None of the {counted(len(breaking), 'setup')} that looked best fits ({nearest})"
            reason += more
            if self.load > 1:
                reason = f"No setting makes this fit ({self._load_words()})"
            return f"{reason}; with {name} {fits_words(self.question, fits, self.cut_short, FIT_FRESH)}."
        event = chosen.event("proof", limits)
        late = "" if math.isinf(limits.deadline_ms) else f", {event.late} later than {limits.deadline_ms:g} ms"
        if late and event.late > limits.late_percent / 100 * event.messages:
            late += f" (more than the {limits.late_percent:g} % allowed, but not for sure)"
        sides = {side.candidate.name: side for side in (*self.ranking, *self.fresh)}
        compared = []
        for proof in self.proofs:
            if name in (proof["of"], proof["against"]):
                is_base, verdict = name == proof["against"], str(proof["verdict"])
                other = sides[proof["of"] if is_base else proof["against"]]
                words = _VERDICTS[_OPPOSITES.get(verdict, verdict) if is_base else verdict]
                if other.looks and (breaks := other.excess(limits)[1]):
                    words = f"{{}} breaks a limit, {breaks}"
                compared.append(words.format(other.candidate.name))
        return f"Use {event.text}{late}; {'; '.join(compared) or 'nothing to compare it with'}{more}."

    def _missing_words(self, *, is_compared: bool) -> str:
        """Return how many setups were not tried, could not run, or had no time to be compared."""
        proven = [row.candidate for row in self.fresh if row.looks]
        names: dict[str, list[str]] = {}
        for row in self.ranking:
            words = f"were {NO_TIME} (--minutes)" if row.dropped == NO_TIME else "could not run"
            if row.looks:
                words = "had no time for more runs" if is_compared and row.dropped.endswith(NO_MORE_TIME) else ""
            if words and row.candidate not in proven:
                names.setdefault(words, []).append(row.candidate.middleware)
        return "".join(
            f"; {counted(len(of), 'more setup')} {words} ({joined(sorted({*of}))})" for words, of in names.items()
        )


_OPPOSITES = {"better": "worse", "worse": "better"}
_VERDICTS = {
    "better": "proven better than {}",
    "worse": "proven worse than {}",
    "no difference": "no difference to {} is proven",
    "mixed": "in part better and in part worse than {}",
    "incomplete": "not compared with {}",
}


def _is_default(standing: Standing, of: Standing) -> bool:
    return not standing.candidate.bundle and standing.candidate.middleware == of.candidate.middleware


class _TimeUpError(Exception):
    """The time that was given is used."""


def _scaled(value: float | None, scale: float) -> float | None:
    if value is None:
        return None
    return max(1, int(value * scale)) if isinstance(value, int) else round_rate(value * scale)
