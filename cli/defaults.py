"""Defaults of options from `dds-trace.toml`.

First an option counts, then a variable of ROS 2, then the file in the working directory or above it, then the user's own file,
then the default of `--help`.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from dds_trace.base import limits
from dds_trace.base.errors import OptionError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

FILE_NAME = "dds-trace.toml"

VARIABLE = "DDS_TRACE_CONFIG"
"""Variable that names the file instead of all others; empty for none."""

TABLES = ("record", "bridge", "sweep", "analyze", "compare", "watch")
"""Tables of the file, one per command."""

_MOST_BYTES = 1 << 20

_WITHOUT_DEFAULT = frozenset(
    ("force", "recover", "self-test", "check", "dry-run", "print", "print-config", "version", "help", "list")
)
"""Options without a configured default: they overwrite, or do something else than the command."""


@dataclass(frozen=True, slots=True)
class Default:
    """The value of an option in a file."""

    value: object
    path: Path


def find_files() -> list[Path]:
    """Return the files of defaults, the first one counts most; only that of `VARIABLE` if it is set."""
    named = os.environ.get(VARIABLE)
    if named is not None:
        return [Path(named)] if named else []
    nearest = next((path for folder in _folders() if (path := folder / FILE_NAME).is_file()), None)
    config = os.environ.get("XDG_CONFIG_HOME") or os.path.join(_home(), ".config")  # noqa: PTH118 - no home, no folder
    own = Path(config, "dds-trace", FILE_NAME)
    paths = [path for path in (nearest, own) if path is not None]
    return [path for path in dict.fromkeys(paths) if path.is_file()]


def read_defaults(files: Sequence[Path], table: str, options: Mapping[str, bool]) -> dict[str, Default]:
    """Return name of an option -> its default, for one command.

    Args:
        files: the first one counts most.
        table: the command's table.
        options: name of each option without dashes -> whether it is repeatable.

    Raises:
        OptionError: a file cannot be read, belongs to another user, or has an unknown key.
    """
    defaults: dict[str, Default] = {}
    for path in reversed(files):
        for key, value in _read(path, table, options).items():
            defaults[key] = Default(value, path)
    return defaults


def _read(path: Path, table: str, options: Mapping[str, bool]) -> dict[str, object]:
    from dds_trace.base.files import open_regular
    from dds_trace.recorder.sweep.plan.toml_table import TomlTable  # not loaded where there is no file

    try:
        with open_regular(path) as file:
            _check_owner(path, os.fstat(file.fileno()).st_uid)
            data = file.read(_MOST_BYTES + 1)
        text = data.decode()
    except OSError as err:
        raise OptionError(
            f"{path}: {err.strerror}; name another file in {VARIABLE}, or leave it empty"
        ) from err
    except UnicodeDecodeError as err:
        raise OptionError(f"{path}: {err}; it is UTF-8 text") from err
    if len(data) > _MOST_BYTES:
        raise OptionError(f"{path} is larger than {_MOST_BYTES >> 20} MiB, which no file of defaults is")
    root = TomlTable.parse(text, str(path))
    root.allow(*TABLES)
    own = root.table(table)
    allowed = [name for name in options if name not in _WITHOUT_DEFAULT]
    for key, value in own.values.items():
        if key in _WITHOUT_DEFAULT and key in options:
            raise OptionError(f"{own.where}: {key} has no default; give --{key} each time")
        own.allow(*allowed)
        if isinstance(value, dict) or (isinstance(value, list) and not options[key]):
            raise OptionError(f"{own.where}: {key} is {limits.shown(value)}; write one value")
    return {
        key: value if isinstance(value, list) or not options[key] else [value]
        for key, value in own.values.items()
    }


def _folders() -> Iterator[Path]:
    """Yield the working directory and those above it up to the repository or home; outside of both only itself."""
    here = Path.cwd()
    home = Path(_home())
    above = []
    for folder in (here, *here.parents):
        above.append(folder)
        if folder == home or (folder / ".git").exists():
            yield from above
            return
    yield here


def _check_owner(path: Path, owner: int) -> None:
    """Refuse a file that another user put into a shared folder such as `/tmp`."""
    trusted = {os.geteuid(), 0, path.parent.stat().st_uid}
    if owner not in trusted:
        raise OptionError(
            f"{path} belongs to another user; remove it, or work without: {VARIABLE}= in the environment"
        )


def _home() -> str:
    return os.path.expanduser("~")  # noqa: PTH111 - Path.home() raises where there is none
