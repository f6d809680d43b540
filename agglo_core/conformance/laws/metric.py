"""Laws for quality metrics: values, their changes when cells move, and invariance."""

from __future__ import annotations

import re
from dataclasses import replace
from math import inf
from numbers import Real
from typing import Any

import numpy as np

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.conformance.base.case import Case
from agglo_core.conformance.base.drawing import drawn_law
from agglo_core.conformance.base.law import law
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import ATTRIBUTES, Broken, require
from agglo_core.conformance.inputs import small_meshes
from agglo_core.conformance.inputs.cases import cases
from agglo_core.conformance.inputs.drawn import beside
from agglo_core.conformance.inputs.mesh_changes import MOTIONS, Change
from agglo_core.conformance.inputs.metric_cases import (
    HAND,
    PLAIN,
    bodies,
    by_hand,
    cells_renumbered,
    cut_finer,
    cut_finer_in_space,
    far_from_each_other,
    layouts,
    many_alone,
    ring_case,
    shapes,
    solids,
    topology_cases,
    transform_case,
    various_cases,
)
from agglo_core.conformance.inputs.questions import answer, as_array, in_words, plain
from agglo_core.conformance.inputs.strategies import metric_cases
from agglo_core.graph import Graph
from agglo_core.mesh import Mesh

_TOLD = ("undefined", "directional", "relative", "shape_only")
_RELATIVE = 1e-5  # rounding of values relative to the largest; metrics may work in float32
_SCALES = (1e8, 1e-8)  # rounding to a fixed number of decimals loses these scales


def _extreme_shapes(subject: Subject) -> list[Case]:
    """Return test cases with round, thin and pointed parts, also in 3-D if promised."""
    plane = [*by_hand()[:3], *shapes()]
    return [*plane, *bodies()] if subject.promised("3d") else plane


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
    flags = {name: getattr(tool, name, False) for name in _TOLD}
    faults |= {
        f"{name} is {value!r}, expected True or False, or no such attribute": isinstance(value, bool)
        for name, value in flags.items()
    }
    wrong = [fault for fault, holds in faults.items() if not holds]
    require(not wrong, f"attributes: {'; '.join(wrong)}", ATTRIBUTES)


@drawn_law("metric", draw=metric_cases, fixed=lambda _: [many_alone()])
def value_array(subject: Subject, case: Case) -> None:
    """Values form an array of shape (k,), with one number per agglomerate."""
    result = answer(subject, subject.build(), case)
    values = as_array(result)
    require(
        values.shape == (case.size,) and values.dtype.kind in "biuf",
        f"on {case.name}: it returned {in_words(result)}, expected an array of shape ({case.size},) of "
        "numbers, one for each of the labels 0..k-1: not one per cell, not a mean",
    )


@drawn_law("metric", draw=metric_cases, fixed=_extreme_shapes)
def finite(subject: Subject, case: Case) -> None:
    """Values are finite, or NaN if ``undefined`` is set."""
    _require_finite(
        subject, case, "define the value for a zero denominator, or return NaN and set undefined = True"
    )


@law("metric", when=lambda subject: _declares(subject, "undefined"))
def defined_on_squares(subject: Subject) -> None:
    """Plain squares have a finite value even if ``undefined`` is set."""
    case = by_hand()[0]
    values = plain(subject, subject.build(), case)
    require(
        np.isfinite(values).all(),
        f"on {case.name}: values are {values}: return a finite value at least for plain squares",
    )


@drawn_law("metric", draw=metric_cases, fixed=_extreme_shapes)
def within_bounds(subject: Subject, case: Case) -> None:
    """Values lie within the declared bounds, for round, thin or pointed parts and any mesh size."""
    require_bounds(subject, case)


@law("metric")
def holes(subject: Subject) -> None:
    """Agglomerates with holes, point contacts or loose pieces get finite values within the bounds."""
    for case in [*topology_cases(), ring_case()]:
        _require_finite(
            subject, case, "an agglomerate has no single outer loop; see mesh.coarsen(labels).boundary_loops"
        )  # fmt: skip
        require_bounds(subject, case)


def _known_name(subject: Subject) -> str:
    """Return the name under which a metric's values are known: as declared, or the class in snake case."""
    snake_name = re.sub("(?<=[a-z])(?=[A-Z])", "_", getattr(subject.given, "__name__", "")).lower()
    return subject.name or (snake_name if snake_name in PLAIN else "")


@law("metric", when=lambda subject: _known_name(subject) in HAND)
def hand_values(subject: Subject) -> None:
    """Metrics with known names have the values computed by hand for squares, bars, an L and a ring."""
    for case, expected in zip(by_hand(), HAND[_known_name(subject)], strict=True):
        values = plain(subject, subject.build(), case)
        require_close(values, np.array(expected, float), f"on {case.name}", "see the definition", 1e-3)


@law("metric", when=lambda subject: subject.has("measure") and _declares(subject, "shape_only"))
def shape_only_is_true(subject: Subject) -> None:
    """If ``shape_only`` is set, values do not depend on the cells inside agglomerates or along outlines."""
    pairs = [(case, _coarsen_case(case)) for case in cases("metric")]
    pairs += [(case, cut_finer(case)) for case in cases("metric")[2:]]
    if subject.promised("3d"):
        pairs += [cut_finer_in_space(), *((case, _coarsen_case(case)) for case in solids()[:2])]
    for case, variant in pairs:
        require_close(
            plain(subject, subject.build(), variant), plain(subject, subject.build(), case),
            f"on {variant.name}", "use only the outline, however it is divided into edges, or drop "
            "shape_only = True", 2e-4, allowed_rounding(subject, case, 1e-5),
        )  # fmt: skip


def _coarsen_case(case: Case) -> Case:
    """Replace the mesh of a test case by the coarse mesh, whose cells are the parts."""
    mesh, labels = case.given
    coarse = mesh.coarsen(labels)
    return Case(f"{case.name} coarsened", (coarse, frozen_int(np.arange(coarse.n_cells))))


def _declares(subject: Subject, attribute: str) -> bool:
    try:
        return getattr(subject.build(), attribute, False) is True
    except Broken:
        return False


def _require_finite(subject: Subject, case: Case, remedy: str) -> None:
    values = plain(subject, subject.build(), case)
    fine = np.isfinite(values)
    if _declares(subject, "undefined"):
        fine |= np.isnan(values)
    bad = np.flatnonzero(~fine)
    require(not len(bad), f"on {case.name}: agglomerate {bad[:1]} got {values[bad[:1]]}: {remedy}")


def require_bounds(subject: Subject, case: Case) -> None:
    tool = subject.build()
    low, high = tool.bounds
    values = plain(subject, tool, case)
    limits = [abs(bound) for bound in (low, high) if 0.0 < abs(bound) < inf]
    slack = _RELATIVE * max(limits or [float(np.nanmax(np.abs(values), initial=0.0))])
    outside = values[(values < low - slack) | (values > high + slack)]
    require(
        not len(outside),
        f"on {case.name}: {outside[:1]} lies outside the declared bounds {low}..{high}: clip rounding with "
        "np.clip, or declare wider bounds",
    )


def allowed_rounding(subject: Subject, case: Case, share: float) -> float:
    """Return the absolute rounding error allowed for a metric value of 0.

    The error is ``share`` times the unit given by the cell size.
    """
    return float(share * case.given[0].h ** subject.build().homogeneity)


def require_close(
    values: np.ndarray,
    expected: np.ndarray,
    where: str,
    remedy: str,
    tolerance: float = _RELATIVE,
    floor: float = 0.0,
) -> None:
    """Require that metric values are close to the expected values.

    The difference may be at most ``tolerance`` times the largest value, plus ``floor``. NaN equals NaN.

    Raises
    ------
    Broken
        If a value differs by more.
    """
    scale = max(float(np.nanmax(np.abs(expected), initial=0.0)), 1e-300)
    mismatch = ~np.isclose(values, expected, rtol=0.0, atol=tolerance * scale + floor, equal_nan=True)
    require(
        not mismatch.any(),
        f"{where}: values are {values[mismatch][:4]}, expected {np.asarray(expected)[mismatch][:4]}: "
        f"{remedy}",
    )


_MOVES = 12  # number of moves per case; each is measured twice


@law("metric", when=lambda subject: subject.has("changes"))
def changes_add_up(subject: Subject) -> None:
    """The values of ``changes`` equal the effect of moving one cell on the sum of all values."""
    space = solids()[:2] if subject.promised("3d") else []
    for case in [*cases("metric"), *by_hand()[:3], *various_cases()[:2], _many_parts(), *space]:
        mesh, labels = case.given
        cells, parts = _moves(mesh, labels, _MOVES if mesh.n_cells < 1000 else 3)
        tool = subject.build()
        weights = frozen_float(1.0 + np.arange(mesh.n_cells) % 3)  # user weights, unlike the measures
        changes = _ask_changes(case.name, tool, replace(mesh.graph, weights=weights), labels, cells, parts)
        before, sums = plain(subject, tool, case).sum(), []
        # Move the cells one at a time and measure again.
        for cell, part in zip(cells, parts, strict=True):
            moved = np.array(labels)
            moved[cell] = part
            sums.append(plain(subject, tool, Case(case.name, (mesh, frozen_int(moved)))).sum() - before)
        size = 1 + abs(before)
        mismatches = np.flatnonzero(np.abs(changes - sums) > 1e-8 * size)
        require(
            not len(mismatches),
            f"on {case.name}: changes returned {changes[mismatches[:1]]}, the sum of measure changes by "
            f"{np.array(sums)[mismatches[:1]]}: return the sum of all values after the move minus the sum "
            "before",
        )


@law("metric", when=lambda subject: subject.has("changes"))
def changes_of_these_labels(subject: Subject) -> None:
    """The values of ``changes`` refer to the current labels, even if the label array has been overwritten."""
    for case in [*cases("metric")[3:], *by_hand()[:1], _many_parts()]:
        mesh, labels = case.given
        tool, current_labels = subject.build(), np.array(labels)
        for _ in range(3):
            cells, parts = _moves(mesh, current_labels)
            if not len(cells):
                break
            changes = _ask_changes(case.name, tool, mesh.graph, current_labels, cells, parts)
            expected = _ask_changes(
                case.name, subject.build(), mesh.graph, frozen_int(current_labels), cells, parts
            )
            require(
                bool(np.allclose(changes, expected, rtol=1e-9, atol=1e-9 * (1 + np.abs(expected).max()))),
                f"on {case.name}, after a cell was moved in the same array: changes returned {changes[:3]}, "
                f"that of a fresh object {expected[:3]}: the same array object may hold other labels now",
            )
            # Apply the last move to the same array.
            current_labels[cells[-1]] = parts[-1]


def _ask_changes(name: str, tool: Any, graph: Graph, labels: Int, cells: Int, parts: Int) -> Float:
    changes = np.asarray(tool.changes(graph, labels, cells, parts))
    require(
        changes.shape == cells.shape,
        f"on {name}: changes returned {in_words(changes)} for {len(cells)} moves, expected one value per "
        "move",
    )
    return changes


def _many_parts() -> Case:
    """Return a test case with more than a thousand parts, some with two cells."""
    mesh, names = many_alone().given
    _, labels = np.unique(np.where(names > 1000, names // 2 * 2, names), return_inverse=True)
    return Case("a thousand parts", (mesh, frozen_int(labels)))


def _moves(mesh: Mesh, labels: Int, most: int = _MOVES) -> tuple[Int, Int]:
    """Return cells and target parts for moves across part borders, and for a move that changes nothing.

    No move empties a part.
    """
    graph, sizes = mesh.graph, np.bincount(labels)
    rows = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
    crossing = (labels[rows] != labels[graph.indices]) & (sizes[labels[rows]] > 1)
    entries = np.flatnonzero(crossing)[:: max(1, crossing.sum() // most)]
    stays = rows[entries[:1]]
    cells = np.concatenate((stays, rows[entries]))
    return frozen_int(cells), frozen_int(np.concatenate((labels[stays], labels[graph.indices[entries]])))


_ROUNDED = 1e-3  # relative to the largest value; circles found by bisection differ by less


def _values(subject: Subject, case: Case) -> np.ndarray:
    return plain(subject, subject.build(), case)


def _various(_: Subject) -> list[Case]:
    return [*various_cases(), many_alone()]


def _plane_cases(subject: Subject) -> Any:
    """Return the strategy of 2-D cases, also for a metric that promises 3-D."""
    return metric_cases(replace(subject, declared={}))


@drawn_law("metric", draw=_plane_cases, fixed=_various)
def homogeneous(subject: Subject, case: Case) -> None:
    """Scaling the mesh by s scales the values by s to the power of the declared homogeneity."""
    power = subject.build().homogeneity
    before = _values(subject, case)
    for scale in _SCALES:
        require_close(
            _values(subject, transform_case(case, Change(scale=scale))[0]), before * scale**power,
            f"on {case.name} scaled by {scale:g}",
            f"homogeneity {power} is declared: divide by a length, or declare the true power; do not "
            "add small constants or round to decimals, because their effect depends on the mesh size",
            floor=allowed_rounding(subject, case, 1e-7) * scale**power,
        )  # fmt: skip


@drawn_law("metric", draw=_plane_cases, fixed=_various)
def rigid_motion(subject: Subject, case: Case) -> None:
    """Translations change no value, nor do rotations and reflections unless ``directional`` is set."""
    _require_unmoved(subject, case)


@drawn_law("metric", draw=metric_cases, fixed=_various)
def renaming(subject: Subject, case: Case) -> None:
    """Values follow the agglomerate labels and do not depend on the numbering of the mesh."""
    mesh, labels = case.given
    # Renamed labels permute the values; two parts are always swapped.
    before = _values(subject, case)
    names = np.random.default_rng(len(before)).permutation(len(before))
    names = names if len(before) > 2 else names[::-1] if names[0] == 0 else names
    renamed = replace(case, given=(mesh, frozen_int(names[labels])))
    remedy = "entry i must belong to label i, whatever the order of the cells"
    require_close(
        _values(subject, renamed)[names], before, f"on {case.name} with labels renamed", remedy,
        floor=allowed_rounding(subject, case, 1e-7),
    )  # fmt: skip
    _require_same_renumbered(subject, case, remedy)


@law("metric", promise="3d")
def unmoved_in_space(subject: Subject) -> None:
    """In 3-D too, values keep the bounds, scale as declared, and do not depend on position or numbering."""
    # In 3-D a length may become an area, so the power lies between the declared power and twice that.
    declared = subject.build().homogeneity
    powers = {declared + k for k in np.sign(declared) * np.arange(abs(declared) + 1)} | {2 * declared}
    for case in solids():
        before = _values(subject, case)
        require_bounds(subject, case)
        for scale in _SCALES:
            scaled_case, _ = transform_case(case, Change(scale=scale))
            require_bounds(subject, replace(scaled_case, name=f"{case.name} scaled by {scale:g}"))
            scaled = _values(subject, scaled_case)
            powers = {power for power in powers if _is_scaled_by(scaled, before, scale ** float(power))}
            require(
                bool(powers),
                f"on {case.name} scaled by {scale:g}: values {before[:3]} became {scaled[:3]}, with "
                f"homogeneity {declared}: in 3-D ratios must not change, and other values must scale with "
                "one power between the declared one and twice that (lengths may become areas)",
            )
        _require_unmoved(subject, case)
        _require_same_renumbered(subject, case, "entry i must belong to label i")


@law("metric")
def each_call_alone(subject: Subject) -> None:
    """Earlier measurements change no value, even on meshes with equal name, size or points."""
    case, variants = far_from_each_other()
    mesh, labels = case.given
    stretched = replace(mesh, points=mesh.points * np.array([1.0, 1.5]))
    # Cases with equal mesh, labels, name, points or counts.
    later_cases = [
        replace(case, given=(mesh, frozen_int(labels[::-1]))),
        *(replace(variant, given=(mesh, variant.given[1])) for variant in variants),
        replace(case, given=(stretched, labels)),
        case,
        cells_renumbered(case),
        by_hand()[0],
        cells_renumbered(by_hand()[0]),
    ]
    tool = subject.build()
    plain(subject, tool, case)
    for variant in later_cases:
        require_close(
            plain(subject, tool, variant), _values(subject, variant),
            f"on {variant.name}, after other questions",
            "keep nothing between calls: a mesh is not identified by its counts, its points or its name",
            floor=allowed_rounding(subject, variant, 1e-7),
        )  # fmt: skip


@drawn_law("metric", draw=metric_cases, when=lambda subject: not getattr(subject.build(), "relative", False))
def far_parts_do_not_matter(subject: Subject, case: Case) -> None:
    """The value of an agglomerate does not depend on distant cells and parts, unless ``relative`` is set."""
    mesh, labels = case.given
    before = _values(subject, case)
    remedy = "set relative = True if a value is relative to those of all parts, as diam(P) / h is"
    floor = allowed_rounding(subject, case, 1e-8)
    # Another component beside the mesh, with larger cells that form a part of their own.
    other = small_meshes.grid(2, 2) if mesh.dim == 2 else small_meshes.boxes(2, 1, 1)
    other = replace(other, points=other.points * (3.0 * float(np.ptp(mesh.points[:, 0]))))
    wider = Case(case.name, (beside(mesh, other), np.append(labels, np.full(other.n_cells, len(before)))))
    require_close(
        _values(subject, wider)[:-1], before, f"on {case.name}, with another component far away", remedy,
        floor=floor,
    )  # fmt: skip
    # All parts that do not touch part 0 become one part.
    offsets, vertices = mesh.cell_vertices
    owner = np.repeat(labels, np.diff(offsets))
    near = np.isin(np.arange(len(before)), owner[np.isin(vertices, vertices[owner == 0])])
    if np.count_nonzero(~near) > 1:
        names = np.unique(np.where(near, np.arange(len(before)), len(before)), return_inverse=True)[1]
        joined = Case(case.name, (mesh, frozen_int(names[labels])))
        require_close(
            _values(subject, joined)[:1], before[:1], f"on {case.name}, with the far parts joined", remedy,
            floor=floor,
        )  # fmt: skip


@law("metric", when=lambda subject: not getattr(subject.build(), "directional", False))
def better_is_better(subject: Subject) -> None:
    """If equal squares have equal values, they do not rate worst against bars, zigzags and loose cells."""
    tool = subject.build()
    sign = 1.0 if tool.better == "high" else -1.0
    framings = (False,) if getattr(tool, "relative", False) else (False, True)
    layout_means = [means for framed in framings if (means := _means(subject, framed))]
    worse = [_worst_of_all([sign * mean for mean in means]) for means in layout_means]
    require(
        not worse or not all(worse),
        f"better is {tool.better!r}, yet the means of squares, bars, zigzags and loose cells are "
        f"{[[round(mean, 4) for mean in means] for means in layout_means][:1]}: declare the other "
        "direction; if long parts are wanted along some direction, set directional = True",
    )


def _means(subject: Subject, framed: bool) -> list[float]:
    """Return the mean metric value of square parts, and of each worse layout with finite values.

    The list is empty if equal squares have different values: the metric then depends on position.
    """
    squares, others = layouts(framed)
    values = [np.asarray(_values(subject, case)[:16], float) for case in (squares, *others)]
    if np.ptp(values[0]) > _ROUNDED * np.abs(values[0]).max():
        return []
    return [float(array.mean()) for array in values if np.isfinite(array).all()]


def _worst_of_all(means: list[float]) -> bool:
    """Return True if the first mean is the lowest, and at least two others are higher."""
    squares, others = means[0], np.array(means[1:])
    slack = 1e-6 * max(map(abs, means))
    return bool(np.all(others >= squares - slack) and np.count_nonzero(others > squares + slack) > 1)


def _is_scaled_by(large: np.ndarray, before: np.ndarray, factor: float) -> bool:
    floor = 1e-6 * factor * float(np.nanmax(np.abs(before), initial=0.0)) + 1e-7 * factor
    return bool(np.allclose(large, before * factor, rtol=0.0, atol=floor, equal_nan=True))


def _require_unmoved(subject: Subject, case: Case) -> None:
    before = _values(subject, case)
    directional = getattr(subject.build(), "directional", False)
    for name, change in MOTIONS.items():
        if not (directional and (change.turned or change.mirror)):
            require_close(
                _values(subject, transform_case(case, change)[0]), before, f"on {case.name} {name}",
                "measure lengths and angles, not coordinates (or set directional = True if the metric "
                "refers to the axes); mesh.local_points keeps precision far from 0", _ROUNDED,
                allowed_rounding(subject, case, 1e-5),
            )  # fmt: skip


def _require_same_renumbered(subject: Subject, case: Case, remedy: str) -> None:
    require_close(
        _values(subject, transform_case(case, None)[0]), _values(subject, case),
        f"on {case.name} with cells, faces, their two sides and points renumbered", remedy, _ROUNDED,
        allowed_rounding(subject, case, 1e-5),
    )  # fmt: skip
