"""`dds-trace`: all commands; of a line, only the modules of its command are loaded."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from functools import partial
from importlib import import_module

import typer

from dds_trace.base.errors import OptionError
from dds_trace.base.extension import offers
from dds_trace.base.shortage import ANALYSIS, RECORDING
from dds_trace.base.streams import say
from dds_trace.base.threads import one_blas_thread, tune_gc

from .program import SETTINGS, ShortHelp, Version, make_app, run_command
from .vector_sorts import avoid_slow_sorts

PROGRAM = "dds-trace"

_COMMANDS = {
    "record ping": "record.command:ping",
    "record relay": "record.command:relay",
    "record tap": "record.command:tap",
    "record beacon": "record.command:beacon",
    "analyze": "analyze:app",
    "doctor": "doctor:app",
}

_ORDER = ("record", "sweep", "capacity", "explain", "advise", "analyze", "choose", "compare", "watch", "bag", "recover")
"""First words of commands as `--help` lists them; others follow."""

_WITHOUT_FRAMES = ("record", "recover", "bridge")
_WITHOUT_PROGRAMS = ("analyze", "bag", "choose", "compare")
_HELP = {"-h", "--help", "--version"}
_GROUPS = {
    "record": "Record a ping, a relay, topics or clocks; list recordings.",
    "explain": "Explain why latency rises at slow rates, or around a size.",
    "sweep": "Write a plan.",
}

MOVED = {
    "record --recover": "recover FILE",
    "record --self-test": "doctor",
    "record --for": "record ROLE --duration SECONDS",
    "sweep --explain-rates": "explain rates PLAN",
    "sweep --explain-size": "explain size SIZE PLAN",
    "sweep --advise": "advise PLAN",
    "sweep --max-rate": "capacity PLAN",
    "analyze --recommend": "choose RUNS --size 502KB --rate 20 --deadline 50ms",
    "analyze --topics": "bag DRIVE",
    "bridge --list": "doctor",
    "bridge --print-config": "bridge NAME --config",
}


FOLLOWED = ("record --recover", "record --self-test", "analyze --topics")
"""Flags in `MOVED` that keep their other words in the new command."""


def follow_moved(words: Sequence[str]) -> list[str]:
    """Return the words as they are written now; raise an `OptionError` that names the command where more of them changed."""
    for index, word in enumerate(words[1:], 1):
        option, _, value = word.partition("=")
        moved = f"{words[0]} {option}"
        if moved not in MOVED:
            continue
        now = f"{option} went; use `{PROGRAM} {MOVED[moved]}`"
        if moved not in FOLLOWED:
            raise OptionError(now)
        say(now)
        return [MOVED[moved].split()[0], *words[1:index], *[value] * bool(value), *words[index + 1 :]]
    return list(words)


def run_alias(name: str, app: typer.Typer, words: Sequence[str]) -> None:
    """Run the app of `dds-record` or `dds-analyze`, or `dds-trace` where a word moved to another command."""
    now = follow_moved(words)
    if now[0] == words[0]:
        app(now[1:], prog_name=name)
    build(now)(now, prog_name=PROGRAM)


def _show_help(is_short: ShortHelp = False, version: Version = False) -> None:
    """Record and analyze the latency of ROS 2 / DDS messages.

    On two devices, or in two terminals, then the answer:

        dds-trace record relay --out runs/relay.mcap

        dds-trace record ping --out runs/ping.mcap

        dds-trace analyze runs/
    """


def commands() -> dict[str, Callable[[], typer.Typer]]:
    local: dict[str, Callable[[], typer.Typer]] = {name: partial(_load_app, home) for name, home in _COMMANDS.items()}
    rank = {word: number for number, word in enumerate(_ORDER)}
    apps = {**local, **offers("commands")}
    return {name: apps[name] for name in sorted(apps, key=lambda name: rank.get(name.partition(" ")[0], len(rank)))}


def _load_app(home: str) -> typer.Typer:
    module, _, name = home.partition(":")
    app: typer.Typer = getattr(import_module(f".{module}", __package__), name)
    return app


def build(words: Sequence[str]) -> typer.Typer:
    apps = commands()
    chosen = [name for name in (" ".join(words[:2]), *words[:1]) if name in apps][:1]
    chosen = chosen or [name for name in apps if words and name.startswith(f"{words[0]} ")]
    root = make_app(completes=True)
    root.callback(context_settings=SETTINGS)(_show_help)
    groups: dict[str, typer.Typer] = {}
    for name in chosen or [name for name in apps if name != "sweep new"]:
        group = name.rpartition(" ")[0]
        if group and group not in groups:
            groups[group] = make_app()
            settings = {"help_option_names": ["-h", "--help"]}
            root.add_typer(
                groups[group], name=group, help=_GROUPS[group], no_args_is_help=True, context_settings=settings
            )
        (groups[group] if group else root).add_typer(apps[name]())
    return root


def _words_to_complete() -> list[str]:
    """Return the words of a line that the shell completes, from the variables of typer's scripts."""
    if f"_{PROGRAM}_COMPLETE".replace("-", "_").upper() not in os.environ:
        return []
    return os.environ.get("COMP_WORDS", os.environ.get("_TYPER_COMPLETE_ARGS", "")).split()[1:]


def main(arguments: Sequence[str] | None = None) -> None:
    words = list(sys.argv[1:] if arguments is None else arguments)
    is_recording = words[:1] == ["record"]
    if not is_recording:
        tune_gc()
        avoid_slow_sorts()

    def run() -> None:
        now = follow_moved(words)
        typed = import_module(".record.command", __package__).words_of_role(now) if now[:1] == ["record"] else now
        with one_blas_thread() if now[:1] and now[0] in _WITHOUT_PROGRAMS else nullcontext():
            build(_words_to_complete() or now)(typed or ["--help"], prog_name=PROGRAM)

    room = RECORDING if words[:1] and words[0] in _WITHOUT_FRAMES else ANALYSIS
    run_command(run, needs_stdout=not is_recording, room=None if {*words} <= _HELP else room)
