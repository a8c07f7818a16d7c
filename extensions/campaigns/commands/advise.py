"""`dds-trace advise`: middleware and settings for a load between two devices, with the proof."""

from __future__ import annotations

import json
import sys
import time
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dds_trace.base.errors import OptionError
from dds_trace.base.limits import SEARCH_MINUTES
from dds_trace.base.printable import MAX_FINDING_CHARACTERS, printable
from dds_trace.base.streams import SCREEN_WIDTH, command_lines, wrapped
from dds_trace.base.units import counted, first_of, joined
from dds_trace.cli.program import argument, command, make_app, option

from .common import INCOMPLETE_EXIT_CODE, AsJson, DryRun, Out, plan_of, read_thresholds, run_until_interrupted

if TYPE_CHECKING:
    from ..answer import Answer
    from ..halving import Event
    from ..question import Question

MOST_ROWS = 8
"""Candidates that are printed; `answer.json` has all."""

app = make_app()


@command(app, "advise", often=("size", "rate", "deadline", "hosts", "link", "minutes", "out", "dry_run"))
def advise_command(
    plan: Annotated[
        Path | None, argument("[PLAN]", "TOML file with the messages and the devices, in place of --size and --rate.")
    ] = None,
    size: Annotated[str | None, option("--size SIZE", "Size of a message: 33KB, 4MB.")] = None,
    rate: Annotated[str | None, option("--rate HZ", "Messages a second.")] = None,
    deadline: Annotated[
        str | None, option("--deadline TIME", "Time within which a reply must come, e.g. 50ms. Default: none")
    ] = None,
    in_time: Annotated[
        str, option("--in-time SHARE", "Share of the messages that must come in time.", show_default=True)
    ] = "99%",
    cpu: Annotated[
        float | None,
        option("--cpu PERCENT", "Maximum load of a node, in percent of one processor. Default: no limit", min=0.1),
    ] = None,
    data: Annotated[
        str, option("--data KIND", "Data of the messages: binary, string, imu.", show_default=True)
    ] = "binary",
    hosts: Annotated[
        list[str] | None,
        option(
            "--host HOST",
            "The other device: its name for ssh, or a TOML file with [devices.relay]. Default: this machine",
        ),
    ] = None,
    link: Annotated[
        str | None,
        option("--link LINK", "Emulate a link: a TOML file with [link], or a preset such as wifi-54. Needs root."),
    ] = None,
    minutes: Annotated[
        float,
        option(
            "--minutes N",
            "Time for search and proof.",
            min=SEARCH_MINUTES.low,
            max=SEARCH_MINUTES.high,
            show_default=True,
        ),
    ] = 10.0,
    out: Out = Path("runs"),
    dry_run: DryRun = False,
    as_json: AsJson = False,
) -> None:
    """Find the middleware and settings for a load between two devices.

    Tries all that can start, and proves the best in fresh runs. Where nothing fits, it searches the highest rate and the
    largest size that do. For example:

        dds-trace advise --size 502KB --rate 20 --deadline 50ms --host robot
    """
    began_s = time.monotonic()
    import_module("polars")  # before minutes of recording
    from dds_trace.base.records import to_json

    from ..answer import answer
    from ..question import Question, ask, flows_together, limits_of

    limits = limits_of(deadline, in_time, cpu)
    if plan is not None:
        if size or rate or link or hosts:
            raise OptionError("a plan has its own messages, link and devices; remove --size, --rate, --link and --host")
        requested = plan_of(plan, out)
        read_thresholds(requested, None, None, is_judged=False)
        combined = replace(flows_together(requested), name=f"{requested.name}-advice")
        question = Question(combined, limits, minutes)
    elif rate is None:
        raise OptionError("give the messages, for example --size 502KB --rate 20, or a PLAN")
    else:
        question = Question(ask(size, rate, data=data, link=link, hosts=hosts or ()), limits, minutes)
    if dry_run:
        raise typer.Exit(_dry_run(question, out, as_json=as_json))

    def run() -> int:
        result = answer(question, out, _say, began_s=began_s)
        print(
            json.dumps(to_json(result, not_finite=lambda _: None)) if as_json else "\n".join(map(_line, shown(result)))
        )
        fits = result["fits"]
        return 0 if result["recommended"] and (fits is None or any(fits.values())) else INCOMPLETE_EXIT_CODE

    run_until_interrupted(run, out)


def _dry_run(question: Question, out: Path, *, as_json: bool) -> int:
    from ..answer import promise
    from ..plan.schedule import Remaining
    from ..rehearsal import check_plan
    from .against import say_missing, startable
    from .dry_run import argument_check

    plan = question.plan
    refused = check_plan(plan, out / plan.name, argument_check())
    recordings, seconds = promise(replace(question, plan=startable(plan, refused)))
    described = {
        "plan": plan.name,
        "runs": recordings,
        "seconds": seconds,
        "most_seconds": 60 * question.minutes,
        "cells": [{"name": cell.name} for cell in plan.cells],
        "cannot_start": refused,
    }
    link = [f"link: {plan.link}"] if plan.link else []
    if plan.link and plan.link.load(question.load_mbit_s) > 1:
        link.append(f"no setting makes this fit: {plan.link.load_words(question.load_mbit_s)}")
    times = f"about {Remaining(seconds)} of at most {question.minutes:g} min"
    lines = [
        *(cell.name for cell in plan.cells),
        *link,
        f"{plan.name}: about {counted(recordings, 'recording')}, {times}",
    ]
    print(json.dumps(described) if as_json else wrapped("\n".join(lines), sys.stdout))
    say_missing(refused, what=" cannot start")
    return INCOMPLETE_EXIT_CODE if refused else 0


def _say(event: Event) -> None:
    from ..halving import NO_TIME

    if event.state != "running" and event.stage != "answer" and not event.text.endswith(NO_TIME):
        text = f"{event.left_s / 60:4.1f} min left, {event.stage}: {event.text}"
        words = printable(text, MAX_FINDING_CHARACTERS)
        print(wrapped(words, in_pipe=SCREEN_WIDTH), file=sys.stderr, flush=True)


def _line(text: str) -> str:
    is_for_a_shell = text.startswith(("  export ", "  #", "    dds-trace "))
    return text if is_for_a_shell else wrapped(text, sys.stdout, in_pipe=SCREEN_WIDTH)


def shown(answer: Answer) -> list[str]:
    recommended, fits = answer["recommended"] or {}, answer["fits"]
    lines = [answer["sentence"], *(["Settings for what fits:"] if recommended and fits else [])]
    lines += [f"  {line}" for line in recommended.get("exports", [])]
    if recommended and not fits and any(proof["received"] for proof in answer["proofs"]):
        rows = [row for proof in answer["proofs"] for row in proof["proof"] if row["new_ns"] is not None]
        judged = joined([*dict.fromkeys(row["statistic"] for row in rows), "messages received"])
        lines.append(f"By {judged} in fresh runs; `choose` ranks older recordings by a deadline.")
    lines += [line for proof in answer["proofs"] for line in shown_proof(proof)]
    lines.append("Candidates, response in the first looks:")
    rows = [row["text"] + (f" ({row['dropped']})" if row["dropped"] else "") for row in answer["candidates"]]
    lines += [f"  {line}" for line in first_of(rows, MOST_ROWS)]
    last = f"Wrote {answer['folder']}/answer.json"
    return [*lines, last if recommended or fits else f"The same command continues in {answer['folder']}"]


def shown_proof(proof: Answer) -> list[str]:
    from ..proof import proof_lines

    words = "" if proof["verdict"] == "better" else f" ({proof['reason']})"
    lines = proof_lines(proof["proof"], proof["received"])
    command = [command_lines(proof["command"])] if "command" in proof else []
    return [
        f"{proof['of']} against {proof['against']}: {proof['verdict']}{words}",
        *(f"  {line}" for line in lines),
        *command,
    ]
