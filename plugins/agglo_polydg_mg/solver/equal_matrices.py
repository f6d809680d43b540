"""Comparison of problems: their matrices are equal if only source and boundary values differ."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from agglo_core.authoring import Diffusion, Problem

_DATA = ("source", "exact")  # they do not occur in the matrix


def coefficients_of(problem: Problem) -> Mapping[str, Any]:
    """Return copies of all that determines the matrix of a diffusion problem, {} for other problems.

    Of boundary data these are the tags, and α of Robin data.
    """
    if not isinstance(problem, Diffusion):
        return {}
    known = {each.name: getattr(problem, each.name) for each in fields(problem) if each.name not in _DATA}
    for name in ("dirichlet", "neumann"):
        known[name] = sorted(known[name])
    known["robin"] = {tag: _copy(alpha) for tag, (alpha, _) in problem.robin.items()}
    return {name: _copy(value) for name, value in known.items()}


def equal_coefficients(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Return True if the matrices of two diffusion problems are equal, False also if that is unknown.

    Callables may depend on more than their points, and never count as equal.
    """
    return bool(one) and one.keys() == other.keys() and all(_equal(one[name], other[name]) for name in one)


def _copy(value: Any) -> Any:
    return value if callable(value) or isinstance(value, dict | str) else np.array(value)


def _equal(one: Any, other: Any) -> bool:
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(_equal(one[key], other[key]) for key in one)
    if callable(one) or callable(other):
        return False
    return bool(np.array_equal(one, other))
