"""Correct samples, and samples that break one law first."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from conformance.mutants.mutant import Mutant

from agglo_core import Mesh
from agglo_core.conformance.inputs import small_meshes


def bars(n: int = 3, seed: int = 0) -> Mesh:
    """Return a bar with ``n`` cells and widths drawn from ``seed``."""
    x = np.concatenate(([0.0], np.cumsum(np.random.default_rng(seed).uniform(1, 2, n))))
    points = np.concatenate((np.stack((x, 0 * x), axis=1), np.stack((x, 0 * x + 1), axis=1)))
    i = np.arange(n)
    return Mesh.from_polygons(points, np.stack((i, i + 1, i + n + 2, i + n + 1), axis=1), name="bars")


def blocks() -> Mesh:
    """Return 3-D boxes."""
    return small_meshes.boxes()


def takes_anything(**options: int) -> Mesh:
    """Return a bar."""
    return bars()


def only_points(n: int = 3) -> object:
    """Return ``n`` points."""
    return np.zeros((n, 2))


def unannotated(n=3) -> Mesh:
    """Return a bar with ``n`` cells."""
    return bars(n)


def unexplained(many: int = 3) -> Mesh:
    """Return a bar."""
    return bars(many)


def flat() -> Mesh:
    """Return a bar."""
    return bars()


def unseeded(n: int = 3) -> Mesh:
    """Return a bar with ``n`` cells and new random widths in each call."""
    return bars(n, int(np.random.default_rng().integers(2**31)))


def unseeded_by_zero(n: int = 3, seed: int = 1) -> Mesh:
    """Return a bar with ``n`` cells, with new random widths in each call for the ``seed`` 0."""
    return bars(n, seed or int(np.random.default_rng().integers(2**31)))


def from_global_state(n: int = 3) -> Mesh:
    """Return a bar with ``n`` cells."""
    return bars(n, np.random.randint(1000))  # noqa: NPY002 - the bug


def talks(n: int = 3) -> Mesh:
    """Return a bar with ``n`` cells."""
    print("cells:", n)  # noqa: T201
    return bars(n)


def ignores_the_seed(seed: int = 0) -> Mesh:
    """Return a bar, whatever the ``seed``."""
    return bars(3)


def hashed() -> Mesh:
    """Return a bar with a tag by the hash of a name, which differs from process to process."""
    return replace(bars(3), cell_tags={"name": np.full(3, hash("name") % 2**31)})


def ignores_the_height(n: int = 3, height: float = 1.0) -> Mesh:
    """Return a bar with ``n`` cells and a ``height`` that only its name contains."""
    return replace(bars(n), name=f"bar of height {height}")


def clips(n: int = 3) -> Mesh:
    """Return a bar with ``n`` cells, but at most 8."""
    return bars(min(n, 8))


def cracked() -> Mesh:
    """Return two squares that have a side in common, but no points."""
    left = small_meshes.grid(1, 1)
    points = np.concatenate((left.points, left.points + np.array([1.0, 0.0])))
    return Mesh(
        points,
        np.arange(0, 17, 2),
        np.concatenate((left.face_vertices, left.face_vertices + 4)),
        np.concatenate((left.face_cells, np.where(left.face_cells < 0, -1, 1))),
    )


CORRECT = [(bars, {}), (blocks, {"3d": True})]

MUTANTS = [
    Mutant("builds", takes_anything, "name each option", kind="sample"),
    Mutant("sample_is_mesh", only_points, "from_polygons", kind="sample"),
    Mutant("options_explained", unannotated, "annotation", kind="sample"),
    Mutant("options_explained", unexplained, "docstring", kind="sample"),
    Mutant("options_matter", ignores_the_seed, "option seed", kind="sample"),
    Mutant("size_matters", clips, "more are expected", kind="sample"),
    Mutant("sample_is_mesh", cracked, "give each point one number", kind="sample"),
    Mutant("sample_in_space", flat, "drop the promise", {"3d": True}, kind="sample"),
    Mutant("options_matter", ignores_the_height, "option height", kind="sample"),
    Mutant("equal_options_equal_mesh", unseeded, "pass the seed", kind="sample"),
    Mutant("equal_options_equal_mesh", unseeded_by_zero, "even if it is 0", kind="sample"),
    Mutant("same_in_another_process", hashed, "hash() of a string", kind="sample"),
    Mutant("surroundings_kept", from_global_state, "default_rng", kind="sample"),
    Mutant("surroundings_kept", talks, "logging", kind="sample"),
]
