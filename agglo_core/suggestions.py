"""Suggestions in error messages: the closest name, and the correct form of a wrong call."""

from __future__ import annotations

import difflib
import reprlib
from collections.abc import Callable, Iterable, Mapping
from functools import partial, wraps
from inspect import Parameter, signature
from typing import Any, TypeVar, cast

_ELSEWHERE = {
    "tol": ("tolerance",),
    "rtol": ("tolerance",),
    "maxiter": ("max_iterations", "most"),
}
"""Names of options in scipy and PyAMG -> names here, which are not similar."""

Called = TypeVar("Called", bound=Callable[..., Any])


def did_you_mean(name: str, names: Iterable[str], n: int = 1, cutoff: float = 0.6) -> str:
    """Return a hint to the closest names for an error message, empty if none is close.

    For options named as in scipy or PyAMG the hint is the name used here.

    Parameters
    ----------
    name : str
    names : iterable of str
        The accepted names.
    n : int
        Largest number of names in the hint.
    cutoff : float
        Lowest similarity of a name, from 0 to 1, as in :func:`difflib.get_close_matches`.

    Examples
    --------
    >>> from agglo_core.suggestions import did_you_mean
    >>> did_you_mean("n_part", ["h_star", "n_parts"])
    " (did you mean 'n_parts'?)"
    >>> did_you_mean(".vtx", [".npz", ".vtk", ".vtu"], 2)
    " (did you mean '.vtu' or '.vtk'?)"
    """
    known = list(names)
    close = [here for here in _ELSEWHERE.get(name, ()) if here in known]
    close = close[:n] or difflib.get_close_matches(name, known, n, cutoff)
    return f" (did you mean {' or '.join(map(repr, close))}?)" if close else ""


def suggest_keywords(keyword_for: Callable[[Any], str] | None = None) -> Callable[[Called], Called]:
    """Make the TypeErrors of wrong calls name the closest keyword or the correct call (decorator).

    It decorates functions, methods and the constructors of classes.

    Parameters
    ----------
    keyword_for : callable, optional
        Returns the probable keyword for the value of a superfluous positional argument.

    Examples
    --------
    >>> from agglo_core.suggestions import suggest_keywords
    >>> @suggest_keywords()
    ... def halve(mesh, *, axis=0):
    ...     pass
    >>> halve("mesh", axes=1)
    Traceback (most recent call last):
        ...
    TypeError: halve() got an unexpected keyword argument 'axes' (did you mean 'axis'?)
    """

    def decorate(called: Called) -> Called:
        check = partial(_check_call, called.__qualname__, signature(called).parameters, keyword_for)
        if isinstance(called, type):
            construct = called.__init__  # type: ignore[misc]

            @wraps(construct)
            def constructed(self: Any, *arguments: Any, **keywords: Any) -> None:
                check(arguments, keywords)
                construct(self, *arguments, **keywords)

            called.__init__ = constructed  # type: ignore[misc]
            return called

        @wraps(called)
        def checked(*arguments: Any, **keywords: Any) -> Any:
            check(arguments, keywords)
            return called(*arguments, **keywords)

        return cast(Called, checked)

    return decorate


def _check_call(
    call: str,
    parameters: Mapping[str, Parameter],
    keyword_for: Callable[[Any], str] | None,
    arguments: tuple[Any, ...],
    keywords: Mapping[str, Any],
) -> None:
    """Raise TypeError for an unknown keyword or superfluous positional arguments."""
    positional = [name for name, p in parameters.items() if p.kind is p.POSITIONAL_OR_KEYWORD]
    by_name = [name for name, p in parameters.items() if p.kind is p.KEYWORD_ONLY]
    # 1. Unknown keywords are options if the function has any, except for a mistyped required parameter.
    unknown = [name for name in keywords if name not in parameters]
    if any(p.kind is p.VAR_KEYWORD for p in parameters.values()):
        required = [name for name in positional if parameters[name].default is Parameter.empty]
        missing = [name for name in required if name not in [*positional[: len(arguments)], *keywords]]
        unknown = [name for name in unknown if did_you_mean(name, missing)]
    if unknown:
        hint = did_you_mean(unknown[0], parameters) or f"; accepted: {', '.join(parameters)}"
        raise TypeError(f"{call}() got an unexpected keyword argument {unknown[0]!r}{hint}")
    # 2. Superfluous positional arguments.
    surplus = arguments[len(positional) :]
    if surplus and by_name:
        remedy = f"give the others by name ({', '.join(by_name)})"
        if keyword_for is not None:
            named = {keyword_for(value): value for value in surplus} | dict(keywords)
            written = [f"{name}={_brief(value)}" for name, value in named.items()]
            remedy = f"write {call}({', '.join([*positional, *written])})"
        count = f"{len(positional)} positional argument{'s' if len(positional) > 1 else ''}"
        raise TypeError(f"{call}() takes {count} ({', '.join(positional)}), given {len(arguments)}: {remedy}")


def _brief(value: object) -> str:
    """Return the representation of a value, shortened, on one line."""
    return " ".join(reprlib.repr(value).split())
