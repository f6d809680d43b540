"""Laws: functions that test a component, and raise Broken with the fault and its remedy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from inspect import cleandoc
from typing import Final

from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import Broken
from agglo_core.registry import KINDS
from agglo_core.registry.containment import PLUGIN_FAILURES

ASKED: Final = tuple(kind for kind in KINDS if kind != "sample")
"""Kinds whose components are called by the suite; a sample is only built."""


@dataclass(frozen=True)
class Law:
    """Property required of all components of some kinds, with the function that tests it.

    Attributes
    ----------
    kinds : tuple of str
        Kinds of component to which the law applies.
    promise : str or None
        Promise that switches the law on; None if the law always holds.
    when : callable or None
        Further condition on the subject, for instance a method or a name.
    judge : callable
        Raises :class:`Broken`; its docstring is the sentence of the law.
    """

    kinds: tuple[str, ...]
    promise: str | None
    when: Callable[[Subject], bool] | None
    judge: Callable[[Subject], None]

    @property
    def name(self) -> str:
        """Name of the law: the name of its test function."""
        return self.judge.__name__

    @property
    def sentence(self) -> str:
        """Statement of the law in one sentence: the docstring of its test function."""
        return " ".join(cleandoc(self.judge.__doc__ or "").split())

    def applies(self, subject: Subject) -> bool:
        """Return True if the component under test must obey this law."""
        if subject.kind not in self.kinds or (self.promise and subject.promised(self.promise) is None):
            return False
        try:
            return self.when is None or self.when(subject)
        except (Broken, *PLUGIN_FAILURES):  # judging the law then reports the error
            return True


def law(
    *kinds: str, promise: str | None = None, when: Callable[[Subject], bool] | None = None
) -> Callable[[Callable[[Subject], None]], Law]:
    """Decorator that turns a test function into a law for these kinds of component."""
    return lambda judge: Law(kinds, promise, when, judge)
