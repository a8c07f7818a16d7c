"""Defaults from `dds-trace.toml`; an option on the command line and a variable of ROS 2 count more."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import typer
from typer.core import TyperCommand, TyperOption

from dds_trace.base import limits
from dds_trace.base.errors import OptionError

FILE_NAME = "dds-trace.toml"

VARIABLE = "DDS_TRACE_CONFIG"
"""Variable that names the file instead of all others; empty for none."""

TABLES = ("record", "bridge", "sweep", "analyze", "compare", "watch")

_WITHOUT_DEFAULT = frozenset(
    (
        "force",
        "recover",
        "self-test",
        "check",
        "dry-run",
        "rehearse",
        "print",
        "print-config",
        "config",
        "version",
        "help",
        "list",
        "write-limits",
    )
)
"""Options without a configured default: they overwrite, or do something else than the command."""

_OF_THE_USER = frozenset(("PATH", "FILE", "FOLDER", "HOST", "PORT", "ADDRESS", "SIDE", "TYPE", "MODE", "RMW", "BRIDGE"))
"""Metavars of paths, rights of files, addresses, programs and of what is sent: a working folder's file may be somebody else's."""

_ACTING = frozenset(("keep", "open", "payload"))
"""Options that remove files, start a program, or store what others send."""


def is_own_only(option: Any) -> bool:
    """Return whether an option has no default in a working folder, by its metavar."""
    return bool(_OF_THE_USER & set(str(option.metavar).split(":"))) or _key(option) in _ACTING


@dataclass(frozen=True, slots=True)
class Default:
    value: object
    path: Path


def find_files() -> list[Path]:
    """Return the files of defaults, the first one counts most; only the file of `VARIABLE` if it is set."""
    variable = os.environ.get(VARIABLE)
    if variable is not None:
        return [Path(variable)] if variable else []
    nearest = next((path for folder in _folders() if (path := folder / FILE_NAME).is_file()), None)
    paths = [path for path in (nearest, _own_file()) if path is not None]
    return [path for path in dict.fromkeys(paths) if path.is_file()]


def _own_file() -> Path | None:
    """Return the file in the user's configuration folder; a relative path would be a working folder's."""
    config = Path(os.environ.get("XDG_CONFIG_HOME") or Path(_home(), ".config"))
    return config / "dds-trace" / FILE_NAME if config.is_absolute() else None


def read_defaults(files: Sequence[Path], table: str, options: Mapping[str, Any]) -> dict[str, Default]:
    """Return option -> its default, for one command.

    Args:
        files: the first one counts most.
        table: the command's table.
        options: name without dashes -> the command's option.

    Raises:
        OptionError: a file cannot be read, belongs to another user, has an unknown key, or one that
            `is_own_only` in a working folder.
    """
    defaults: dict[str, Default] = {}
    for path in reversed(files):
        for key, value in _read(path, table, options).items():
            defaults[key] = Default(value, path)
    return defaults


def _read(path: Path, table: str, options: Mapping[str, Any]) -> dict[str, object]:
    from dds_trace.base.files import read_regular
    from dds_trace.recorder.sweep.plan.toml_table import TomlTable  # not loaded where there is no file

    try:
        text = read_regular(path, partial(_check_owner, path)).decode()
    except OSError as err:
        raise OptionError(f"{path}: {err.strerror}; name another file in {VARIABLE}, or leave it empty") from err
    except UnicodeDecodeError as err:
        raise OptionError(f"{path}: {err}; it is UTF-8 text") from err
    root = TomlTable.parse(text, str(path))
    root.allow(*TABLES)
    entries = root.table(table)
    allowed = [name for name in options if name not in _WITHOUT_DEFAULT]
    for key, value in entries.values.items():
        if key in _WITHOUT_DEFAULT and key in options:
            raise OptionError(f"{entries.where}: {key} has no default; give --{key} each time")
        entries.allow(*allowed)
        if isinstance(value, dict) or (isinstance(value, list) and not options[key].multiple):
            raise OptionError(f"{entries.where}: {key} is {limits.shown(value)}; write one value")
        names_source = key == "data" and ":" in str(value)  # a file, a bag or a running topic
        if (names_source or is_own_only(options[key])) and VARIABLE not in os.environ and path != _own_file():
            raise OptionError(
                f"{entries.where}: {key} = {limits.shown(value)} cannot come from a working folder: give --{key}, or set it in "
                f"{_own_file() or VARIABLE}; {VARIABLE}= in the environment ignores this file"
            )
    return {
        key: value if isinstance(value, list) or not options[key].multiple else [value]
        for key, value in entries.values.items()
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


class DefaultedCommand(TyperCommand):
    """A command with defaults in `dds-trace.toml`.

    Attributes:
        table: its table; empty for none.
    """

    table = ""
    overridden: Callable[[Mapping[str, Any]], Mapping[str, str]] = staticmethod(lambda _: {})
    defaults: Mapping[str, object] = {}
    in_file: Mapping[str, Default] = {}

    def get_params(self, ctx: Any) -> list[Any]:
        params = super().get_params(ctx)
        return [*params[:-1], _print_config_option(), params[-1]] if self._prints_config else params

    def make_context(self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any) -> Any:
        files = find_files() if self.table and not {"-h", "--help", "--version"} & set(args) else []
        if files:
            options = {_key(option): option for option in self._options()}
            values = read_defaults(files, self.table, options)
            self.in_file = {options[key].name: default for key, default in values.items()}
            extra["default_map"] = {name: default.value for name, default in self.in_file.items()}
        return super().make_context(info_name, args, parent, **extra)

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        prints_config = "--print-config" in args and self._prints_config
        # Nothing will be done, so nothing may be missing.
        ctx.resilient_parsing = ctx.resilient_parsing or prints_config
        try:
            remainder: list[str] = super().parse_args(ctx, args)
        except typer.BadParameter as err:
            parameter: Any = err.param
            if parameter is None or not _is_from_file(ctx, parameter.name):
                raise
            path = self.in_file[parameter.name].path
            raise OptionError(f"{path}: [{self.table}]: {_key(parameter)}: {err.message}") from err
        overridden = self.overridden(ctx.params)
        from_file = {name for name in self.in_file if _is_from_file(ctx, name)}
        in_force = {name: value for name, value in self.in_file.items() if name in from_file - set(overridden)}
        options = {option.name: option for option in self._options()}
        for name in from_file & set(overridden):
            ctx.params[name] = options[name].default
        if prints_config:
            self._print_config(ctx, in_force, overridden)
            ctx.exit()
        if in_force and not ctx.resilient_parsing:
            for path in dict.fromkeys(default.path for default in in_force.values()):
                keys = [_key(options[name]) for name in in_force if in_force[name].path == path]
                typer.echo(f"{ctx.info_name}: defaults of {path}: {', '.join(keys)}", err=True)
        return remainder

    @property
    def _prints_config(self) -> bool:
        return bool(self.table) and not any("--print-config" in option.opts for option in self.params)

    def _options(self) -> list[Any]:
        options = [parameter for parameter in self.params if parameter.param_type_name == "option"]
        return [option for option in options if option.expose_value and not option.is_eager]

    def _print_config(self, ctx: Any, in_force: Mapping[str, Default], overridden: Mapping[str, str]) -> None:
        rows = []
        for option in self._options():
            if option.name in in_force:
                value, source = in_force[option.name].value, str(in_force[option.name].path)
            else:
                is_given = ctx.get_parameter_source(option.name).name == "COMMANDLINE"
                value = ctx.params.get(option.name)
                source = "option" if is_given else overridden.get(option.name, "default")
                if value is None and source == "default":
                    value = self.defaults.get(option.name)
            rows.append((f"--{_key(option)}", _shown(value), source))
        widths = [max(len(row[column]) for row in rows) for column in (0, 1)]
        for name, value, source in rows:
            typer.echo(f"{name:{widths[0]}}  {value:{widths[1]}}  {source}")


def _print_config_option() -> Any:
    return TyperOption(
        param_decls=["print_config", "--print-config"],
        is_flag=True,
        expose_value=False,
        help="Show the value in force of each option and where it is from, and exit.",
    )


def _key(parameter: Any) -> str:
    return str(max(parameter.opts, key=len)).lstrip("-")


def _is_from_file(ctx: Any, name: str) -> bool:
    source = ctx.get_parameter_source(name)
    return source is not None and source.name == "DEFAULT_MAP"


def _shown(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list | tuple):
        return ", ".join(map(str, value)) or "-"
    return "-" if value is None else str(getattr(value, "value", value))
