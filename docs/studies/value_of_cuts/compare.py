"""Compare part counts and CPU times of runs by size with trained value functions and with other methods."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np

import agglo_core as agglo
from agglo_core import Mesh, samples
from agglo_core.authoring import Float
from value_of_cuts.cuts import Network, ValueBisector

OTHERS: Final[Mapping[str, Mapping[str, Any]]] = {
    "`kmeans`": {},
    "`sweep`": {"bisector": "sweep"},
    "`gnn`": {"bisector": "gnn"},
    "k-way": {"method": "kway"},
}
"""Options of the other methods, all merged. The first is the base."""
OCTAVE: Final = (0.71, 0.84, 1.0, 1.19)


def star(seed: int) -> Mesh:
    """Return the Voronoi cells within a star with a smooth random outline."""
    mesh = samples.voronoi(8000, seed)
    x, y = (mesh.cell_centroids - 0.5).T
    angle, phases = np.arctan2(y, x), np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, 3)
    waves = zip((0.10, 0.07, 0.05), (2, 3, 5), phases, strict=True)
    radius = 0.3 + sum(size * np.cos(count * angle + phase) for size, count, phase in waves)
    inside = np.flatnonzero(np.hypot(x, y) < radius)
    return Mesh.from_polygons(mesh.points, [mesh.cells[int(i)] for i in inside])


def agglomerates(seed: int) -> Mesh:
    """Return polyhedra of about 6 tetrahedra each."""
    return agglo.agglomerate(samples.random_tetrahedra(2600, seed), cells_per_part=6).mesh(0)


FAMILIES: Final[Mapping[int, Mapping[str, tuple[Callable[[int], Mesh], float]]]] = {
    2: {
        "Voronoi": (lambda seed: samples.voronoi(4000, seed), 0.2),
        "triangles": (lambda seed: samples.random_triangles(2000, seed), 0.2),
        "stars": (star, 0.2),
        "brain (one mesh)": (lambda seed: samples.brain(), 18.0),
    },
    3: {
        "tetrahedra": (lambda seed: samples.random_tetrahedra(700, seed), 0.4),
        "Voronoi": (lambda seed: samples.voronoi3d(2500, seed), 0.4),
        "hexahedra": (lambda seed: samples.boxes(10 + seed % 12), 0.4),
        "agglomerates": (agglomerates, 0.48),
    },
}
"""Meshes by seed, and the middle of four sizes h* over an octave, by dimension."""


def run(mesh: Mesh, h_star: float, options: Mapping[str, Any]) -> tuple[float, float]:
    """Return the part count and CPU seconds of one level. With a value function, only the cuts are timed."""
    start = time.process_time()
    labels = agglo.agglomerate(mesh, h_star=h_star, merge=True, **options).levels[0]
    seconds, tool = time.process_time() - start, options.get("bisector")
    if isinstance(tool, ValueBisector):
        seconds = sum(tool.seconds)
    return float(labels.max() + 1), seconds


def ratios(family: tuple[Callable[[int], Mesh], float], networks: Sequence[Network], seeds: range) -> Float:
    """Return counts and seconds over those of the base: an array (meshes, sizes, methods, 2)."""
    make, size = family

    def methods() -> list[Mapping[str, Any]]:
        return [*OTHERS.values(), *({"bisector": ValueBisector(each)} for each in networks)]

    found = []
    for seed in seeds:
        mesh = make(seed)
        if seed == seeds[0]:
            for options in methods():
                run(mesh, 2.0 * size, options)  # compiles
        found.append([[run(mesh, f * size, options) for options in methods()] for f in OCTAVE])
    array = np.array(found)
    return np.asarray(array / array[:, :, :1])


def shown(values: Float) -> str:
    """Format the mean and its standard error over meshes, from an array that begins with meshes."""
    means = values.reshape(len(values), -1).mean(axis=1)
    error = f" ± {means.std(ddof=1) / np.sqrt(len(means)):.3f}" if len(means) > 1 else ""
    return f"{means.mean():.3f}{error}"


def table(networks: Sequence[Network], meshes: int, seed: int) -> str:
    """Return the rows of the table of both measures for all families, in Markdown."""
    dim = 2 if len(networks[0].w1) == 12 else 3
    head, others = [f"{meshes} meshes × 4 sizes, over `kmeans`; all merged"], list(OTHERS)[1:]
    titles = [f"{name}: parts, time" for name in others]
    titles += ["value function: parts", "least and most of the training seeds", "time of the cuts alone"]
    rows = [[title] for title in titles]
    for name, family in FAMILIES[dim].items():
        found = ratios(family, networks, range(seed, seed + (1 if "one mesh" in name else meshes)))
        parts, seconds = found[..., 0], found[..., 1]
        head.append(name)
        for row, k in zip(rows, range(1, len(OTHERS)), strict=False):
            row.append(f"{shown(parts[:, :, k])}, {np.median(seconds[:, :, k]):.1f}")
        trained = parts[:, :, len(OTHERS) :]
        means = trained.mean(axis=(0, 1))
        rows[-3].append(shown(trained))
        rows[-2].append(f"{means.min():.3f}, {means.max():.3f}")
        rows[-1].append(f"{np.median(seconds[:, :, len(OTHERS) :]):.1f}")
    return "\n".join(f"| {' | '.join(each)} |" for each in (head, ["---"] * len(head), *rows))
