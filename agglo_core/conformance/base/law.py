"""Laws: plain functions of a subject that raise Broken with what is wrong and what to do."""

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
"""Kinds whose components are asked questions; a sample answers when it is built, and never again."""


@dataclass(frozen=True)
class Law:
    """A named requirement of components of some kinds.

    Attributes
    ----------
    kinds : tuple of str
        Kinds of component it holds for.
    promise : str or None
        The promise that switches it on; None if it always holds.
    when : callable or None
        Further condition on the subject (a method it has, the name it has).
    judge : callable
        Raises :class:`Broken`; its docstring is the law in one sentence.
    """

    kinds: tuple[str, ...]
    promise: str | None
    when: Callable[[Subject], bool] | None
    judge: Callable[[Subject], None]

    @property
    def name(self) -> str:
        """Name of the function."""
        return self.judge.__name__

    @property
    def sentence(self) -> str:
        """The law in one sentence."""
        return " ".join(cleandoc(self.judge.__doc__ or "").split())

    def applies(self, subject: Subject) -> bool:
        """Whether it is to be judged at all."""
        if subject.kind not in self.kinds or (self.promise and subject.promised(self.promise) is None):
            return False
        try:
            return self.when is None or self.when(subject)
        except (Broken, *PLUGIN_FAILURES):  # judging it says what is wrong
            return True


def law(
    *kinds: str, promise: str | None = None, when: Callable[[Subject], bool] | None = None
) -> Callable[[Callable[[Subject], None]], Law]:
    """Turn a function of a subject into a law for components of these kinds."""
    return lambda judge: Law(kinds, promise, when, judge)
