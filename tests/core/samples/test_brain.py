"""The shipped brain sections: what they are made of, and that they are as hard as they should be."""

from __future__ import annotations

from importlib.resources import files

import numpy as np
import pytest
import shapely

from agglo_core import Mesh, agglomerate, quality, samples
from agglo_core.arrays import Float, Int

DATA = files("agglo_core.samples") / "data"
BRAINS = ("brain", "brain_holes")


def shipped(name: str) -> tuple[Float, Int]:
    """Points and triangles as the file holds them."""
    with (DATA / f"{name}.npz").open("rb") as file, np.load(file, allow_pickle=False) as data:
        return data["points"].astype(np.float64), data["triangles"].astype(np.int64)


def outline(name: str) -> shapely.Polygon:
    """Union of the triangles by shapely, which must be one polygon."""
    points, triangles = shipped(name)
    region = shapely.union_all(shapely.polygons(points[triangles]))
    assert isinstance(region, shapely.Polygon)
    return region


@pytest.mark.parametrize(("name", "cells", "holes"), [("brain", 13_978, 0), ("brain_holes", 13_327, 5)])
def test_brain_is_one_valid_piece(name: str, cells: int, holes: int) -> None:
    mesh, region = samples.from_spec(name), outline(name)
    assert (mesh.name, mesh.dim, mesh.n_cells, dict(mesh.repairs)) == (name, 2, cells, {})
    assert mesh.n_points - mesh.n_faces + mesh.n_cells == 1 - holes == 1 - len(region.interiors)
    assert mesh.graph.components().max() == 0
    assert region.is_valid
    assert mesh.cell_measures.sum() == pytest.approx(region.area, rel=1e-12)
    whole = mesh.coarsen(np.zeros(cells, np.int64))
    assert len(whole.boundary_loops.loop_offsets) == 2 + holes
    assert whole.h == pytest.approx(147.95, abs=0.01)


@pytest.mark.parametrize("name", BRAINS)
def test_brain_passes_the_strictest_reading(name: str) -> None:
    points, triangles = shipped(name)
    assert len(np.unique(triangles)) == len(points)
    assert not Mesh.from_polygons(points, triangles, strict=True).repairs


@pytest.mark.parametrize("name", BRAINS)
def test_brain_triangles_are_well_shaped_and_alike(name: str) -> None:
    points, triangles = shipped(name)
    corners = points[triangles]
    sides = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    area = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 2
    longest = np.sort(sides, axis=1)
    sine = 2 * area / (longest[:, 1] * longest[:, 2])
    assert np.degrees(np.arcsin(sine)).min() > 25
    assert area.max() < 5 * area.min()


def test_holes_lie_inside_the_same_outline() -> None:
    plain, pierced = outline("brain"), outline("brain_holes")
    assert shapely.Polygon(pierced.exterior).symmetric_difference(plain).area < 1e-9 * plain.area
    assert all(shapely.Polygon(ring).area > 20 for ring in pierced.interiors)


@pytest.mark.parametrize("name", BRAINS)
def test_brain_is_strongly_non_convex_with_narrow_passages(name: str) -> None:
    region = outline(name)
    assert region.area < 0.82 * region.convex_hull.area
    assert 4 * np.pi * region.area / region.length**2 < 0.12  # a disc has 1
    assert len(shapely.get_parts(region.buffer(-4))) >= 3  # passages narrower than 8 mm


@pytest.mark.parametrize("name", BRAINS)
def test_brain_agglomerates_into_connected_parts_of_the_target_size(name: str) -> None:
    mesh = samples.from_spec(name)
    target = 0.2 * 147.95
    labels = agglomerate(mesh, bisector="coordinate", h_star=target).levels[0]
    coarse = mesh.coarsen(labels)
    assert coarse.h <= target
    assert quality(mesh, labels, metrics=("components",))["components"].max() == 1
    assert 30 < coarse.n_cells < 80
    assert coarse.cell_measures.sum() == pytest.approx(mesh.cell_measures.sum(), rel=1e-12)


def test_data_are_small_and_carry_the_notice_of_the_template() -> None:
    assert all(len((DATA / f"{name}.npz").read_bytes()) < 250_000 for name in BRAINS)
    assert len((DATA / "brain3d.npz").read_bytes()) < 40_000
    notice = (DATA / "NOTICE.txt").read_text()
    assert "Louis Collins" in notice
    assert "provided that the above copyright notice appear in all copies" in notice
