"""Laws for quality metrics: values, their changes when cells move, and invariance."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from math import inf
from numbers import Real
from typing import Any

import numpy as np

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.conformance.base import ATTRIBUTES, Case, Subject, law, require, require_array
from agglo_core.conformance.inputs.cases import mesh_case
from agglo_core.conformance.inputs.drawn import DrawnMesh
from agglo_core.conformance.inputs.mesh_changes import (
    MOTIONS,
    beside,
    halve_faces,
    renumber_mesh,
    transform_mesh,
    turn_inner_faces,
)
from agglo_core.conformance.inputs.metric_cases import HAND, by_hand, layouts
from agglo_core.conformance.inputs.option_values import option_choices
from agglo_core.conformance.inputs.questions import plain
from agglo_core.conformance.inputs.strategies import metric_cases
from agglo_core.errors import AggloError
from agglo_core.graph import Graph
from agglo_core.mesh import Mesh

_FLAGS = ("undefined", "directional", "relative", "shape_only")
_ROUNDING = 1e-5  # rounding of values relative to the largest; metrics may work in float32
_CIRCLES = 1e-3  # the same for circles found by bisection on another mesh
_SCALES = (1e8, 1e-8)  # rounding to a fixed number of decimals loses these scales


@law("metric")
def declares_itself(subject: Subject) -> None:
    """Attributes declare direction, bounds, homogeneity (power of length) and special properties."""
    tool = subject.build()
    better, bounds, power = (getattr(tool, name, None) for name in ("better", "bounds", "homogeneity"))
    good_bounds = isinstance(bounds, tuple | list) and len(bounds) == 2 and bounds[0] < bounds[1]
    faults = {
        f"better is {better!r}, expected 'high' or 'low'": better in ("high", "low"),
        f"bounds is {bounds!r}, expected (lowest, highest), such as (0.0, 1.0) or (0.0, inf)": good_bounds,
        f"homogeneity is {power!r}, expected a number: 0 for ratios, 1 for lengths": isinstance(power, Real),
    }
    faults |= {
        f"{name} is {value!r}, expected True or False, or no such attribute": isinstance(value, bool)
        for name, value in {name: getattr(tool, name, False) for name in _FLAGS}.items()
    }
    wrong = [fault for fault, holds in faults.items() if not holds]
    require(not wrong, f"attributes: {'; '.join(wrong)}", ATTRIBUTES)


def _declares(subject: Subject, flag: str) -> bool:
    return getattr(subject.build(), flag, False) is True


def _many_parts(_: Subject) -> list[Case]:
    """Return a test case with more than a thousand single-cell parts."""
    return [mesh_case(DrawnMesh(cells=1200, jitter=0.25, renumbered=True), "alone", 1)]


def _round_parts(subject: Subject) -> list[Case]:
    """Return test cases with a polygon of many sides, and polyhedra rounder than cubes."""
    families = ("hub", "voronoi3d") if subject.promised("3d") else ("hub",)
    return [mesh_case(DrawnMesh(family, cells=50), "alone", 1) for family in families]


@law("metric", draw=metric_cases, fixed=_round_parts)
def within_bounds(subject: Subject, case: Case) -> None:
    """Values are finite, or NaN if ``undefined`` is set, and lie within the declared bounds."""
    tool = subject.build()
    values = plain(subject, case, tool)
    missing = np.isnan(values) & _declares(subject, "undefined")
    bad = np.flatnonzero(~np.isfinite(values) & ~missing)
    require(
        not len(bad),
        f"agglomerate {bad[:1]} got {values[bad[:1]]}: define the value for a zero denominator, a hole "
        "(there are several loops, see mesh.coarsen(labels).boundary_loops) or loose pieces, or return NaN "
        "and set undefined = True",
    )
    low, high = tool.bounds
    limits = [abs(bound) for bound in (low, high) if 0.0 < abs(bound) < inf]
    slack = _ROUNDING * max(limits or [float(np.nanmax(np.abs(values), initial=0.0))])
    outside = values[(values < low - slack) | (values > high + slack)]
    require(
        not len(outside),
        f"{outside[:1]} lies outside the declared bounds {low}..{high}: clip rounding with np.clip, or "
        "declare wider bounds",
    )


def _known_name(subject: Subject) -> str:
    """Return the name under which a metric's values are known: as declared, or the class in snake case."""
    snake_name = re.sub("(?<=[a-z])(?=[A-Z])", "_", getattr(subject.given, "__name__", "")).lower()
    return subject.name or snake_name


@law("metric", when=lambda subject: _known_name(subject) in HAND)
def hand_values(subject: Subject) -> None:
    """Metrics with known names have the values computed by hand for squares, bars, an L and a ring."""
    for case, expected in zip(by_hand(), HAND[_known_name(subject)], strict=True):
        values = plain(subject, case)
        _require_close(subject, case, values, np.array(expected), f"on {case.name}", "see the definition")


@law("metric", draw=metric_cases, examples=50)
def homogeneous(subject: Subject, case: Case) -> None:
    """Scaling the mesh by s scales values by s to the declared power, in 3-D perhaps to a larger power."""
    declared = subject.build().homogeneity
    # In 3-D lengths may become areas, which raises the power to at most twice the declared one.
    powers = {declared}
    if case.given[0].dim == 3:
        powers |= {declared + k for k in np.sign(declared) * np.arange(abs(declared) + 1)} | {2 * declared}
    before = plain(subject, case)
    for scale in _SCALES:
        scaled = _with_mesh(case, transform_mesh(case.given[0], scale=scale))
        values = plain(subject, scaled)
        powers = {power for power in powers if _is_scaled(subject, case, values, before, scale**power)}
        require(
            powers,
            f"on {case.name} scaled by {scale:g}: values {before[:3]} became {values[:3]}, with homogeneity "
            f"{declared}: divide by a length, or declare the true power; do not add small constants or round "
            "to decimals, because their effect depends on the mesh size",
        )


def _is_scaled(subject: Subject, case: Case, values: Float, before: Float, factor: float) -> bool:
    slack = factor * (_ROUNDING * float(np.nanmax(np.abs(before), initial=0.0)) + _unit(subject, case, 1e-7))
    return bool(np.allclose(values, before * factor, rtol=0.0, atol=slack, equal_nan=True))


@law("metric", draw=metric_cases, examples=50)
def rigid_motion(subject: Subject, case: Case) -> None:
    """Translations change no value, nor do rotations and reflections unless ``directional`` is set."""
    before = plain(subject, case)
    for name, change in MOTIONS.items():
        if not (_declares(subject, "directional") and name in ("rotated", "mirrored")):
            moved = _with_mesh(case, transform_mesh(case.given[0], **change))
            _require_close(
                subject, case, plain(subject, moved), before, f"on {case.name} {name}",
                "measure lengths and angles, not coordinates (or set directional = True if the metric "
                "refers to the axes); mesh.local_points keeps precision far from 0",
            )  # fmt: skip


@law("metric", draw=metric_cases, fixed=_many_parts)
def renaming(subject: Subject, case: Case) -> None:
    """Values follow the agglomerate labels and do not depend on the numbering of the mesh."""
    mesh, labels = case.given
    before = plain(subject, case)
    remedy = "entry i must belong to label i, whatever the order of the cells"
    names = np.roll(np.random.default_rng(len(before)).permutation(len(before)), 1)
    renamed = replace(case, given=(mesh, frozen_int(names[labels])))
    values = plain(subject, renamed)[names]
    _require_close(subject, case, values, before, f"on {case.name} with labels renamed", remedy)
    other, order = renumber_mesh(mesh)
    renumbered = replace(case, given=(turn_inner_faces(other), frozen_int(labels[order])))
    values = plain(subject, renumbered)
    where = f"on {case.name} with cells, faces, their two sides and points renumbered"
    _require_close(subject, case, values, before, where, remedy)


@law(
    "metric",
    draw=metric_cases,
    examples=50,
    when=lambda subject: subject.has("measure") and _declares(subject, "shape_only"),
)
def shape_only_is_true(subject: Subject, case: Case) -> None:
    """If ``shape_only`` is set, values do not depend on the cells inside agglomerates or along outlines."""
    mesh, labels = case.given
    coarse = mesh.coarsen(labels)
    cells = frozen_int(np.arange(coarse.n_cells))
    before = plain(subject, case)
    for name, given in {
        "with one cell for each part": (coarse, cells),
        "with all faces cut": (halve_faces(mesh), labels),
    }.items():
        _require_close(
            subject, case, plain(subject, replace(case, given=given)), before,
            f"on {case.name} {name}", "use only the outline, however it is divided into edges, or drop "
            "shape_only = True",
        )  # fmt: skip


@law("metric", draw=metric_cases, when=lambda subject: not _declares(subject, "relative"))
def far_parts_do_not_matter(subject: Subject, case: Case) -> None:
    """The value of an agglomerate does not depend on distant cells and parts, unless ``relative`` is set."""
    mesh, labels = case.given
    before = plain(subject, case)
    remedy = "set relative = True if a value is relative to those of all parts, as diam(P) / h is"
    # Another component beside the mesh, with larger cells that form a part of their own.
    other = DrawnMesh("rectangles" if mesh.dim == 2 else "boxes", cells=4).mesh
    other = replace(other, points=other.points * (3.0 * float(np.ptp(mesh.points[:, 0]))))
    wider = (beside(mesh, other), np.append(labels, np.full(other.n_cells, len(before))))
    values = plain(subject, replace(case, given=wider))[:-1]
    _require_close(subject, case, values, before, f"on {case.name}, with another component far away", remedy)
    # All parts that do not touch part 0 become one part.
    offsets, vertices = mesh.cell_vertices
    owner = np.repeat(labels, np.diff(offsets))
    near = np.isin(np.arange(len(before)), owner[np.isin(vertices, vertices[owner == 0])])
    if np.count_nonzero(~near) > 1:
        names = np.unique(np.where(near, np.arange(len(before)), len(before)), return_inverse=True)[1]
        joined = replace(case, given=(mesh, frozen_int(names[labels])))
        values = plain(subject, joined)[:1]
        _require_close(
            subject, case, values, before[:1], f"on {case.name}, with the far parts joined", remedy
        )


@law("metric")
def better_is_better(subject: Subject) -> None:
    """Equal squares have finite values, which are not the worst of several shapes unless position matters."""
    tool, relative = subject.build(), getattr(subject.build(), "relative", False)
    sign = 1.0 if tool.better == "high" else -1.0
    worst = []
    for framed in (False,) if relative else (False, True):
        squares, others = layouts(framed)
        values = plain(subject, squares, tool)[:16].astype(float)
        require(np.isfinite(values).all(), f"on {squares.name}: values are {values}, expected finite values")
        if np.ptp(values) > _CIRCLES * np.abs(values).max() or _declares(subject, "directional"):
            return  # the metric depends on position
        means = [plain(subject, case, tool)[:16].astype(float).mean() for case in others]
        gains = sign * (np.array([mean for mean in means if np.isfinite(mean)]) - values.mean())
        slack = 1e-6 * max(map(abs, (values.mean(), *means)))
        worst.append(np.all(gains >= -slack) and np.count_nonzero(gains > slack) > 1)
    require(
        not all(worst),
        f"better is {tool.better!r}, yet bars, zigzags and loose cells rate better than squares: declare the "
        "other direction; if long parts are wanted along some direction, set directional = True",
    )


_MOVES = 6  # number of moves per case; each is measured


def _with_options(subject: Subject) -> Any:
    """Draw test cases with the accepted values of the metric's options."""
    return metric_cases(
        subject, options=[each for each in option_choices(subject) if _accepts(subject, each)]
    )


def _accepts(subject: Subject, options: Mapping[str, Any]) -> bool:
    try:
        subject.make(**options)
    except AggloError:
        return False
    return True


@law(
    "metric", draw=_with_options, fixed=_many_parts, when=lambda subject: subject.has("changes"), examples=30
)
def changes_add_up(subject: Subject, case: Case) -> None:
    """The values of ``changes`` equal the effect of moving one cell on the sum of all values."""
    mesh, labels = case.given
    tool, current = subject.make(**case.options), np.array(labels)
    weights = frozen_float(1.0 + np.arange(mesh.n_cells) % 3)  # user weights, unlike the measures
    graph = replace(mesh.graph, weights=weights)
    # After each round the same array holds other labels.
    for _ in range(2):
        cells, parts = _moves(graph, current)
        if not len(cells):
            return
        given = tool.changes(graph, current, cells, parts)
        changes = require_array(given, cells.shape, "iuf", "one value for each move", "changes")
        before = _sum_of_values(subject, tool, mesh, current)
        moves = zip(cells, parts, strict=True)
        sums = np.array([_sum_of_values(subject, tool, mesh, _moved(current, *move)) for move in moves])
        slack = 1e-8 * (abs(before) + np.abs(sums).max()) + _unit(subject, case, 1e-8)
        wrong = np.flatnonzero(np.abs(changes - sums + before) > slack)
        require(
            not len(wrong),
            f"changes returned {changes[wrong[:1]]}, the sum of measure changes by "
            f"{sums[wrong[:1]] - before}: return the sum of all values after the move minus the sum before, "
            "for the labels that the array holds now",
        )
        current[cells[-1]] = parts[-1]


def _moves(graph: Graph, labels: Int) -> tuple[Int, Int]:
    """Return cells and target parts for moves across part borders, and for a move that changes nothing.

    No move empties a part.
    """
    rows = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
    crossing = (labels[rows] != labels[graph.indices]) & (np.bincount(labels)[labels[rows]] > 1)
    entries = np.flatnonzero(crossing)[:: max(1, crossing.sum() // _MOVES)]
    stays = rows[entries[:1]]
    cells = np.concatenate((stays, rows[entries]))
    return frozen_int(cells), frozen_int(np.concatenate((labels[stays], labels[graph.indices[entries]])))


def _moved(labels: Int, cell: int, part: int) -> Int:
    labels = labels.copy()
    labels[cell] = part
    return frozen_int(labels)


def _sum_of_values(subject: Subject, tool: Any, mesh: Mesh, labels: Int) -> float:
    return float(plain(subject, Case("after a move", (mesh, frozen_int(labels))), tool).sum())


def _with_mesh(case: Case, mesh: Mesh) -> Case:
    return replace(case, given=(mesh, *case.given[1:]))


def _unit(subject: Subject, case: Case, share: float) -> float:
    """Return a share of the unit of a metric's values, given by the cell size."""
    return float(share * case.given[0].h ** subject.build().homogeneity)


def _require_close(
    subject: Subject, case: Case, values: Any, expected: Float, where: str, remedy: str
) -> None:
    """Require that values are close to the expected values, where NaN equals NaN."""
    slack = _CIRCLES * float(np.nanmax(np.abs(expected), initial=0.0)) + _unit(subject, case, _ROUNDING)
    wrong = ~np.isclose(values, expected, rtol=0.0, atol=slack, equal_nan=True)
    require(
        not wrong.any(),
        f"{where}: values are {values[wrong][:4]}, expected {expected[wrong][:4]}: {remedy}",
    )
