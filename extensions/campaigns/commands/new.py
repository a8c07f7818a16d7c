"""`dds-trace sweep new PLAN.toml`: a commented plan from three questions."""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, TypeVar

import typer

from dds_trace.base import limits
from dds_trace.base.errors import OptionError, OutputError, OutputExistsError
from dds_trace.cli.program import argument, command, make_app, option

_T = TypeVar("_T")

app = make_app()


@command(app, "new")
def new_command(
    plan: Annotated[Path, argument("PLAN.toml", "File to write; it must not exist.")],
    send: Annotated[
        str | None,
        option(
            "--send DATA", "Messages to send, each with its rate: 'binary 33KB @ 20, imu @ 100, file:photo.jpg @ 5'."
        ),
    ] = None,
    compare: Annotated[
        str | None,
        option(
            "--compare WORDS",
            "What to compare: middleware, bridge, reliability, tuning, serialization (comma-separated), or nothing.",
        ),
    ] = None,
    relay: Annotated[
        str | None,
        option("--relay WHERE", "Where the relay runs: here, USER@HOST, or here over an emulated link, e.g. wifi-54."),
    ] = None,
) -> None:
    """Write a commented plan for `dds-trace sweep`, and the schema with which editors complete it.

    Asks three questions on a terminal: what is sent, what is compared, where the relay is. Each option answers one.
    """
    from ..plan import template
    from ..plan.link import PRESETS
    from ..plan.plan_file import parse_plan
    from ..plan.schema import SCHEMA_FILE_NAME, schema_text

    limits.check(limits.PATH, str(plan), "PLAN.toml")
    if plan.suffix != ".toml":
        raise OptionError(f"{plan}: a plan is a .toml file; write {plan.with_suffix('.toml')}")
    limits.check(limits.FILE_NAME, plan.stem, "PLAN.toml")
    if plan.exists():  # before anything is asked
        raise _exists(plan)
    messages = _answer(
        send, "--send", "What is sent, and how often a second?", template.DATA_EXAMPLE, template.parse_messages
    )
    words = f"Of {', '.join(template.COMPARISONS)}; or nothing"
    comparisons = _answer(compare, "--compare", f"What is compared? {words}", "middleware", template.parse_comparisons)
    locations = f"{template.HERE}, USER@HOST, or over a link emulated here: {', '.join(PRESETS)}"
    location = _answer(relay, "--relay", f"Where is the relay? {locations}", template.HERE, template.check_location)
    text = template.plan_text(plan.stem, messages, comparisons, location)
    parse_plan(text, plan.stem, "these answers", lambda: [("ros2", None)])
    try:
        with plan.open("x", encoding="utf-8") as file:
            file.write(text)
        print(f"Wrote {plan}")
        schema = plan.with_name(SCHEMA_FILE_NAME)
        if not schema.exists():
            schema.write_text(schema_text(), encoding="utf-8")
            print(f"Wrote {schema}, with which editors complete plans")
    except FileExistsError as err:
        raise _exists(plan) from err
    except OSError as err:
        raise OutputError(f"{plan} cannot be written ({err.strerror}); give another folder") from err


def _exists(plan: Path) -> OutputExistsError:
    return OutputExistsError(f"{plan} is there already; choose another name")


def _answer(given: str | None, option: str, question: str, example: str, parse: Callable[[str], _T]) -> _T:
    if given is not None:
        try:
            return parse(given)
        except OptionError as err:
            raise OptionError(f"{option} {err}") from err
    if not sys.stdin.isatty():
        raise OptionError(f"there is no terminal to ask on: give {option}, for example {option} '{example}'")

    def typed(text: str) -> _T:
        try:
            return parse(text)
        except OptionError as err:
            raise typer.BadParameter(str(err)) from err

    shown = textwrap.fill(question, 78 - len(example), break_on_hyphens=False)  # the example follows it
    answer: _T = typer.prompt(shown, default=example, value_proc=typed)
    return answer
