"""Slow and simple checks of the rules for parts, and random rules to test."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from agglo_core import samples

__all__ = ["MODES", "broken_promises", "random_rules"]

MODES = {
    "recursive": {},
    "not nested": {"nested": False},
    "merged": {"merge": True},
    "as grown": {"polish": False},
    "polished by blocks": {"post_refiners": ["interface"]},
    "k-way": {"method": "kway"},
    "k-way, not nested": {"method": "kway", "nested": False},
    "k-way, merged": {"method": "kway", "merge": True},
    "metis": {"bisector": "metis", "method": "kway"},
    "inertial": {"bisector": "inertial"},
    "depth by depth": {"bisector": "sweep", "refiners": ("fm",)},
    "coordinate": {"bisector": "coordinate", "refiners": ()},
    "spectral": {"bisector": "spectral"},
    "gnn": {"bisector": "gnn"},
}
MESHES = [
    samples.voronoi(60, seed=1),
    samples.squares(7),
    samples.disconnected(5),
    samples.random_triangles(40, seed=2),
    samples.boxes(4),
    samples.tetrahedra(2),
]


@st.composite
def random_rules(draw):
    """Draw a mesh, the keywords of a run, and a set of rules."""
    mesh = draw(st.sampled_from(MESHES))
    rng = np.random.default_rng(draw(st.integers(0, 10**6)))
    mode = dict(MODES[draw(st.sampled_from(sorted(MODES)))])
    if mode.get("bisector") == "gnn" and mesh.dim == 3:
        mode["bisector"] = "kmeans"  # the network is 2-D only
    # Draw up to three rules; a maximum weight needs weights.
    rules = {}
    for name in draw(st.sets(st.sampled_from(sorted(MAKERS)), max_size=3)):
        rules[name] = MAKERS[name](mesh, rng)
    if "max_weight" in rules:
        rules.setdefault("weights", MAKERS["weights"](mesh, rng))
    # Draw the targets of the levels.
    kind = draw(st.sampled_from(["n_parts", "cells_per_part", "h_factor"]))
    if kind == "cells_per_part":
        mode.pop("merge", None)
        target = {kind: tuple(draw(st.lists(st.floats(1, 40), min_size=1, max_size=3)))}
    elif kind == "n_parts":
        mode.pop("merge", None)
        counts = st.lists(st.integers(max(1, mesh.n_cells // 6), mesh.n_cells), min_size=1, max_size=3)
        target = {kind: tuple(draw(counts))}
    else:
        if "max_weight" not in rules:
            rules.pop("weights", None)
        target = {kind: tuple(draw(st.lists(st.floats(0.7, 9), min_size=1, max_size=3)))}
    return mesh, {**mode, **target}, rules


def _regions(mesh, rng):
    """Return labels of half-spaces, like materials, or random labels."""
    if rng.random() < 0.3:
        return rng.integers(0, 3, mesh.n_cells)
    return (mesh.cell_centroids @ rng.normal(size=mesh.dim) > rng.normal() * 0.3).astype(int)


def _barriers(mesh, rng):
    """Return faces near part of a random plane, or random faces."""
    if rng.random() < 0.3:
        return rng.random(mesh.n_faces) < 0.05
    side = (mesh.cell_centroids - 0.5) @ rng.normal(size=mesh.dim) > 0
    one, other = mesh.face_cells.T
    across = (other >= 0) & (side[one] != side[other])
    return across & (mesh.cell_centroids[one, 0] < rng.random())


MAKERS = {
    "regions": _regions,
    "barriers": _barriers,
    "where": lambda mesh, rng: rng.random(mesh.n_cells) < rng.choice([0.3, 0.8, 0.97]),
    "weights": lambda mesh, rng: rng.choice([0.0, 1.0, 10.0], mesh.n_cells),
    "max_cells": lambda mesh, rng: int(rng.integers(1, 12)),
    "min_cells": lambda mesh, rng: int(rng.integers(1, 2)),
    "max_measure": lambda mesh, rng: float(mesh.cell_measures.sum() * rng.uniform(0.02, 0.3)),
    "max_weight": lambda mesh, rng: float(rng.integers(1, 30)),
}


def broken_promises(mesh, hierarchy, rules):
    """Yield descriptions of all violated rules of a hierarchy."""
    # Pairs of cells that share a face, and pairs across barriers.
    one, other = mesh.face_cells[mesh.face_cells[:, 1] >= 0].T
    cut = np.zeros(mesh.n_faces, bool) | rules.get("barriers", False)
    cut = cut[mesh.face_cells[:, 1] >= 0]
    fenced = [tuple(sorted(pair)) for pair in zip(one[cut], other[cut], strict=True)]
    for labels, target in zip(hierarchy.levels, hierarchy.targets, strict=True):
        k = labels.max() + 1
        sizes = np.bincount(labels)
        # Rules of each level: regions, barriers, single cells, sizes, connectivity, target.
        joined = [pair for pair in zip(one, other, strict=True) if tuple(sorted(pair)) not in set(fenced)]
        if "regions" in rules:
            if any(len(set(rules["regions"][labels == part])) > 1 for part in range(k)):
                yield "a part holds two regions"
            joined = [(i, j) for i, j in joined if rules["regions"][i] == rules["regions"][j]]
        if any(labels[i] == labels[j] for i, j in fenced):
            yield "a part lies on both sides of a barrier"
        if "where" in rules and (sizes[labels[~rules["where"]]] > 1).any():
            yield "a cell that should be alone is not"
        if sizes.max() > max(rules.get("max_cells", np.inf), 1):
            yield "a part has too many cells"
        measures = np.bincount(labels, mesh.cell_measures)
        if (measures[sizes > 1] > rules.get("max_measure", np.inf) * (1 + 1e-9)).any():
            yield "a part is too large"
        weights = np.bincount(labels, rules.get("weights"))
        if (weights[sizes > 1] > rules.get("max_weight", np.inf) * (1 + 1e-9)).any():
            yield "a part is too heavy"
        if _components(labels, joined) != k:
            yield "a part is not connected, but across what it may not be"
        if target.get("n_parts", k) != k:
            yield f"{k} parts in place of {target['n_parts']}"
        if "h_star" in target:
            wide = mesh.graph.part_diameters(labels) > target["h_star"] * (1 + 1e-9)
            if (sizes[wide] > 1).any():
                yield "a part is too wide"
    # Nested levels.
    if hierarchy.nested:
        for fine, coarse in zip(hierarchy.levels, hierarchy.levels[1:], strict=False):
            if len(set(zip(fine, coarse, strict=True))) > fine.max() + 1:
                yield "levels are not nested"


def _components(labels, pairs):
    """Return the number of components of all parts, with cells joined by the given pairs (union-find)."""
    root = list(range(len(labels)))

    def find(i):
        while root[i] != i:
            root[i] = root[root[i]]
            i = root[i]
        return i

    for i, j in pairs:
        if labels[i] == labels[j]:
            root[find(i)] = find(j)
    return sum(root[i] == i for i in range(len(labels)))
