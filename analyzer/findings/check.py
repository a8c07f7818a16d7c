"""The record of a check."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..model.finding import Finding, Severity, Subject

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from .evidence import Evidence, Observation

    Observe = Callable[[Evidence], Iterator[Observation]]


@dataclass(frozen=True, slots=True)
class Check:
    """One kind of finding; calling it yields its findings. Observations fill the `{names}` in its action."""

    code: str
    severity: Severity
    title: str
    action: str
    subject: Subject
    observe: Observe

    def __call__(self, evidence: Evidence) -> Iterator[Finding]:
        """Yield a finding for each observation."""
        for seen in self.observe(evidence):
            action = self.action.format(**seen.blanks)
            seen_there = seen.where, seen.what, action, seen.groups
            yield Finding(self.severity, self.code, *seen_there, effect=seen.effect, subject=self.subject)


def check(code: str, severity: Severity, subject: Subject, action: str) -> Callable[[Observe], Check]:
    """Make a `Check` of the function below; the first line of its docstring is the title."""

    def decorate(observe: Observe) -> Check:
        title = (observe.__doc__ or code).partition("\n")[0].rstrip(".")
        return Check(code, severity, title, action, subject, observe)

    return decorate
