"""Options of a command that are rows of the table `recorder/option_table.py`, and why a configured default of one does not count."""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields
from enum import Enum
from typing import Annotated, Any, TypeVar

import typer

from dds_trace.base.errors import OptionError
from dds_trace.base.limits import shown
from dds_trace.recorder.choices import Discovery, Role
from dds_trace.recorder.option import Panel
from dds_trace.recorder.option_table import OPTIONS, choices_of, help_of

from .quick_help import starting

_Record = TypeVar("_Record")

_COMMON = (
    *("--role", "--out", "--data", "--size", "--rate", "--messages", "--duration", "--backend", "--rmw", "--bridge"),
    *("--domain", "--peer", "--discovery", "--device", "--force", "--json"),
)
"""Options that come first in a help with panels, in this order."""


def with_options(names: Iterable[str], *, in_panels: bool) -> Callable[[Callable[..., None]], Callable[..., None]]:
    order = list(Panel)

    def rank(name: str) -> tuple[int, int]:
        row = OPTIONS[name]
        is_first = in_panels and row.name in _COMMON
        return (_COMMON.index(row.name) if is_first else len(_COMMON)), order.index(row.panel)

    options = [_parameter(name, in_panels) for name in sorted(names, key=rank)]

    def decorate(function: Callable[..., None]) -> Callable[..., None]:
        own_parameters = list(inspect.signature(function, eval_str=True).parameters.values())[:-1]
        version = own_parameters[-1].replace(kind=inspect.Parameter.KEYWORD_ONLY)
        parameters = [*own_parameters[:-1], *options, version]
        function.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        function.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
        return function

    return decorate


def _parameter(name: str, in_panels: bool) -> inspect.Parameter:
    row = OPTIONS[name]
    kind: Any = list[row.kind] if row.is_repeatable else row.kind  # type: ignore[name-defined]
    panel = "Common options" if row.name in _COMMON else row.panel.value
    values = [] if issubclass(row.kind, Enum) else choices_of(row)
    option = typer.Option(
        row.name,
        metavar=row.metavar,
        help=help_of(row),
        rich_help_panel=panel if in_panels else None,
        show_default=False,
        autocompletion=starting(values) if values else None,
    )
    return inspect.Parameter(
        name,
        inspect.Parameter.KEYWORD_ONLY,
        default=None if row.metavar else False,
        annotation=Annotated[kind | None if row.metavar else bool, option],
    )


def given_values(values: Mapping[str, Any]) -> dict[str, Any]:
    return {
        name: value
        for name, value in values.items()
        if value is not None and value is not False and value != []  # 0 is given, and equal to False
    }


def read_record(record: type[_Record], chosen: Mapping[str, Any], **more: object) -> _Record:
    names = [column.name for column in fields(record) if column.name in chosen]  # type: ignore[arg-type]
    return record(**{name: OPTIONS[name].read(chosen[name]) for name in names}, **more)


DEFAULT_DOMAIN = 10


def overridden(values: Mapping[str, Any]) -> dict[str, str]:
    role = None if values.get("role") is None else Role(values["role"])
    is_bridged = role in (None, Role.PING) and values.get("bridge") not in (None, "none")
    reasons = {}
    for name, row in OPTIONS.items():
        variable = next((variable for variable in row.variables if os.environ.get(variable)), None)
        if name == "duration_s" and values.get("for_s") is not None:
            reasons[name] = "option: --for"
        elif role and row.roles and role not in row.roles:
            reasons[name] = f"default: not of a {role.value}"
        # The domain of a ping with a bridge is never from the environment.
        elif variable is not None and not (name == "domain_id" and is_bridged):
            reasons[name] = f"environment: {variable}={os.environ[variable]}"
    return reasons


def default_domain() -> int:
    text = os.environ.get("ROS_DOMAIN_ID", "").strip()
    if not text:
        return DEFAULT_DOMAIN
    if not text.isdecimal() or len(text) > 9:
        raise OptionError(f"ROS_DOMAIN_ID is {shown(text)}, not a domain id; set a number or unset it")
    return int(text)


def default_discovery(*, is_open: bool = True) -> Discovery:
    is_local = (
        os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper() == "LOCALHOST"
        or os.environ.get("ROS_LOCALHOST_ONLY") == "1"
    )
    is_asked = is_open or os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper() == "SUBNET"
    return Discovery.LOCALHOST if is_local or not is_asked else Discovery.SUBNET
