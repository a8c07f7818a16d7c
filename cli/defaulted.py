"""A command whose options have defaults of `dds-trace.toml`, and that shows with `--print-config` what is in force."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import typer
from typer.core import TyperCommand, TyperOption

from dds_trace.base.errors import OptionError

from .defaults import find_files, read_defaults

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from .defaults import Default


class DefaultedCommand(TyperCommand):
    """A command that looks into the files of defaults before it reads its arguments.

    Attributes:
        table: its table in `dds-trace.toml`; empty for a command without defaults.
        passes_over: takes the values of a call, returns name of a parameter -> what counts more than its default in the file.
        origins: name of a parameter -> its default in a file.
    """

    table = ""
    passes_over: Callable[[Mapping[str, Any]], Mapping[str, str]] = staticmethod(lambda _: {})
    origins: Mapping[str, Default] = {}

    def get_params(self, ctx: Any) -> list[Any]:
        """Return arguments and options, `--print-config` among them where no option of the command's own has that name."""
        params = super().get_params(ctx)
        return [*params[:-1], _print_config_option(), params[-1]] if self._tells_config else params

    def make_context(self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any) -> Any:
        """Return the context of a call; options that are not given have the defaults of `dds-trace.toml`."""
        # Looked for, not loaded, where there is none: most calls.
        files = find_files() if self.table and not {"-h", "--help", "--version"} & set(args) else []
        if files:
            options = {_key(each): each for each in self._options()}
            found = read_defaults(files, self.table, {key: each.multiple for key, each in options.items()})
            self.origins = {options[key].name: default for key, default in found.items()}
            extra["default_map"] = {name: default.value for name, default in self.origins.items()}
        return super().make_context(info_name, args, parent, **extra)

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Read the arguments; say whose defaults are in force, or with `--print-config` that alone, and end.

        Raises:
            OptionError: a default of a file is not what its option takes.
        """
        is_asked = "--print-config" in args and self._tells_config
        ctx.resilient_parsing = ctx.resilient_parsing or is_asked  # nothing is missing: nothing will be done
        try:
            rest: list[str] = super().parse_args(ctx, args)
        except typer.BadParameter as err:
            parameter: Any = err.param
            if parameter is None or not _is_default_of_file(ctx, parameter.name):
                raise
            path = self.origins[parameter.name].path
            raise OptionError(f"{path}: [{self.table}]: {_key(parameter)}: {err.message}") from err
        passed_over = self.passes_over(ctx.params)
        in_force = {
            name: default
            for name, default in self.origins.items()
            if _is_default_of_file(ctx, name) and name not in passed_over
        }
        for name in passed_over.keys() & self.origins.keys():
            if _is_default_of_file(ctx, name):
                ctx.params[name] = self._named[name].default
        if is_asked:
            self._print_config(ctx, in_force, passed_over)
            ctx.exit()
        if in_force and not ctx.resilient_parsing:
            for path in dict.fromkeys(default.path for default in in_force.values()):
                keys = [_key(self._named[name]) for name in in_force if in_force[name].path == path]
                typer.echo(f"{ctx.info_name}: defaults of {path}: {', '.join(keys)}", err=True)
        return rest

    @property
    def _tells_config(self) -> bool:
        return bool(self.table) and not any("--print-config" in each.opts for each in self.params)

    def _options(self) -> list[Any]:
        """Return the options that change what the command does: not those that show something instead (version, completion)."""
        options = [each for each in self.params if each.param_type_name == "option"]
        return [each for each in options if each.expose_value and not each.is_eager]

    @property
    def _named(self) -> dict[str, Any]:
        return {each.name: each for each in self._options()}

    def _print_config(
        self, ctx: Any, in_force: Mapping[str, Default], passed_over: Mapping[str, str]
    ) -> None:
        """Print a line for each option: its name, the value in force, and where that is from."""
        rows = []
        for each in self._options():
            if each.name in in_force:
                value, source = in_force[each.name].value, str(in_force[each.name].path)
            else:
                is_given = ctx.get_parameter_source(each.name).name == "COMMANDLINE"
                value = ctx.params.get(each.name)
                source = "option" if is_given else passed_over.get(each.name, "default")
            rows.append((f"--{_key(each)}", _shown(value), source))
        widths = [max(len(row[column]) for row in rows) for column in (0, 1)]
        for name, value, source in rows:
            typer.echo(f"{name:{widths[0]}}  {value:{widths[1]}}  {source}")


def _print_config_option() -> Any:
    return TyperOption(
        param_decls=["print_config", "--print-config"],
        is_flag=True,
        expose_value=False,
        help="Show each option's value in force and where it is from, and end.",
    )


def _key(parameter: Any) -> str:
    """Return the name of an option in the file: its long name without the dashes."""
    return str(max(parameter.opts, key=len)).lstrip("-")


def _is_default_of_file(ctx: Any, name: str) -> bool:
    source = ctx.get_parameter_source(name)
    return source is not None and source.name == "DEFAULT_MAP"


def _shown(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list | tuple):
        return ", ".join(map(str, value)) or "-"
    return "-" if value is None else str(getattr(value, "value", value))
