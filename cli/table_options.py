"""Options of a command that are rows of the table `recorder/option_table.py`, and why a configured default of one does not count."""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields
from enum import Enum
from typing import Annotated, Any, TypeVar

from dds_trace.base.errors import OptionError
from dds_trace.base.limits import shown
from dds_trace.recorder.choices import Discovery, Role
from dds_trace.recorder.option_table import OPTIONS, choices_of, help_of

from .program import option, starting

_Record = TypeVar("_Record")


def with_options(names: Iterable[str]) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return the decorator that gives a function with `**values` the options of these rows."""
    options = [_parameter(name) for name in names]

    def decorate(function: Callable[..., None]) -> Callable[..., None]:
        declared = inspect.signature(function, eval_str=True).parameters.values()
        parameters = [parameter for parameter in declared if parameter.kind is not inspect.Parameter.VAR_KEYWORD]
        function.__signature__ = inspect.Signature([*parameters, *options])  # type: ignore[attr-defined]
        return function

    return decorate


def _parameter(name: str) -> inspect.Parameter:
    row = OPTIONS[name]
    kind: Any = list[row.kind] if row.is_repeatable else row.kind  # type: ignore[name-defined]
    values = [] if issubclass(row.kind, Enum) else choices_of(row)
    info = option(f"{row.name} {row.metavar}", help_of(row), autocompletion=starting(values) if values else None)
    return inspect.Parameter(
        name,
        inspect.Parameter.KEYWORD_ONLY,
        default=None if row.metavar else False,
        annotation=Annotated[kind | None if row.metavar else bool, info],
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
        if role and row.roles and role not in row.roles:
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
