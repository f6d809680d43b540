"""Option checks, with exceptions that name option, given value and accepted values."""

from __future__ import annotations

import inspect
import math
from collections.abc import Iterable, Mapping
from numbers import Integral, Real
from typing import Any

from agglo_core.errors import OptionError


def require_count(name: str, value: Any, least: int, most: int | None = None) -> None:
    """Raise OptionError unless ``value`` is a whole number in ``least..most``."""
    whole = isinstance(value, Integral) and not isinstance(value, bool)
    if not whole or value < least or (most is not None and value > most):
        wanted = f"{least}..{most}" if most is not None else f"at least {least}"
        raise OptionError(f"{name} must be a whole number, {wanted}; given {value!r}")


def require_positive(name: str, value: Any) -> None:
    """Raise OptionError unless ``value`` is a positive, finite number."""
    if not (_is_number(value) and 0.0 < value < math.inf):
        raise OptionError(f"{name} must be a positive number; given {value!r}")


def require_fraction(name: str, value: Any) -> None:
    """Raise OptionError unless ``value`` lies between 0 and 1, both excluded."""
    if not (_is_number(value) and 0.0 < value < 1.0):
        raise OptionError(f"{name} must be a number between 0 and 1; given {value!r}")


def require_truth(name: str, value: Any) -> None:
    """Raise OptionError unless ``value`` is True or False."""
    if not isinstance(value, bool):
        raise OptionError(f"{name} must be true or false; given {value!r}")


def chosen(name: str, value: Any, known: Mapping[str, Any]) -> Any:
    """Return the known value with this name, or a given callable, or raise OptionError otherwise."""
    if callable(value):
        return value
    require_name(name, value, known)
    return known[value]


def require_name(name: str, value: Any, known: Iterable[str]) -> None:
    """Raise OptionError unless ``value`` is a known name."""
    if value not in (accepted := tuple(known)):
        raise OptionError(f"{name} must be one of {', '.join(accepted)}; given {value!r}")


def _is_number(value: Any) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)


def show_options(solver: Any) -> str:
    """Return a solver's name with the constructor options that differ from their defaults.

    Examples
    --------
    >>> from agglo_core.solvers.direct import Direct
    >>> Direct(degree=3)
    Direct(degree=3)
    """
    homes = [solver, *(getattr(solver, name, None) for name in ("discretisation", "overrides"))]
    settings = []
    for name, option in inspect.signature(type(solver)).parameters.items():
        home = next((home for home in homes if hasattr(home, name)), None)
        value = getattr(home, name, option.default)
        if isinstance(value, str | float | int) and value != option.default:
            settings.append(f"{name}={value!r}")
    return f"{type(solver).__name__}({', '.join(settings)})"
