"""`dds-trace sweep --against`: two sides in alternation, and for equal ones how often the comparison is wrong."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Container, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from dds_trace.base import limits
from dds_trace.base.errors import OptionError
from dds_trace.base.files import expand_home, open_regular
from dds_trace.base.streams import say, wrapped
from dds_trace.base.units import counted, first_of
from dds_trace.recorder.backends import installed_middlewares

from ..against import BASE, NEW, AgainstOutcome, against_seconds, interleave, run_against
from ..folder import replace_text
from ..plan.cells import Cell, environment_name
from ..plan.plan import Plan
from ..plan.plan_file import read_plan
from ..run.progress import make_progress
from ..station.programs import environment_program
from ..sweep import SweepOutcome
from .common import INCOMPLETE_EXIT_CODE

if TYPE_CHECKING:
    from dds_trace.extensions.gates.gate import Gate
    from dds_trace.extensions.gates.report import JudgedSides

    from ..verdicts.false_alarms import FalseAlarms

SAME = "SAME"


@dataclass(frozen=True, slots=True)
class NewSide:
    name: str
    plan: Plan
    command: tuple[str, ...] | None = None
    environment: Path | None = None
    is_same: bool = False
    looks: int = 1


def new_side(text: str, base_path: Path, base: Plan) -> NewSide:
    limits.check(limits.FOLDER, text, "--against")
    path = expand_home(text)
    if text == SAME or (path.is_file() and path.samefile(base_path)):
        return NewSide("same", base, is_same=True)
    if path.suffix == ".toml":
        plan = read_plan(path, installed_middlewares)
        return NewSide(plan.name, plan)
    if not path.is_dir():
        raise OptionError(f"--against {text}: give another plan.toml, the folder of a Python environment, or {SAME}")
    command = environment_program(path.absolute(), "dds-record")
    if base.has_two_devices:
        raise OptionError(
            "--against ENVIRONMENT is for sweeps on one machine; with another device write a plan whose "
            "[devices.relay] path is the environment there"
        )
    return NewSide(environment_name(text), base, command, path.absolute())


def keep_to_environment(folder: Path, side: NewSide) -> None:
    """Refuse the folder of a new side that was recorded with another environment, or before a module of it changed."""
    mark, identity, recorded = folder / ".environment", "", ""
    if side.environment is not None:
        modules = (path for path in side.environment.rglob("*") if path.suffix in (".py", ".so"))
        identity = f"{side.environment} {max((path.lstat().st_mtime_ns for path in modules), default=0)}\n"
    with suppress(OSError), open_regular(mark) as file:
        recorded = file.read(1 << 16).decode(errors="replace")
    if (folder / "state.json").exists() and recorded != identity:
        raise OptionError(f"{folder}: recorded with another environment, or before it changed; give another --out")
    if identity != recorded:
        folder.mkdir(parents=True, exist_ok=True)
        replace_text(mark, identity)


def startable(plan: Plan, refused: Container[str]) -> Plan:
    return replace(plan, cells=tuple(cell for cell in plan.cells if cell.name not in refused)) if refused else plan


def startable_words(cells: Iterable[Cell], refused: Container[str]) -> str:
    return f" for the {sum(cell.name not in refused for cell in cells)} that can start here" if refused else ""


def shown_sides(base: Plan, other: NewSide, refused: Container[str] = ()) -> tuple[dict[str, object], list[str]]:
    cells = [(turn.side, turn.group.cells[0]) for turn in interleave(base, other.plan)]
    turns = [(side, cell.name) for side, cell in cells]
    base_here, new_here = startable(base, refused), startable(other.plan, refused)
    seconds = against_seconds(base_here, new_here)
    repeats = base.run.repeats + (base.run.repeats - 1) // 2
    most = against_seconds(replace(base_here, run=replace(base.run, repeats=repeats)), new_here)
    described: dict[str, object] = {
        "plan": _name(base, other),
        "seconds": seconds.seconds,
        "most_seconds": other.looks * most.seconds,
        "cells": [{"side": side, "name": name} for side, name in turns],
    }
    lines = [f"{side:4}  {name}" for side, name in turns]
    up_to = f"up to {other.looks} looks, each: " if other.looks > 1 else ""
    more = f" ({most} where the machine is busier on one side)" if repeats > base.run.repeats else ""
    lines.append(
        f"{up_to}plan {_name(base, other)}: {counted(len(turns), 'recording')} of both sides, about {seconds}{more}"
        + startable_words((cell for _, cell in cells), refused)
    )
    return described, lines


def side_folders(base: Plan, other: NewSide, out: Path) -> list[tuple[Plan, Path, tuple[str, ...] | None]]:
    folder = out / _name(base, other)
    sides = [(BASE, base, None), *([] if other.is_same else [(NEW, other.plan, other.command)])]
    return [(plan, folder / side, command) for side, plan, command in sides]


def _can_analyze() -> bool:
    return find_spec("polars") is not None


def busier(base: Path, new: Path) -> list[tuple[str, int]]:
    if not _can_analyze():
        return []
    from dds_trace.analyzer.pipeline import analyze
    from dds_trace.extensions.gates.sides import busier_repeats, run_loads

    sides = [analyze(folder, details=False) for folder in (base, new)]
    return [one[:2] for one in busier_repeats(sides[0].runs, sides[1].runs, run_loads(sides))]


def run_sides(
    base: Plan, other: NewSide, out: Path, gates: Sequence[Gate] = (), *, as_json: bool, strict: bool = False
) -> int:
    if gates:
        say(shown_sides(base, other)[1][-1])
    keep_to_environment(out / _name(base, other) / NEW, other)
    for look in range(1, other.looks + 1):
        run = replace(base.run, repeats=look * base.run.repeats)
        sides_outcome = run_against(
            replace(base, name=f"{_name(base, other)}-base", run=run),
            replace(other.plan, name=f"{_name(base, other)}-new"),
            out / _name(base, other),
            make_progress(),
            commands=(None, other.command),
            busier=busier,
        )
        sides = {"base": sides_outcome.base, "new": sides_outcome.new}
        is_recorded = all(len(outcome.missing) < outcome.cells for outcome in sides.values())
        judged = None
        if gates and is_recorded:
            from dds_trace.extensions.gates.report import judge_sides

            judged = judge_sides(sides_outcome.base.folder, sides_outcome.new.folder, gates, looks=other.looks)
            if other.looks > 1:
                outcome = "" if judged.outcome.value == "inconclusive" else f"{judged.outcome.value}. "
                say(f"look {look} of {other.looks}: {outcome}{judged.info.answer[0]}")
        if judged is None or judged.outcome.value != "inconclusive":
            break
    missing = {side: outcome.missing for side, outcome in sides.items()}
    is_counted = other.is_same and is_recorded
    alarms = _false_alarms(sides_outcome) if is_counted and _can_analyze() else None
    if as_json:
        result: dict[str, object] = {side: str(outcome.folder) for side, outcome in sides.items()}
        result |= {"cells": sides_outcome.base.cells + sides_outcome.new.cells, "missing": missing}
        result |= {} if alarms is None else {"false_alarms": asdict(alarms)}
        result |= {} if judged is None else {"outcome": judged.outcome.value}
        print(json.dumps(result))
    else:
        _print_sides(sides_outcome, alarms, judged)
    for side, reasons in missing.items():
        say_missing(reasons, f"{side} ")
    if is_counted and alarms is None:
        say(
            "its verdicts are counted where the extra analyze is installed: copy the folder there, and give the same command"
        )
    if judged is not None:
        return judged.end(strict=strict)
    return INCOMPLETE_EXIT_CODE if any(missing.values()) else 0


def _print_sides(sides: AgainstOutcome, alarms: FalseAlarms | None, judged: JudgedSides | None) -> None:
    for side, outcome in (("base", sides.base), ("new", sides.new)):
        print_complete(outcome, f"{side}: ")
    folders = [shlex.quote(str(side.folder)) for side in (sides.base, sides.new)]
    print("Compare: dds-trace compare", *folders, "--paired", sep=" \\\n  " if sys.stdout.isatty() else " ")
    if alarms is not None:
        print(wrapped(_in_words(alarms), sys.stdout))
    if judged is not None:
        judged.write()


def print_complete(outcome: SweepOutcome, side: str = "") -> None:
    print(f"Wrote {outcome.folder}")
    complete = outcome.cells - len(outcome.missing)
    print(f"{side}{complete} of {counted(outcome.cells, 'recording is', 'recordings are')} complete")


def say_missing(missing: Mapping[str, str], side: str = "", what: str = "") -> None:
    for reason in dict.fromkeys(missing.values()):
        names = [name for name, cause in missing.items() if cause == reason]
        say(f"{side}{' '.join(first_of(names, 1))}{what}: {reason}")


def _name(base: Plan, other: NewSide) -> str:
    return f"{base.name}-against-{other.name}"


def _false_alarms(sides_outcome: AgainstOutcome) -> FalseAlarms:
    from dds_trace.analyzer.model.runs import pass_numbers
    from dds_trace.analyzer.pipeline import analyze

    from ..verdicts.false_alarms import count_false_alarms

    base, new = (analyze(outcome.folder, details=False) for outcome in (sides_outcome.base, sides_outcome.new))
    return count_false_alarms(base.load_messages(), new.load_messages(), pass_numbers([*base.runs, *new.runs]))


def _in_words(alarms: FalseAlarms) -> str:
    return (
        f"A/A: {alarms.measured} of {counted(alarms.of_measured, 'verdict')} better or worse; with the repeats dealt to "
        f"the two sides in {counted(alarms.deals, 'way')}: {alarms.dealt} of {alarms.of_dealt} "
        f"({alarms.rate:.1%}), all false"
    )
