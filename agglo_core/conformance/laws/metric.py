"""Laws of the values of a quality metric."""

from __future__ import annotations

import re
from dataclasses import replace
from math import inf

import numpy as np

from agglo_core.arrays import frozen_int
from agglo_core.conformance.base.case import Case
from agglo_core.conformance.base.law import law
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import Broken, require
from agglo_core.conformance.inputs.cases import cases, tiny
from agglo_core.conformance.inputs.mesh_changes import Change
from agglo_core.conformance.inputs.metric_cases import (
    HAND,
    PLAIN,
    bodies,
    by_hand,
    changed,
    cut_finer,
    cut_finer_in_space,
    holed,
    many_alone,
    ringed,
    shapes,
    solids,
    various,
)
from agglo_core.conformance.inputs.questions import answer, as_array, in_words, plain

_TOLD = ("undefined", "directional", "relative", "shape_only")
_SCALES = (1e8, 1e-8)


@law("metric")
def declares_itself(subject: Subject) -> None:
    """It says which way is better, its bounds, the power of a length it scales with, and what is special."""
    tool = subject.build()
    better, bounds, power = (getattr(tool, name, None) for name in ("better", "bounds", "homogeneity"))
    require(better in ("high", "low"), f"attribute better is {better!r}, expected 'high' or 'low'")
    require(
        isinstance(bounds, tuple) and len(bounds) == 2 and bounds[0] < bounds[1],
        f"attribute bounds is {bounds!r}, expected (lowest, highest), for instance (0.0, 1.0) or (0.0, inf)",
    )
    require(
        isinstance(power, int),
        f"attribute homogeneity is {power!r}, expected a whole number: 0 for ratios, 1 for lengths",
    )
    for name in _TOLD:
        told = getattr(tool, name, False)
        require(isinstance(told, bool), f"attribute {name} is {told!r}, expected True, False or none")


@law("metric")
def value_array(subject: Subject) -> None:
    """It returns one number per agglomerate: an array of shape (k,)."""
    for case in [*cases("metric"), *various(), many_alone()]:
        given = answer(subject, subject.build(), case)
        values = as_array(given)
        require(
            values.shape == (case.size,) and values.dtype.kind in "biuf",
            f"on {case.name}: it returned {in_words(given)}, expected an array of shape ({case.size},) of "
            "numbers, one for each of the labels 0..k-1: not one per cell, not a mean",
        )


@law("metric")
def finite(subject: Subject) -> None:
    """Values are finite, or NaN where it says that values may be undefined."""
    for case in _every_shape(subject):
        _require_finite(
            subject, case, "decide what the value is where a quotient has no denominator; if there is none, "
            "return NaN and say undefined = True"
        )  # fmt: skip


@law("metric", when=lambda subject: _says(subject, "undefined"))
def defined_on_squares(subject: Subject) -> None:
    """If it says undefined, plain squares have a value nevertheless."""
    case = by_hand()[0]
    values = plain(subject, subject.build(), case)
    require(np.isfinite(values).all(), f"on {case.name}: values are {values}: what is it that it measures?")


@law("metric")
def within_bounds(subject: Subject) -> None:
    """Values lie within the declared bounds: of parts round, thin or pointed, on meshes of any size."""
    for case in _every_shape(subject):
        require_bounds(subject, case)
    for case in [*by_hand()[:3], *various()[:4]]:
        for scale in _SCALES:
            scaled, _ = changed(case, Change(scale=scale))
            require_bounds(subject, replace(scaled, name=f"{case.name} scaled by {scale:g}"))


@law("metric")
def holes(subject: Subject) -> None:
    """Agglomerates with holes, pinches or loose pieces get finite values within the bounds."""
    for case in [*holed(), ringed()]:
        _require_finite(
            subject, case, "an agglomerate has no single outer loop; see mesh.coarsen(labels).boundary_loops"
        )  # fmt: skip
        require_bounds(subject, case)


def _known_name(subject: Subject) -> str:
    """The declared name; of a bare class its own, in small letters."""
    made = re.sub("(?<=[a-z])(?=[A-Z])", "_", getattr(subject.given, "__name__", "")).lower()
    return subject.name or (made if made in PLAIN else "")


@law("metric", when=lambda subject: _known_name(subject) in HAND)
def hand_values(subject: Subject) -> None:
    """On squares, bars, an L, a ring and loose squares it has the values worked out by hand (known names)."""
    for case, expected in zip(by_hand(), HAND[_known_name(subject)], strict=True):
        values = plain(subject, subject.build(), case)
        require_close(values, np.array(expected, float), f"on {case.name}", "see the definition", 1e-3)


@law("metric", when=lambda subject: subject.has("measure") and _says(subject, "shape_only"))
def shape_only_is_true(subject: Subject) -> None:
    """If it says shape_only, neither the cells inside agglomerates nor those along them change anything."""
    pairs = [(case, _joined(case)) for case in cases("metric")]
    pairs += [(case, cut_finer(case)) for case in cases("metric")[2:]]
    if subject.promised("3d"):
        pairs += [cut_finer_in_space(), *((case, _joined(case)) for case in solids()[:2])]
    for case, other in pairs:
        require_close(
            plain(subject, subject.build(), other), plain(subject, subject.build(), case),
            f"on {other.name}", "look at the outline alone, whatever edges it is cut in, or drop "
            "shape_only = True", 2e-4, rounding(subject, case, 1e-5),
        )  # fmt: skip


def _joined(case: Case) -> Case:
    """The same parts, each of one cell."""
    mesh, labels = case.given
    coarse = mesh.coarsen(labels)
    return Case(f"{case.name} coarsened", (coarse, frozen_int(np.arange(coarse.n_cells))))


def _every_shape(subject: Subject) -> list[Case]:
    plane = [*cases("metric"), *tiny("metric"), *by_hand()[:3], *various()[:4], *shapes()]
    return [*plane, *solids(), *bodies()] if subject.promised("3d") else plane


def _says(subject: Subject, what: str) -> bool:
    try:
        return getattr(subject.build(), what, False) is True
    except Broken:
        return False


def _require_finite(subject: Subject, case: Case, remedy: str) -> None:
    values = plain(subject, subject.build(), case)
    fine = np.isfinite(values)
    if _says(subject, "undefined"):
        fine |= np.isnan(values)
    bad = np.flatnonzero(~fine)
    require(not len(bad), f"on {case.name}: agglomerate {bad[:1]} got {values[bad[:1]]}: {remedy}")


def require_bounds(subject: Subject, case: Case) -> None:
    tool = subject.build()
    low, high = tool.bounds
    values = plain(subject, tool, case)
    slack = 1e-9 * (1 + max(abs(b) for b in (low, high) if abs(b) < inf) if (low, high) != (-inf, inf) else 1)
    outside = values[(values < low - slack) | (values > high + slack)]
    require(
        not len(outside),
        f"on {case.name}: {outside[:1]} lies outside the declared bounds {low}..{high}: clip rounding with "
        "np.clip, or declare wider bounds",
    )


def rounding(subject: Subject, case: Case, share: float) -> float:
    """What rounding may make of a value that ought to be 0: a share of the unit of the cells."""
    return float(share * case.given[0].h ** subject.build().homogeneity)


def require_close(
    values: np.ndarray,
    expected: np.ndarray,
    where: str,
    remedy: str,
    tolerance: float = 1e-6,
    floor: float = 0.0,
) -> None:
    """Broken unless values differ by at most ``tolerance`` of the largest, and ``floor``; NaN equals NaN."""
    scale = max(float(np.nanmax(np.abs(expected), initial=0.0)), 1e-300)
    off = ~np.isclose(values, expected, rtol=0.0, atol=tolerance * scale + floor, equal_nan=True)
    require(
        not off.any(),
        f"{where}: values are {values[off][:4]}, expected {np.asarray(expected)[off][:4]}: {remedy}",
    )
