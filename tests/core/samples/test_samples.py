"""Samples: exact counts and areas, conformity, and agreement with the published grids where at hand."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from scipy.spatial import cKDTree

from agglo_core import Component, Registry, builtin, hookimpl, samples
from agglo_core.cli.options.specs import load_mesh
from agglo_core.errors import MeshError, OptionError, PluginError
from agglo_core.mesh import Mesh
from agglo_core.registry import default
from agglo_core.registry.construct import resolve
from agglo_core.registry.options import options_of

_PUBLISHED = Path(os.environ.get("AGGLO_PAPER_DATA", Path(__file__).parents[4] / "shared/data/paper"))


def _rebuilt_strictly(mesh: Mesh) -> Mesh:
    loops = mesh.boundary_loops
    return Mesh.from_polygons(mesh.points, (loops.loop_offsets, loops.vertices), strict=True)


@pytest.mark.parametrize(
    ("spec", "cells", "area"),
    [
        ("triangles:5", 50, 1.0),
        ("squares:n=5", 25, 1.0),
        ("random_triangles:n=40,seed=3", None, 1.0),
        ("voronoi:n=1", 1, 1.0),
        ("voronoi:n=2,seed=1", 2, 1.0),
        ("voronoi:n=300,seed=4", 300, 1.0),
        ("hexagons:4", 16, None),
        ("ring:n=3", 3, 0.75 * 1.5 * np.sin(2 * np.pi / 3)),
        ("ring:n=30", 90, 0.75 * 15 * np.sin(2 * np.pi / 30)),
        ("strip:7", 7, 1 / 7),
        ("disconnected:3", 18, 2.0),
    ],
)
def test_planar_samples_cover_their_domain_and_conform(
    spec: str, cells: int | None, area: float | None
) -> None:
    mesh = samples.from_spec(spec)
    assert mesh.dim == 2
    assert mesh.repairs == {}
    assert mesh.name
    assert cells is None or mesh.n_cells == cells
    assert area is None or mesh.cell_measures.sum() == pytest.approx(area, rel=1e-12)
    assert _rebuilt_strictly(mesh).n_cells == mesh.n_cells


def test_triangles_are_split_along_the_falling_diagonal() -> None:
    mesh = samples.triangles(3)
    ends = mesh.points[mesh.face_pairs]
    across = ends[:, 1] - ends[:, 0]
    slanted = across[(np.abs(across) > 1e-12).all(axis=1)]
    assert len(slanted) == 9
    np.testing.assert_allclose(slanted[:, 0], -slanted[:, 1])


def test_hexagons_are_regular_and_share_their_sides() -> None:
    mesh = samples.hexagons(4)
    np.testing.assert_allclose(mesh.face_measures, mesh.face_measures[0])
    np.testing.assert_allclose(mesh.cell_diameters, 2 * mesh.face_measures[0])
    assert (mesh.face_cells[:, 1] >= 0).sum() == 4 * 3 + 3 * 7  # along rows, between rows


def test_disconnected_has_two_components() -> None:
    assert samples.disconnected(4).graph.components().max() == 1


def test_voronoi_cells_hold_the_points_nearest_to_their_seed() -> None:
    n, seed = 4000, 5  # large enough for the short list of mirror images
    mesh = samples.voronoi(n, seed)
    seeds = np.random.default_rng(seed).random((n, 2))
    assert mesh.cell_measures.sum() == pytest.approx(1.0, rel=1e-12)
    assert mesh.points.min() == 0.0
    assert mesh.points.max() == 1.0
    owner, other = mesh.face_cells.T
    middle = mesh.points[mesh.face_pairs].mean(axis=1)
    own = np.linalg.norm(middle - seeds[owner], axis=1)
    inner = other >= 0
    np.testing.assert_allclose(np.linalg.norm(middle - seeds[other], axis=1)[inner], own[inner], atol=1e-9)
    np.testing.assert_allclose(cKDTree(seeds).query(middle)[0], own, atol=1e-9)


def test_random_samples_depend_on_their_seed_alone() -> None:
    for sample in (samples.voronoi, samples.random_triangles):
        assert sample(30, seed=1).fingerprint == sample(30, seed=1).fingerprint
        assert sample(30, seed=1).fingerprint != sample(30, seed=2).fingerprint


@pytest.mark.parametrize(("sample", "per_box"), [(samples.boxes, 1), (samples.tetrahedra, 6)])
def test_solids_fill_the_unit_cube_and_conform(sample, per_box: int) -> None:
    n = 3
    mesh = sample(n)
    assert mesh.dim == 3
    assert mesh.n_cells == per_box * n**3
    np.testing.assert_allclose(mesh.cell_measures, 1 / mesh.n_cells)
    outside = mesh.face_cells[:, 1] < 0
    assert mesh.face_measures[outside].sum() == pytest.approx(6.0)
    assert outside.sum() == 6 * n**2 * (1 if per_box == 1 else 2)


@pytest.mark.parametrize(
    ("name", "cells", "h0"),
    [("triangles", 128, 0.1768), ("squares", 256, 0.0884), ("random", 286, 0.3233), ("voronoi", 256, 0.1902)],
)
def test_paper_grids(name: str, cells: int, h0: float) -> None:
    mesh = samples.paper(name)
    assert mesh.n_cells == cells
    assert mesh.name == f"paper {name}"
    assert mesh.h == pytest.approx(h0, abs=5e-5)


@pytest.mark.parametrize(
    ("name", "file"),
    [("triangles", "tria"), ("squares", "quads"), ("random", "rand_tria"), ("voronoi", "rand_voro")],
)
def test_paper_grids_agree_with_the_published_ones(name: str, file: str) -> None:
    path = _PUBLISHED / f"{file}.npz"
    if not path.exists():
        pytest.skip(f"the authors' grids are not at {_PUBLISHED}")
    data = np.load(path)
    theirs = Mesh.from_polygons(data["points"], (data["cell_offsets"], data["cell_vertices"]))
    ours = samples.paper(name)
    distance, match = cKDTree(theirs.cell_centroids).query(ours.cell_centroids)
    assert np.array_equal(np.sort(match), np.arange(theirs.n_cells))
    assert distance.max() < 1e-9
    np.testing.assert_allclose(theirs.cell_measures[match], ours.cell_measures, atol=1e-9)


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("voronoy:n=3", "did you mean 'voronoi'"),
        ("squares", "needs a value for n"),
        ("squares:n=many", "n of sample 'squares' .* must be a whole number, given 'many'; squares takes n "),
        ("squares:n=", "takes n"),
        ("squares:n=0", ">= 1"),
        ("voronoi:n=5,sede=1", r"takes n \(a whole number\), seed \(a whole number, default 0\)"),
        ("voronoi:n=5,seed=-1", ">= 0"),
        ("voronoi:n=5,n=6", "cannot use"),
        ("paper:brain", "'triangles' or 'squares' or 'random' or 'voronoi', given 'brain'"),
    ],
)
def test_bad_specs_are_explained(spec: str, message: str) -> None:
    with pytest.raises(OptionError, match=message):
        samples.from_spec(spec)


def test_bad_sizes_are_refused() -> None:
    for size in (0, -1, 2.5, True, "3"):
        with pytest.raises(OptionError, match="squares must be a whole number"):
            samples.squares(size)  # type: ignore[arg-type]


def test_samples_that_exceed_the_memory_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("agglo_core.samples.regular._machine_memory", lambda: 1e6)
    assert samples.squares(61).n_cells == 61**2  # 61² cells of 200 B are just below three quarters of 1 MB
    assert samples.voronoi(4, seed=10**9).n_cells == 4  # the seed is no size
    for spec, need in (("squares:62", 0.000769), ("tetrahedra:7", 0.000926), ("voronoi3d:19", 0.00076)):
        with pytest.raises(OptionError, match=f"needs about {need} GB of memory, .* 0.001 GB, .* 75%"):
            samples.from_spec(spec)


def test_every_sample_is_listed() -> None:
    assert set(samples.names()) == set(samples.__all__) - {"names", "from_spec"}


# -- samples of strangers ----------------------------------------------------------------------


def plate(n: int, corner: Literal["sharp", "round"] = "sharp", holes: bool = False, name: str = "") -> Mesh:
    """Unit square of n × n squares."""
    mesh = samples.squares(n)
    return Mesh.from_polygons(
        mesh.points,
        (mesh.boundary_loops.loop_offsets, mesh.boundary_loops.vertices),
        name=f"{corner} {holes!r} {name!r}",
    )


def fails(how: Literal["key", "mesh", "exit"]) -> Mesh:
    """Does not make a mesh."""
    raise {"key": KeyError("x"), "mesh": MeshError("cell 3"), "exit": SystemExit(1)}[how]


def no_mesh() -> Any:
    """Makes a graph."""
    return samples.squares(2).graph


class Strangers:
    @hookimpl
    def agglo_components(self) -> list[Component]:
        own = [Component("sample", each.__name__, f"{__name__}:{each.__name__}") for each in (plate, fails)]
        return [
            *own,
            Component("sample", "no_mesh", f"{__name__}:no_mesh"),
            Component("sample", "squares", f"{__name__}:plate"),
            Component("sample", "needy", f"{__name__}:plate", requires=("no_such_thing",)),
        ]


@pytest.fixture
def registry() -> Registry:
    registry = Registry()
    registry.register(Strangers(), "mine", distribution="my-dist", version="2")
    registry.register(builtin, "defaults", distribution="agglo", version="1")
    return registry


@pytest.mark.parametrize(
    ("spec", "name"),
    [
        ("plate:2", "sharp False ''"),
        ("plate:n=2,corner=round,holes=true", "round True ''"),
        ("plate: 2 , name = 007", "sharp False '007'"),
        ("plate:2,name=a=b", "sharp False 'a=b'"),
        ("mine/plate:2,name=true", "sharp False 'true'"),
        ("mine/squares:2", "sharp False ''"),
        ("squares:2", "squares 2x2"),
    ],
)
def test_a_strangers_sample_takes_its_options(registry: Registry, spec: str, name: str) -> None:
    mesh = samples.from_spec(spec, registry)
    assert mesh.n_cells == 4
    assert mesh.name == name


@pytest.mark.parametrize(
    ("spec", "error", "message"),
    [
        ("plate:2,corner=blunt", OptionError, "must be 'sharp' or 'round', given 'blunt'; plate"),
        ("plate:2,holes=1", OptionError, r"holes of sample 'plate' .* must be true or false, given 1"),
        ("plate:2,4", OptionError, r"cannot use '4' in sample 'plate:2,4': .*; plate takes n \("),
        ("plate:=2", OptionError, "cannot use '=2'"),
        ("plat:2", OptionError, r"is named 'plat' \(did you mean 'plate'\?\); available: boxes, "),
        ("other/plate:2", OptionError, "no sample is named 'other/plate'"),
        ("fails:key", PluginError, r"'fails' \(plugin 'mine', distribution my-dist 2\) .* KeyError: 'x'"),
        ("fails:exit", PluginError, "SystemExit"),
        ("fails:mesh", MeshError, "^cell 3$"),
        ("no_mesh:2", OptionError, "cannot use '2' in sample 'no_mesh:2': .*; no_mesh takes no options"),
        ("no_mesh", PluginError, r"sample 'no_mesh' \(plugin 'mine', .*\) returned Graph.*, expected a Mesh"),
        ("needy:2", PluginError, "'needy' .* cannot be used: needs no_such_thing"),
    ],
)  # fmt: skip
def test_what_a_strangers_sample_refuses(registry: Registry, spec: str, error: type, message: str) -> None:
    with pytest.raises(error, match=message):
        samples.from_spec(spec, registry)


def test_only_samples_that_can_be_used_are_listed(registry: Registry) -> None:
    assert samples.names(registry) == [*samples.names(), "plate", "fails", "no_mesh"]
    assert samples.names()[:4] == ["triangles", "squares", "random_triangles", "voronoi"]
    registry.block("defaults", "not today")
    assert samples.names(registry) == ["plate", "fails", "no_mesh", "squares"]
    with pytest.raises(PluginError, match=r"sample 'voronoi' .* cannot be used: blocked: not today"):
        samples.from_spec("voronoi:3", registry)


@pytest.mark.parametrize("name", samples.names())
def test_every_option_is_typed_and_explained(name: str) -> None:
    for option in options_of(resolve(default().record("sample", name))) or ():
        assert option.about
        assert option.type_name != "any"


def test_qualified_names_can_be_typed() -> None:
    assert load_mesh("defaults/squares:3").n_cells == 9
    with pytest.raises(OptionError, match="no sample is named 'image'"):
        load_mesh("image:file=folder/a.png")  # a value may be a path
    with pytest.raises(
        OptionError, match=r"'meshes/plate' is neither an existing file nor a sample: no sample"
    ):
        load_mesh("meshes/plate")
