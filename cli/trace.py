"""`dds-trace`: the four programs as commands of one."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from functools import partial
from importlib import import_module
from typing import Annotated, Any

from dds_trace.recorder.choices import Role
from dds_trace.recorder.option_table import OPTIONS

from .program import refuse_misspelt, run_command, take_completed_command
from .quick_help import Version, argument, command_app, declare_command, starting

PROGRAM = "dds-trace"

_COMMANDS = {
    "record ping": "Send messages on a schedule, and record their replies.",
    "record relay": "Send messages back, and record them.",
    "record tap": "Record how late, how old and how complete topics of others arrive.",
    "record beacon": "Compare the clocks of the devices that run one.",
    "record status": "List the recordings that run on this machine.",
    "sweep": "Record all runs of a plan; `sweep new` writes a plan.",
    "bridge": "Run a bridge between two domains, or list the installed ones.",
    "analyze": "Make tables and reports of a folder of traces.",
    "bag": "Say whether a recording of other tools is whole, topic by topic.",
    "compare": "Compare two folders of traces; fail in CI where one is slower.",
    "watch": "Show a page that follows a running sweep.",
}
_MODULES = {
    "record": ".record.command",
    "sweep": ".sweep.command",
    "bridge": ".bridge",
    "analyze": ".analyze",
    "bag": ".analyze",
}
_OF_ANALYZE = ("compare", "watch")
_RECORDINGS = ("ping", "relay", "tap", "beacon", "status")

app = command_app(completes=True)
_record_app = command_app(completes=True)
"""Completes the word after `record`."""


@declare_command(app, commands=_COMMANDS)
def main_command(
    command: Annotated[
        str,
        argument(
            "COMMAND",
            "A command with its options; each has a --help.",
            autocompletion=starting((*_MODULES, *_OF_ANALYZE)),
        ),
    ],
    version: Version = False,
) -> None:
    """Record and analyze the latency of ROS 2 / DDS messages.

    On two devices, or in two terminals, then the answer:

        dds-trace record relay --out runs/relay.mcap

        dds-trace record ping --out runs/ping.mcap

        dds-trace analyze runs/

    dds-record, dds-sweep, dds-bridge and dds-analyze are the same programs.
    """


@declare_command(_record_app)
def _record_command(role: Annotated[str, argument("ROLE", "", autocompletion=starting(_RECORDINGS))]) -> None:
    """Do nothing: only its completion is used."""


def main(arguments: Sequence[str] | None = None) -> None:
    words = list(sys.argv[1:] if arguments is None else arguments)
    completed = take_completed_command(PROGRAM, app, (*_MODULES, *_OF_ANALYZE))
    word = completed or (words[0] if words else "--help")
    if completed in _OF_ANALYZE:
        _complete("analyze", completed)
    elif word in _OF_ANALYZE:
        _main_of("analyze")(words, name=PROGRAM, adapt=_adapt)
    elif word not in _MODULES:

        def show_help() -> None:
            refuse_misspelt(PROGRAM, (*_MODULES, *_OF_ANALYZE), words or [word], takes_paths=False)
            app(words or [word], prog_name=PROGRAM)

        run_command(show_help)
    elif word == "record":
        _record(words[1:], is_completed=completed is not None)
    else:
        is_bag = word == "bag" and not completed
        given = ["--topics", *words[1:]] if is_bag else words[1:]
        _main_of(word)(
            given, name=PROGRAM if completed else f"{PROGRAM} {word}", adapt=_adapt_bag if is_bag else _adapt
        )


def _record(given: list[str], *, is_completed: bool) -> None:
    completed = take_completed_command(PROGRAM, app, _RECORDINGS)
    role = completed or next((word for word in given[:1] if word in _RECORDINGS), None)
    if completed == "status":
        _complete("record", completed)
    if role not in (None, "status"):
        name, words, adapt = f"{PROGRAM} record {role}", ["--role", role, *given[1:]], partial(_adapt, role=Role(role))
    else:
        name, words, adapt = f"{PROGRAM} record", given, partial(_adapt)
    if is_completed and role is None:
        run_command(partial(_record_app, [], prog_name=PROGRAM))
    else:
        _main_of("record")([] if is_completed else words, name=PROGRAM if is_completed else name, adapt=adapt)


def _complete(word: str, command: str) -> None:
    run_command(partial(import_module(_MODULES[word], __package__).COMMANDS[command], [], prog_name=PROGRAM))


def _main_of(word: str) -> Any:
    return import_module(_MODULES[word], __package__).main


_NAMES = (
    (r"dds-record --role (ping|relay|tap|beacon) *", rf"{PROGRAM} record \1 "),
    (r"dds-analyze (compare|watch)", rf"{PROGRAM} \1"),
    (r"dds-(record|sweep|bridge|analyze)\b", rf"{PROGRAM} \1"),
)


def _adapt(command: Any, role: Role | None = None) -> None:
    command.help = _renamed(command.help)
    command.params = [
        parameter for parameter in command.params if parameter.name not in ("install_completion", "show_completion")
    ]
    for parameter in command.params:
        parameter.help = _renamed(parameter.help or "")
        row = OPTIONS.get(parameter.name)
        if role is not None and row is not None:
            parameter.hidden = parameter.name == "role" or (bool(row.roles) and role not in row.roles)
        if "--config" in getattr(parameter, "opts", ()):  # --print-config shows the values in force, as everywhere
            parameter.opts = ["--config"]


def _adapt_bag(command: Any) -> None:
    from .analyze import NOT_OF_TOPICS

    _adapt(command)
    command.help = (
        "Say whether a recording of other tools is whole: what is missing of each topic, when, its rate, jitter and age. Exit code 30 "
        "with holes, 31 if it is damaged.\n\n    dds-trace bag drive/ --report html --fail-if 'missing(/camera) > 1%'"
    )
    for parameter in command.params:
        parameter.hidden = parameter.name == "topics" or parameter.name in NOT_OF_TOPICS


def _renamed(text: str) -> str:
    for name, new in _NAMES:
        text = re.sub(name, new, text)
    return text


if __name__ == "__main__":
    main()
