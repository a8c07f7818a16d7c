"""Options of a command that are rows of `recorder/option_table.py`."""

from __future__ import annotations

import inspect
import os
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import fields
from enum import Enum
from typing import Annotated, Any, TypeVar

from dds_trace.base.errors import OptionError
from dds_trace.base.limits import nearest, shown
from dds_trace.recorder.backends import load_backend
from dds_trace.recorder.choices import Discovery, Role
from dds_trace.recorder.option import Option
from dds_trace.recorder.option_table import OPTIONS, choices_of, flag_of, help_of, is_setting, key_of

from .program import option, starting

_Record = TypeVar("_Record")


def with_options(
    names: Iterable[str], hidden: Callable[[Option], bool] = lambda _: False
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return the decorator that gives a function with `**values` the options of these rows."""
    options = [_parameter(name, hidden=hidden(OPTIONS[name])) for name in names]

    def decorate(function: Callable[..., None]) -> Callable[..., None]:
        declared = inspect.signature(function, eval_str=True).parameters.values()
        parameters = [parameter for parameter in declared if parameter.kind is not inspect.Parameter.VAR_KEYWORD]
        function.__signature__ = inspect.Signature([*parameters, *options])  # type: ignore[attr-defined]
        return function

    return decorate


def _parameter(name: str, *, hidden: bool) -> inspect.Parameter:
    row = OPTIONS[name]
    kind: Any = list[row.kind] if row.is_repeatable else row.kind  # type: ignore[name-defined]
    values = [] if issubclass(row.kind, Enum) else choices_of(row)
    info = option(
        f"{row.name} {row.metavar}", help_of(row), autocompletion=starting(values) if values else None, hidden=hidden
    )
    return inspect.Parameter(
        name,
        inspect.Parameter.KEYWORD_ONLY,
        default=None if row.metavar else False,
        annotation=Annotated[kind | None if row.metavar else bool, info],
    )


SettingsOption = Annotated[
    list[str] | None,
    option(
        "-o KEY=VALUE",
        "`-o help` lists rarer settings; repeatable.",
        is_eager=True,
        autocompletion=starting([f"{key_of(row)}=" for row in OPTIONS.values()]),
    ),
]


def settings_as_options(words: Sequence[str], role: Role | None = None) -> list[str]:
    """Return the words with each `-o KEY=VALUE` as the option of that key; with `-o help` print the keys and exit."""
    if "-o" not in words:
        return list(words)
    rows = {key_of(row): row for row in OPTIONS.values() if role is None or role in (row.roles or Role)}
    options: list[str] = []
    remaining = iter(words)
    for word in remaining:
        if word != "-o":
            options.append(word)
            continue
        key, equals, value = next(remaining, "help").partition("=")
        key = key.replace("-", "_")
        if key == "help":
            print("\n".join(_listed(rows, words, role)))
            sys.exit()
        if key not in rows:
            refuse_other_role(role, {f"-o {key}": row for row in OPTIONS.values() if key_of(row) == key})
            raise OptionError(f"-o {key}: no such setting; {nearest(key, rows)}")
        row = rows[key]
        if not equals:
            raise OptionError(f"-o {key}: write {key}={row.metavar or flag_of(row)}")
        if fault := _fault(row, value):
            raise OptionError(f"-o {key} {shown(value)}: {fault}")
        if row.metavar:
            options += [row.name, value]
        elif value == flag_of(row):
            options.append(row.name)
    return options


def refuse_other_role(role: Role | None, rows: Mapping[str, Option]) -> None:
    foreign = {name: row for name, row in rows.items() if role not in (row.roles or Role)}
    if role is not None and foreign:
        others = dict.fromkeys(other.value for row in foreign.values() for other in row.roles)
        raise OptionError(
            f"{', '.join(foreign)} cannot be given to a {role.value}, only to a {' or '.join(others)}; remove "
            f"{'it' if len(foreign) == 1 else 'them'}"
        )


def _fault(row: Option, text: str) -> str | None:
    choices = choices_of(row) if row.metavar else ["true", "false"]
    if issubclass(row.kind, Enum) or not row.metavar:
        return None if text in choices else nearest(text, choices)
    kind: Any = row.kind
    try:
        given = kind(text)
    except ValueError:
        return "write a number"
    value = row.read([given] if row.is_repeatable else given)
    parts = value if isinstance(value, tuple) else (value,)
    return next(filter(None, map(row.limit.fault, parts)), None) if row.limit else None


def _listed(rows: Mapping[str, Option], words: Sequence[str], role: Role | None) -> Iterator[str]:
    named = words[words.index("--backend") + 1 :][:1] if "--backend" in words else []
    backend = load_backend(named[0] if named else OPTIONS["backend"].field_default)  # type: ignore[arg-type]
    can_have = {
        **{name: any(name in names for names in backend.sizes.values()) for name in ("buffer", "segment", "fragment")},
        **dict.fromkeys(("call", "clients", "call_timeout", "response_size"), bool(backend.calls)),
        **dict.fromkeys(("security", "keys"), bool(backend.security)),
        "transport": len(backend.transports) > 1,
        "when_full": backend.can_drop,
        "priority": backend.priorities is not None,
        "congestion_control": backend.has_congestion_control,
        "multicast": backend.can_multicast,
        "executor": backend.has_ros,
    }
    for key, row in rows.items():
        if is_setting(row, role) and can_have.get(key, True):
            words = f"{key}={row.metavar or flag_of(row)}  {help_of(row)}"
            yield textwrap.fill(words, 80, subsequent_indent="    ", break_on_hyphens=False)


def given_values(values: Mapping[str, Any]) -> dict[str, Any]:
    return {
        name: value
        for name, value in values.items()
        if value is not None and value is not False and value != []  # 0 is given, and equal to False
    }


def read_record(record: type[_Record], chosen: Mapping[str, Any], **more: object) -> _Record:
    names = [column.name for column in fields(record) if column.name in chosen]  # type: ignore[arg-type]
    return record(**{name: OPTIONS[name].read(chosen[name]) for name in names}, **more)


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


def default_discovery(*, is_open: bool = True) -> Discovery:
    is_local = (
        os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper() == "LOCALHOST"
        or os.environ.get("ROS_LOCALHOST_ONLY") == "1"
    )
    is_asked = is_open or os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper() == "SUBNET"
    return Discovery.LOCALHOST if is_local or not is_asked else Discovery.SUBNET
