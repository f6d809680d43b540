"""Means of part metrics over all ranks, from values computed on each rank."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from agglo_core.arrays import Float, Int
from agglo_core.distributed.mesh.distributed_mesh import DistributedMesh
from agglo_core.errors import OptionError
from agglo_core.measure.selection import Metric, build_metrics
from agglo_core.registry import Registry
from agglo_core.registry.attribution import Member, attributed
from agglo_core.shapes.metrics import UniformityFactor


def means(
    coarse: DistributedMesh, components: Int, metrics: Iterable[Metric], registry: Registry | None
) -> dict[str, float]:
    """Return the mean of each metric over all parts, or NaN where no part has a value.

    Parameters
    ----------
    coarse : DistributedMesh
    components : (n_own,) int
        Component count per own part.
    metrics, registry
        As for :func:`agglo_core.quality`.
    """
    ranks, largest = coarse.ranks, coarse.h
    with ranks.together():
        members = build_metrics(metrics, registry)
        for member in members.values():
            _refuse_unknown(member)
        part_values = {name: _values(coarse, member, largest) for name, member in members.items()}
        part_values["connected"] = (components == 1).astype(np.float64)
        defined = {name: values[~np.isnan(values)] for name, values in part_values.items()}
        sums = {name: (float(values.sum()), len(values)) for name, values in defined.items()}
    rank_sums = ranks.gathered(sums)
    result = {"max_diameter": largest}
    for name in part_values:
        total, count = map(sum, zip(*(record[name] for record in rank_sums), strict=True))
        result[name] = total / count if count else float("nan")
    return result


def _refuse_unknown(member: Member) -> None:
    if not getattr(member.tool, "shape_only", False):
        raise OptionError(f"{member.title} depends on the cells inside parts, which may span several ranks")
    if getattr(member.tool, "relative", False) and not isinstance(member.tool, UniformityFactor):
        raise OptionError(
            f"{member.title} compares parts that are on several ranks; across ranks only UF can"
        )


def _values(coarse: DistributedMesh, member: Member, largest: float) -> Float:
    """Return a metric of the parts on this rank. Relative metrics refer to the largest part on any rank."""
    local = coarse.local
    if not len(coarse.own):
        return np.empty(0)
    with attributed(member.title):
        values: Float = np.asarray(member.tool.measure(local, np.arange(local.n_cells)), float)[coarse.own]
    relative = isinstance(member.tool, UniformityFactor)
    return values * (local.cell_diameters.max() / largest) if relative else values
