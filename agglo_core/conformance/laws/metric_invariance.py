"""Laws of what may and may not change the values of a quality metric."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from agglo_core.arrays import frozen_int
from agglo_core.conformance.base.case import Case
from agglo_core.conformance.base.law import law
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import require
from agglo_core.conformance.inputs.cases import cases
from agglo_core.conformance.inputs.mesh_changes import MOTIONS, Change
from agglo_core.conformance.inputs.metric_cases import (
    by_hand,
    cells_renumbered,
    changed,
    far_from_each_other,
    layouts,
    many_alone,
    solids,
    various,
)
from agglo_core.conformance.inputs.questions import plain
from agglo_core.conformance.laws.metric import require_bounds, require_close, rounding

_ROUNDED = 1e-3  # of the largest value: circles that are found by bisection differ by less
_SCALES = (1e8, 1e-8)  # what is rounded to a fixed number of decimals loses all of them


def _values(subject: Subject, case: Case) -> np.ndarray:
    return plain(subject, subject.build(), case)


@law("metric")
def homogeneous(subject: Subject) -> None:
    """On a mesh scaled by s its values scale by s to the declared homogeneity."""
    power = subject.build().homogeneity
    for case in [*cases("metric"), *various()]:
        before = _values(subject, case)
        for scale in _SCALES:
            require_close(
                _values(subject, changed(case, Change(scale=scale))[0]), before * scale**power,
                f"on {case.name} scaled by {scale:g}",
                f"homogeneity {power} is declared: divide by a length, declare the true power, and add no "
                "small constant nor round to decimals: both mean something else on a small mesh",
                floor=rounding(subject, case, 1e-7) * scale**power,
            )  # fmt: skip


@law("metric")
def rigid_motion(subject: Subject) -> None:
    """Moving the mesh changes no value; turning and mirroring neither, unless it says directional."""
    for case in [*cases("metric"), *various()]:
        _require_unmoved(subject, case)


@law("metric")
def renaming(subject: Subject) -> None:
    """Values follow the labels of the agglomerates and do not depend on any numbering of the mesh."""
    space = solids() if subject.promised("3d") else []
    for case in [*cases("metric"), *various(), many_alone(), *space]:
        mesh, labels = case.given
        before = _values(subject, case)
        names = np.random.default_rng(len(before)).permutation(len(before))
        names = names if len(before) > 2 else names[::-1] if names[0] == 0 else names
        renamed = replace(case, given=(mesh, frozen_int(names[labels])))
        remedy = "entry i must belong to label i, whatever the order of the cells"
        require_close(
            _values(subject, renamed)[names], before, f"on {case.name} with labels renamed", remedy,
            floor=rounding(subject, case, 1e-7),
        )  # fmt: skip
        _require_same_renumbered(subject, case, remedy)


@law("metric", promise="3d")
def unmoved_in_space(subject: Subject) -> None:
    """In 3-D too it keeps its bounds, scales as declared, and sees neither position nor numbering."""
    declared = subject.build().homogeneity
    powers = {declared + more for more in np.sign(declared) * np.arange(abs(declared) + 1)}
    for case in solids():
        before = _values(subject, case)
        require_bounds(subject, case)
        for scale in _SCALES:
            there, _ = changed(case, Change(scale=scale))
            require_bounds(subject, replace(there, name=f"{case.name} scaled by {scale:g}"))
            scaled = _values(subject, there)
            powers = {power for power in powers if _scaled_by(scaled, before, scale ** int(power))}
            require(
                bool(powers),
                f"on {case.name} scaled by {scale:g}: values {before[:3]} became {scaled[:3]}, with "
                f"homogeneity {declared}: ratios do not change, lengths may become areas: in 3-D the power "
                "of a length is one number between the declared one and twice that",
            )
        _require_unmoved(subject, case)
        _require_same_renumbered(subject, case, "entry i must belong to label i")


@law("metric")
def each_call_alone(subject: Subject) -> None:
    """What it measured before, on the same mesh or on one of that name, size or points, changes nothing."""
    case, others = far_from_each_other()
    mesh, labels = case.given
    stretched = replace(mesh, points=mesh.points * np.array([1.0, 1.5]))
    later = [
        replace(case, given=(mesh, frozen_int(labels[::-1]))),
        *(replace(each, given=(mesh, each.given[1])) for each in others),
        replace(case, given=(stretched, labels)),
        case,
        cells_renumbered(case),
        by_hand()[0],
        cells_renumbered(by_hand()[0]),
    ]
    tool = subject.build()
    plain(subject, tool, case)
    for each in later:
        require_close(
            plain(subject, tool, each), _values(subject, each), f"on {each.name}, after other questions",
            "keep nothing between calls: neither counts and points of a mesh nor its name say which it is",
            floor=rounding(subject, each, 1e-7),
        )  # fmt: skip


@law("metric", when=lambda subject: not getattr(subject.build(), "relative", False))
def far_parts_do_not_matter(subject: Subject) -> None:
    """The value of an agglomerate does not depend on others that are far away, unless it says relative."""
    case, others = far_from_each_other()
    before = _values(subject, case)[:6]
    for other in others:
        require_close(
            _values(subject, other)[:6], before, f"on {other.name}, at the other end",
            "a value that is compared with those of all parts, as diam(P) / h is, says relative = True", 1e-8,
            rounding(subject, case, 1e-8),
        )  # fmt: skip


@law("metric", when=lambda subject: not getattr(subject.build(), "directional", False))
def better_is_better(subject: Subject) -> None:
    """If equal squares have equal values, they are not the worst beside bars, zigzags and loose cells."""
    tool = subject.build()
    sign = 1.0 if tool.better == "high" else -1.0
    framings = (False,) if getattr(tool, "relative", False) else (False, True)
    found = [means for framed in framings if (means := _means(subject, framed))]
    worse = [_worst_of_all([sign * mean for mean in means]) for means in found]
    require(
        not worse or not all(worse),
        f"better is {tool.better!r}, yet the means of squares, bars, zigzags and loose cells are "
        f"{[[round(mean, 4) for mean in means] for means in found][:1]}: declare the other direction; if "
        "long parts are wanted along some direction, say directional = True",
    )


def _means(subject: Subject, framed: bool) -> list[float]:
    """Of squares, and of the other layouts if all their values are defined.

    None if equal squares differ: such a metric is of their place, and has no say about shapes.
    """
    squares, others = layouts(framed)
    found = [np.asarray(_values(subject, each)[:16], float) for each in (squares, *others)]
    if np.ptp(found[0]) > _ROUNDED * np.abs(found[0]).max():
        return []
    return [float(it.mean()) for it in found if np.isfinite(it).all()]


def _worst_of_all(means: list[float]) -> bool:
    """Whether none has a lower mean than the first, and two at least have a higher one."""
    squares, others = means[0], np.array(means[1:])
    slack = 1e-6 * max(map(abs, means))
    return bool(np.all(others >= squares - slack) and np.count_nonzero(others > squares + slack) > 1)


def _scaled_by(large: np.ndarray, before: np.ndarray, factor: float) -> bool:
    floor = 1e-6 * factor * float(np.nanmax(np.abs(before), initial=0.0)) + 1e-7 * factor
    return bool(np.allclose(large, before * factor, rtol=0.0, atol=floor, equal_nan=True))


def _require_unmoved(subject: Subject, case: Case) -> None:
    before = _values(subject, case)
    directional = getattr(subject.build(), "directional", False)
    for name, change in MOTIONS.items():
        if not (directional and (change.turned or change.mirror)):
            require_close(
                _values(subject, changed(case, change)[0]), before, f"on {case.name} {name}",
                "measure lengths and angles, not coordinates (or say directional = True if the axes are what "
                "it is about); mesh.local_points keeps digits far from 0", _ROUNDED,
                rounding(subject, case, 1e-5),
            )  # fmt: skip


def _require_same_renumbered(subject: Subject, case: Case, remedy: str) -> None:
    require_close(
        _values(subject, changed(case, None)[0]), _values(subject, case),
        f"on {case.name} with cells, faces, their two sides and points renumbered", remedy, _ROUNDED,
        rounding(subject, case, 1e-5),
    )  # fmt: skip
