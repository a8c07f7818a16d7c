"""Defaults from `dds-trace.toml`; an option on the command line and a variable of ROS 2 count more."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import typer

from dds_trace.base import limits
from dds_trace.base.errors import OptionError

FILE_NAME = "dds-trace.toml"

VARIABLE = "DDS_TRACE_CONFIG"
"""Variable that names the file instead of all others; empty for none."""

PRINT_CONFIG = "print_config"

TABLES = ("record", "bridge", "sweep", "analyze", "compare", "watch")

_WITHOUT_DEFAULT = frozenset(
    "force check dry-run rehearse print print-config config version help write-limits".split()  # noqa: SIM905
)
"""Options without a configured default: they overwrite, or do something else than the command."""

_OF_THE_USER = frozenset(("PATH", "FILE", "FOLDER", "HOST", "PORT", "ADDRESS", "SIDE", "TYPE", "MODE", "RMW", "BRIDGE"))
"""Metavars of paths, rights of files, addresses, programs and of what is sent: another user may have written the file of a working folder."""

_ACTING = frozenset(("keep", "open", "payload"))
"""Options that remove files, start a program, or store what others send."""


def is_own_only(option: Any) -> bool:
    return bool(_OF_THE_USER & set(str(option.metavar).split(":"))) or _key(option) in _ACTING


@dataclass(frozen=True, slots=True)
class Default:
    value: object
    path: Path


def find_files() -> list[Path]:
    variable = os.environ.get(VARIABLE)
    if variable is not None:
        return [Path(variable)] if variable else []
    nearest = next((path for folder in _folders() if (path := folder / FILE_NAME).is_file()), None)
    paths = [path for path in (nearest, _own_file()) if path is not None]
    return [path for path in dict.fromkeys(paths) if path.is_file()]


def _own_file() -> Path | None:
    config = Path(os.environ.get("XDG_CONFIG_HOME") or Path(_home(), ".config"))
    return config / "dds-trace" / FILE_NAME if config.is_absolute() else None


def read_defaults(
    files: Sequence[Path], table: str, options: Mapping[str, Any], ignored: Collection[str] = ()
) -> dict[str, Default]:
    """Return option -> its default; of the files the first one counts most, and `ignored` are keys of other commands."""
    defaults: dict[str, Default] = {}
    for path in reversed(files):
        for key, value in _read(path, table, options, ignored).items():
            defaults[key] = Default(value, path)
    return defaults


def _read(path: Path, table: str, options: Mapping[str, Any], ignored: Collection[str]) -> dict[str, object]:
    from dds_trace.base.files import read_settings
    from dds_trace.base.toml_table import TomlTable  # not loaded where there is no file

    remedy = f"name another file in {VARIABLE}, or leave it empty"
    text = read_settings(path, "it", remedy, partial(_check_owner, path))
    root = TomlTable.parse(text, str(path))
    root.allow(*TABLES)
    entries = root.table(table)
    allowed = [name for name in options if name not in _WITHOUT_DEFAULT]
    values = {key: value for key, value in entries.values.items() if key in options or key not in ignored}
    for key, value in values.items():
        if key in _WITHOUT_DEFAULT and key in options:
            raise OptionError(f"{entries.where}: {key} has no default; give --{key} each time")
        entries.allow(*allowed, *ignored)
        if isinstance(value, dict) or (isinstance(value, list) and not options[key].multiple):
            raise OptionError(f"{entries.where}: {key} is {limits.shown(value)}; write one value")
        names_source = key == "data" and ":" in str(value)  # a file, a bag or a running topic
        if (names_source or is_own_only(options[key])) and VARIABLE not in os.environ and path != _own_file():
            raise OptionError(
                f"{entries.where}: {key} = {limits.shown(value)} cannot come from a working folder: give --{key}, or set it in "
                f"{_own_file() or VARIABLE}; {VARIABLE}= in the environment ignores this file"
            )
    return {
        key: value if isinstance(value, list) or not options[key].multiple else [value] for key, value in values.items()
    }


def _folders() -> Iterator[Path]:
    working = Path.cwd()
    home = Path(_home())
    above = []
    for folder in (working, *working.parents):
        above.append(folder)
        if folder == home or (folder / ".git").exists():
            yield from above
            return
    yield working


def _check_owner(path: Path, owner: int) -> None:
    trusted = {os.geteuid(), 0, path.parent.stat().st_uid}
    if owner not in trusted:
        raise OptionError(f"{path} belongs to another user; remove it, or work without: {VARIABLE}= in the environment")


def _home() -> str:
    return os.path.expanduser("~")  # noqa: PTH111 - Path.home() raises where there is none


def configurable(command: Any) -> dict[str, Any]:
    options = [parameter for parameter in command.params if parameter.param_type_name == "option"]
    return {_key(option): option for option in options if option.expose_value and not option.is_eager}


def set_defaults(table: str, ignored: Collection[str]) -> Callable[[typer.Context, bool], bool]:
    def read(context: typer.Context, prints: bool) -> bool:
        if context.resilient_parsing:  # a shell completes
            return prints
        files = [] if context.obj is not None else find_files()  # a plan says all that is measured
        options = configurable(context.command)
        defaults = read_defaults(files, table, options, ignored) if files else {}
        for key, default in defaults.items():
            _check_value(context, options[key], default, f"[{table}]: {key}")
        context.default_map = {options[key].name: default.value for key, default in defaults.items()}
        context.meta[__name__] = {options[key].name: default for key, default in defaults.items()}
        context.resilient_parsing = prints  # nothing will be done, so nothing may be missing
        return prints

    return read


def _check_value(context: typer.Context, option: Any, default: Default, where: str) -> None:
    try:
        option.process_value(context, default.value)
    except typer.BadParameter as err:
        raise OptionError(f"{default.path}: {where}: {err.message}") from err


def values_in_force(
    context: typer.Context, values: Mapping[str, Any], overridden: Mapping[str, str], defaults: Mapping[str, object]
) -> Mapping[str, Any]:
    from_file = {
        name: default for name, default in context.meta[__name__].items() if _source(context, name) == "DEFAULT_MAP"
    }
    options = {option.name: option for option in configurable(context.command).values()}
    values = {**values, **{name: options[name].default for name in from_file if name in overridden}}
    in_force = {name: default for name, default in from_file.items() if name not in overridden}
    if values[PRINT_CONFIG]:
        _print_config(context, options, values, in_force, overridden, defaults)
        raise typer.Exit
    for path in dict.fromkeys(default.path for default in in_force.values()):
        keys = [_key(options[name]) for name in in_force if in_force[name].path == path]
        typer.echo(f"{context.command_path}: defaults of {path}: {', '.join(keys)}", err=True)
    return values


def _print_config(
    context: typer.Context,
    options: Mapping[str, Any],
    values: Mapping[str, Any],
    in_force: Mapping[str, Default],
    overridden: Mapping[str, str],
    defaults: Mapping[str, object],
) -> None:
    rows = []
    for name, option in options.items():
        if name in in_force:
            value, source = in_force[name].value, str(in_force[name].path)
        else:
            source = "option" if _source(context, name) == "COMMANDLINE" else overridden.get(name, "default")
            value = values[name]
            if value is None and source == "default":
                value = defaults.get(name)
        key = _key(option)
        if option.hidden:  # typed as -o KEY=VALUE
            value = not value if key.startswith("no-") else value
        typed = f"-o {key.removeprefix('no-').replace('-', '_')}" if option.hidden else f"--{key}"
        rows.append((typed, _shown(value), source))
    widths = [max(len(row[column]) for row in rows) for column in (0, 1)]
    for key, value, source in rows:
        typer.echo(f"{key:{widths[0]}}  {value:{widths[1]}}  {source}")


def _key(parameter: Any) -> str:
    return str(max(parameter.opts, key=len)).lstrip("-")


def _source(context: typer.Context, name: str) -> str:
    source = context.get_parameter_source(name)
    return "" if source is None else source.name


def _shown(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list | tuple):
        return ", ".join(map(str, value)) or "-"
    return "-" if value is None else str(getattr(value, "value", value))
