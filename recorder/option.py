"""One row of the table of options: a field of a record of options, whose metadata says all that is made from it.

The rows make the command line of `dds-record` and its help, the checks, the keys of `dds-trace.toml`, the axes of a plan, the
settings of a run that part results, and the reference.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from enum import Enum
from typing import TYPE_CHECKING, Any, TypeVar

from .choices import Role

if TYPE_CHECKING:
    from collections.abc import Callable

    from dds_trace.base.limits import Limit


_T = TypeVar("_T")


class Panel(str, Enum):
    """Sections of the help, in their order."""

    OUTPUT = "Role and output"
    MESSAGE = "Message (ping)"
    SCHEDULE = "Schedule (ping)"
    MIDDLEWARE = "Middleware"
    QOS = "Quality of service (equal on both sides)"
    BRIDGE = "Bridge (ping)"
    RELAY = "Relay"
    PROCESS = "Process"
    DESCRIPTION = "Description in the trace"
    TOOLS = "Instead of recording"


@dataclass(frozen=True, slots=True)
class Axis:
    """How an option is a key of `[axes]` in a plan.

    Attributes:
        of_relay: whether the relay is started with it too.
        meaning: for the reference and editors, where the help does not do.
        default: value where the plan is silent, if it is not the option's own default.
        kind: type of the value, if it is not the option's.
        unit: unit of a number.
    """

    of_relay: bool = True
    meaning: str = ""
    default: object = None
    kind: type | None = None
    unit: str = ""


@dataclass(frozen=True, slots=True)
class Option:
    """One option of `dds-record`.

    Attributes:
        metavar: name of the value in the help; empty for a flag.
        kind: type of the value on the command line; an Enum's values are its choices.
        limit: validator of the field's value.
        parse: makes the field's value of what is given; of a list if the option is repeatable.
        default: the default in words, where the field's own default does not say it.
        role: the only role that takes it.
        in_key: whether a value other than the default parts results, as a setting of session or run.
        axis: how it is an axis of plans.
        variables: environment variables of ROS 2 that override a configured default.
        field_default: default of the field.
    """

    name: str
    panel: Panel
    help: str
    metavar: str
    kind: type
    limit: Limit | None
    parse: Callable[[Any], object] | None
    default: str
    role: Role | None
    in_key: bool
    axis: Axis | None
    variables: tuple[str, ...]
    field_default: object

    @property
    def is_repeatable(self) -> bool:
        """Whether it may be given several times."""
        return isinstance(self.field_default, tuple | dict)

    def read(self, given: Any) -> object:
        """Return the field's value of what the command line or the file of defaults has.

        Raises:
            OptionError: `parse` refuses it.
        """
        if self.field_default is True:  # --no-own-cost
            return False
        if self.parse is not None:
            return self.parse(given)
        return tuple(given) if self.is_repeatable else given


_ROLES = {
    **dict.fromkeys((Panel.MESSAGE, Panel.SCHEDULE, Panel.BRIDGE), Role.PING),
    Panel.RELAY: Role.RELAY,
}
"""Panel whose options only one role takes -> that role."""

OUTSIDE_OF_KEY = {"in_key": False}
"""Metadata of a field that is no option and no setting."""


def option(
    default: _T,
    name: str,
    panel: Panel,
    help: str,  # noqa: A002 - typer's word
    *,
    kind: type | None = None,
    limit: Limit | None = None,
    parse: Callable[[Any], object] | None = None,
    default_words: str = "",
    role: Role | None = None,
    in_key: bool = True,
    axis: Axis | None = None,
    variables: tuple[str, ...] = (),
) -> _T:
    """Return a dataclass field that is an option; the arguments are those of `Option`, `name` has the metavar after a space."""
    if kind is None:
        kind = str if default is None or isinstance(default, tuple | dict) else type(default)
    name, _, metavar = name.partition(" ")
    role = _ROLES.get(panel, role)
    row = Option(
        *(name, panel, help, metavar, kind, limit, parse, default_words, role, in_key, axis, variables),
        field_default=default,
    )
    if isinstance(default, dict):
        return field(default_factory=dict, metadata={"option": row})  # type: ignore[return-value]
    return field(default=default, metadata={"option": row})


def options_of(record: Any) -> dict[str, Option]:
    """Return field -> row of a record of options."""
    return {each.name: each.metadata["option"] for each in fields(record) if "option" in each.metadata}
