"""Names of materials and patches go from file to file, into coarse meshes, rules and problems."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from agglo_core import Mesh, agglomerate, read, read_hierarchy, samples, write
from agglo_core.problems import Diffusion, read_problem

PLANE, SOLID = (".npz", ".vtu", ".vtkhdf", ".msh"), (".npz", ".vtu", ".vtkhdf", ".msh", ".foam")
TRIPS = [(a, b, dim) for dim, known in ((2, PLANE), (3, SOLID)) for a in known for b in known[1:3]]


def named(dim: int) -> Mesh:
    """Two materials, an inlet, and walls."""
    mesh = samples.triangles(6) if dim == 2 else samples.boxes(4)
    mesh = mesh.with_tags(rock=lambda x: x[:, 0] < 0.5, sand=lambda x: x[:, 0] > 0.5)
    outer = mesh.face_cells[:, 1] < 0
    inlet = np.isclose(mesh.face_centroids[:, 0], 0)
    return mesh.with_face_tags(inlet=inlet, walls=outer & ~inlet)


def area(mesh: Mesh, patch: str) -> float:
    return float(mesh.face_measures[mesh.face_tags[patch] == 1].sum())


@pytest.mark.parametrize(("first", "second", "dim"), TRIPS)
def test_names_go_through_files_and_levels(first: str, second: str, dim: int, tmp_path: Path) -> None:
    if ".vtkhdf" in (first, second):
        pytest.importorskip("h5py")
    mesh = named(dim)
    write(tmp_path / f"a{first}", mesh)
    once = read(tmp_path / f"a{first}")
    hierarchy = agglomerate(once, bisector="coordinate", n_parts=6, regions=("rock", "sand"), seed=0)
    write(tmp_path / f"b{second}", once, hierarchy)
    twice, levels = read_hierarchy(tmp_path / f"b{second}")
    assert levels is not None
    for each in (once, twice, levels.mesh(0), read(tmp_path / f"b_level0{second}")):
        for patch in ("inlet", "walls"):
            assert area(each, patch) == pytest.approx(area(mesh, patch), rel=1e-12)
        for tag in ("rock", "sand"):  # no part mixes them, so the tags are still there
            share = each.cell_measures[each.cell_tags[tag] == 1].sum()
            assert share == pytest.approx(0.5, rel=1e-12)


@pytest.mark.parametrize("suffix", [".npz", ".vtu", ".msh"])
def test_a_problem_says_patches_by_name(suffix: str, tmp_path: Path) -> None:
    mesh = named(2)
    number = np.where(mesh.face_tags["inlet"] == 1, 7, np.where(mesh.face_tags["walls"] == 1, 8, -1))
    write(tmp_path / f"m{suffix}", mesh.with_face_tags(side=number) if suffix != ".msh" else mesh)
    side = "side" if suffix != ".msh" else "gmsh:physical"
    lines = [f'boundary = "{side}"', "kappa = { rock = { rock = 2.0, 0 = 1.0 } }", "[dirichlet]"]
    text = "\n".join([*lines, "inlet = 2.0", "walls = 0.5", ""])
    (tmp_path / "p.toml").write_text(text)
    back = read(tmp_path / f"m{suffix}")
    problem = read_problem(tmp_path / "p.toml", back)
    assert isinstance(problem, Diffusion)
    tags = back.face_tags[side]
    pairs = (("inlet", 2.0), ("walls", 0.5))
    found = {value: np.unique(tags[back.face_tags[name] == 1]).tolist() for name, value in pairs}
    assert problem.dirichlet == {tag: value for value, (tag,) in found.items()}
    assert np.unique(np.asarray(problem.kappa)).tolist() == [1, 2]
