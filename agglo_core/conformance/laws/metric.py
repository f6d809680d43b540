"""Laws of the values of a quality metric."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import inf, pi, sqrt

import numpy as np

from agglo_core.arrays import Int, frozen_int
from agglo_core.conformance import small_meshes
from agglo_core.conformance.case import Case
from agglo_core.conformance.cases import cases, tiny
from agglo_core.conformance.law import law
from agglo_core.conformance.questions import answer, in_words, plain
from agglo_core.conformance.subject import Subject
from agglo_core.conformance.verdict import Broken, require
from agglo_core.mesh import Mesh

__all__ = ["HAND"]

HAND: Mapping[str, Sequence[Sequence[float]]] = {
    "UF": ((1, 1, 1, 1), (sqrt(0.2), 1), (1, 0.5)),
    "CR": ((sqrt(0.5),) * 4, (sqrt(0.5), sqrt(0.1)), (sqrt(2) - 1, sqrt(0.5))),
    "CRc": ((sqrt(0.5),) * 4, (sqrt(0.5), sqrt(0.1)), (1 / 6, sqrt(0.5))),
    "interface_length": ((4, 4, 4, 4), (1, 1), (2, 2)),
    "cut": ((4, 4, 4, 4), (1, 1), (2, 2)),
    "ncut": ((1 / 3,) * 4, (1, 1 / 5), (1 / 3, 1)),
    "components": ((1, 1, 1, 1), (1, 1), (1, 1)),
    "cells": ((4, 4, 4, 4), (1, 3), (3, 1)),
    "isoperimetric": ((pi / 4,) * 4, (pi / 4, 3 * pi / 16), (3 * pi / 16, pi / 4)),
    "convexity": ((1, 1, 1, 1), (1, 1), (6 / 7, 1)),
    "star_shapedness": ((1, 1, 1, 1), (1, 1), (1 / 3, 1)),
    "box_ratio": ((1, 1, 1, 1), (1, 1 / 3), (1, 1)),
    "edge_ratio": ((1, 1, 1, 1), (1, 1 / 3), (1 / 2, 1)),
}
"""Values worked out by hand: four squares of 2 by 2 cells; a square beside a 3 by 1 bar; an L of three
squares around a square."""


def _by_hand() -> list[Case]:
    row, column = np.divmod(np.arange(16), 4)
    return [
        Case("four squares", (small_meshes.grid(4, 4), frozen_int(row // 2 * 2 + column // 2))),
        Case("a square and a bar", (small_meshes.grid(4, 1), frozen_int([0, 1, 1, 1]))),
        Case("an L and a square", (small_meshes.grid(2, 2), frozen_int([0, 0, 0, 1]))),
    ]


def _holed() -> list[Case]:
    """Agglomerates with a hole, touching in a point, forming a closed ring, and in loose pieces."""
    around = np.ones((5, 5), int)
    around[1:4, 1:4] = 0
    pinched = np.array([0, 1, 1, 0])
    loose = (np.arange(9) % 8 == 0).astype(int)
    return [
        Case("an agglomerate with a hole", (small_meshes.grid(5, 5), frozen_int(around.ravel()))),
        Case("agglomerates that touch in a point", (small_meshes.grid(2, 2), frozen_int(pinched))),
        Case("a closed ring", (small_meshes.ring(12), frozen_int(np.zeros(12)))),
        Case("an agglomerate in loose pieces", (small_meshes.grid(3, 3), frozen_int(loose))),
    ]


@law("metric")
def declares_itself(subject: Subject) -> None:
    """It says which way is better, its bounds, and the power of a length it scales with."""
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


@law("metric")
def value_array(subject: Subject) -> None:
    """It returns one number per agglomerate: an array of shape (k,)."""
    for case in cases("metric"):
        given = answer(subject, subject.build(), case)
        require(
            isinstance(given, np.ndarray) and given.shape == (case.size,) and given.dtype.kind in "iuf",
            f"on {case.name}: it returned {in_words(given)}, expected an array of shape ({case.size},) of "
            "numbers, one for each of the labels 0..k-1: not one per cell, not a mean, not a list",
        )


@law("metric")
def finite(subject: Subject) -> None:
    """Values are finite."""
    for case in [*cases("metric"), *tiny("metric")]:
        values = plain(subject, subject.build(), case)
        bad = np.flatnonzero(~np.isfinite(values))
        require(
            not len(bad),
            f"on {case.name}: agglomerate {bad[:1]} got {values[bad[:1]]}: decide what the value is where a "
            "quotient has no denominator",
        )


@law("metric")
def within_bounds(subject: Subject) -> None:
    """Values lie within the declared bounds."""
    for case in [*cases("metric"), *tiny("metric"), *_by_hand()]:
        _require_bounds(subject, case)


@law("metric")
def holes(subject: Subject) -> None:
    """Agglomerates with holes, pinches or loose pieces get finite values within the bounds."""
    for case in _holed():
        values = plain(subject, subject.build(), case)
        require(
            np.isfinite(values).all(),
            f"on {case.name}: values are {values}: an agglomerate has no single outer loop; "
            "see mesh.coarsen(labels).boundary_loops",
        )
        _require_bounds(subject, case)


@law("metric")
def homogeneous(subject: Subject) -> None:
    """On a mesh scaled by s its values scale by s to the declared homogeneity."""
    tool = subject.build()
    for case in cases("metric"):
        mesh, labels = case.given
        scaled = Case(case.name, (small_meshes.changed(mesh, "scaled")[0], labels))
        expected = plain(subject, tool, case) * 1e3**tool.homogeneity
        _require_close(
            plain(subject, tool, scaled), expected, f"on {case.name} scaled by 1000",
            f"homogeneity {tool.homogeneity} is declared: divide by a length, or declare the true power",
        )  # fmt: skip


@law("metric")
def rigid_motion(subject: Subject) -> None:
    """Rotating and shifting the mesh changes no value."""
    for case in cases("metric"):
        mesh, labels = case.given
        before = plain(subject, subject.build(), case)
        for change in ("rotated", "shifted"):
            moved = Case(case.name, (small_meshes.changed(mesh, change)[0], labels))
            _require_close(
                plain(subject, subject.build(), moved), before, f"on {case.name} {change}",
                "measure lengths and angles, not coordinates; mesh.local_points keeps digits far from 0",
                2e-4,
            )  # fmt: skip


@law("metric")
def renaming(subject: Subject) -> None:
    """Values follow the labels of the agglomerates and do not depend on the numbering of the cells."""
    for case in cases("metric"):
        mesh, labels = case.given
        before = plain(subject, subject.build(), case)
        names = np.roll(np.arange(len(before)), 1)
        renamed = Case(case.name, (mesh, frozen_int(names[labels])))
        remedy = "entry i must belong to label i, whatever the order of the cells"
        _require_close(
            plain(subject, subject.build(), renamed)[names], before, f"on {case.name} with labels renamed",
            remedy,
        )  # fmt: skip
        moved, order = small_meshes.changed(mesh, "renumbered")
        renumbered = Case(case.name, (moved, frozen_int(labels[order])))
        _require_close(
            plain(subject, subject.build(), renumbered), before, f"on {case.name} with cells renumbered",
            remedy, 2e-4,
        )  # fmt: skip


@law("metric", when=lambda subject: subject.name in HAND)
def hand_values(subject: Subject) -> None:
    """On squares, a bar and an L it has the values worked out by hand (names the suite knows)."""
    for case, expected in zip(_by_hand(), HAND[subject.name], strict=True):
        values = plain(subject, subject.build(), case)
        _require_close(values, np.array(expected, float), f"on {case.name}", "see the definition", 1e-3)


@law("metric", when=lambda subject: subject.has("measure") and _shape_only(subject))
def shape_only_is_true(subject: Subject) -> None:
    """If it says shape_only, the cells inside agglomerates change nothing."""
    for case in cases("metric"):
        mesh, labels = case.given
        coarse = mesh.coarsen(labels)
        alone = replace(case, given=(coarse, frozen_int(np.arange(coarse.n_cells))))
        _require_close(
            plain(subject, subject.build(), alone), plain(subject, subject.build(), case),
            f"on {case.name} coarsened", "look at the outline alone, or drop shape_only = True", 2e-4,
        )  # fmt: skip


@law("metric", when=lambda subject: subject.has("changes"))
def changes_add_up(subject: Subject) -> None:
    """If it has ``changes``, they are what moving one cell does to the sum of its values."""
    for case in [*cases("metric"), *_by_hand()]:
        mesh, labels = case.given
        cells, parts = _moves(mesh, labels)
        tool = subject.build()
        told = np.asarray(tool.changes(mesh.graph, labels, cells, parts))
        require(
            told.shape == cells.shape,
            f"on {case.name}: changes returned {in_words(told)} for {len(cells)} moves, expected one each",
        )
        before, sums = plain(subject, tool, case).sum(), []
        for cell, part in zip(cells, parts, strict=True):
            moved = np.array(labels)
            moved[cell] = part
            sums.append(plain(subject, tool, Case(case.name, (mesh, frozen_int(moved)))).sum() - before)
        size = 1 + abs(before)
        off = np.flatnonzero(np.abs(told - sums) > 1e-8 * size)
        require(
            not len(off),
            f"on {case.name}: changes says {told[off[:1]]}, measure changes by {np.array(sums)[off[:1]]}: it "
            "is the sum of all values after the move, less the sum before",
        )


def _moves(mesh: Mesh, labels: Int) -> tuple[Int, Int]:
    """Some moves of a cell to the part of a neighbour that do not empty its own part."""
    graph, sizes = mesh.graph, np.bincount(labels)
    rows = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
    chosen = (labels[rows] != labels[graph.indices]) & (sizes[labels[rows]] > 1)
    few = np.flatnonzero(chosen)[:: max(1, chosen.sum() // 12)]
    return frozen_int(rows[few]), frozen_int(labels[graph.indices[few]])


def _shape_only(subject: Subject) -> bool:
    try:
        return bool(getattr(subject.build(), "shape_only", False))
    except Broken:
        return False


def _require_bounds(subject: Subject, case: Case) -> None:
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


def _require_close(
    values: np.ndarray, expected: np.ndarray, where: str, remedy: str, tolerance: float = 1e-6
) -> None:
    scale = max(float(np.abs(expected).max(initial=0.0)), 1e-300)
    require(
        np.abs(values - expected).max(initial=0.0) <= tolerance * scale,
        f"{where}: values are {values[:4]}, expected {expected[:4]}: {remedy}",
    )
