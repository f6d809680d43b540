"""Results do not depend on the number of threads; errors and stops reach the caller; no thread is left."""

from __future__ import annotations

import multiprocessing
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest
from click.testing import CliRunner

import agglo_core as agglo
from agglo_core import Mesh, samples
from agglo_core.arrays import frozen_int
from agglo_core.cli.options.shared import threads_option
from agglo_core.graph.connection import parts_connected
from agglo_core.measure import measure_levels
from agglo_core.mesh.counting_sort import counting_sort
from agglo_core.threads import (
    _thread_pools,
    mapped,
    one_blas_thread,
    over_ranges,
    ranges,
    thread_count,
    using_threads,
)

COUNTS = (2, 3, 5)
PLANE = ("UF", "CR", "CRc", "isoperimetric", "convexity", "star_shapedness", "box_ratio", "edge_ratio")
EVERYWHERE = ("components", "cells", "cut", "interface")


@cache
def loops(name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Plane meshes as arrays: points, offsets and vertices of the cells."""
    mesh = {
        "voronoi": lambda: samples.voronoi(700, seed=3),
        "triangles": lambda: samples.random_triangles(300, seed=5),
        "squares": lambda: samples.squares(23),
    }[name]()
    made = mesh.boundary_loops
    return mesh.points, made.loop_offsets, made.vertices


def everything(name: str, folder: Path) -> dict[str, Any]:
    """What the chain from arrays to files finds on the way."""
    points, offsets, vertices = loops(name)
    mesh = Mesh.from_polygons(points, (offsets, vertices))
    graph = mesh.graph
    hierarchy = agglo.agglomerate(mesh, n_parts=(60, 12))
    measured = measure_levels(mesh, hierarchy, metrics=(*PLANE, *EVERYWHERE))
    agglo.write(str(folder / "out.vtu"), mesh, hierarchy)
    found = {
        "faces": (mesh.face_vertices, mesh.face_cells, *mesh.cell_faces),
        "cells": (mesh.cell_measures, mesh.cell_centroids, mesh.cell_diameters, *mesh.cell_vertices),
        "loops": tuple(mesh.boundary_loops),
        "graph": (graph.indptr, graph.indices, graph.interface, graph.boundary),
        "files": tuple(np.fromfile(file, np.uint8) for file in sorted(folder.iterdir())),
    }
    for place, level in enumerate(measured):
        found[f"labels {place}"] = (level.labels,)
        found |= {f"{key} {place}": (values,) for key, values in level.values.items()}
        found[f"coarse {place}"] = (level.mesh.face_cells, *level.mesh.boundary_loops)
    return found


@pytest.mark.parametrize("name", ["voronoi", "triangles", "squares"])
def test_the_chain_gives_the_same_bits_with_any_number_of_threads(name: str, tmp_path: Path) -> None:
    wanted = everything(name, tmp_path)
    for count in COUNTS:
        folder = tmp_path / str(count)
        folder.mkdir()
        with using_threads(count, few=1):
            found = everything(name, folder)
        for key, arrays in wanted.items():
            assert len(arrays) == len(found[key])
            for one, other in zip(arrays, found[key], strict=True):
                assert one.tobytes() == other.tobytes(), key


@pytest.mark.parametrize("count", COUNTS)
def test_cells_that_share_many_faces_have_the_same_neighbours(count: int) -> None:
    """Rows of the graph are shorter than those of half-edges: gaps between ranges are closed."""
    fine = samples.voronoi(1300, seed=2)
    labels = frozen_int(np.unique(np.random.default_rng(0).integers(0, 40, 1300), return_inverse=True)[1])
    wanted = fine.coarsen(labels).cell_neighbours
    with using_threads(count, few=1):
        found = fine.coarsen(labels).cell_neighbours
    assert all(map(np.array_equal, wanted, found))


def test_solids_have_the_same_bits() -> None:
    def found() -> list[np.ndarray]:
        mesh = samples.tetrahedra(4)
        made = [mesh.cell_measures, mesh.cell_diameters, mesh.graph.interface, *mesh.cell_faces]
        return [*made, agglo.agglomerate(mesh, n_parts=9).levels[0]]

    wanted = found()
    for count in COUNTS:
        with using_threads(count, few=1):
            assert all(map(np.array_equal, wanted, found()))


def test_bad_polygons_are_named_as_by_one_thread() -> None:
    points, offsets, vertices = loops("squares")
    wrong = vertices.copy()
    start = offsets[400]
    wrong[start + 1], wrong[start + 2] = vertices[start + 2], vertices[start + 1]
    with using_threads(3, few=1), pytest.raises(agglo.MeshError, match="cell 400: a boundary that crosses"):
        Mesh.from_polygons(points, (offsets, wrong))


def test_ranges_cover_all_items_once() -> None:
    assert ranges(100_000) == [(0, 100_000)]  # one thread
    for count in (2, 3, 7):
        with using_threads(count):
            assert ranges(39_999) == [(0, 39_999)]
            assert len(ranges(10**7)) == 4 * count
            assert len(ranges(10**7, shares=1)) == count
            for n in (0, 1, 40_000, 123_457):
                spans = ranges(n)
                assert spans[0][0] == 0
                assert spans[-1][1] == n
                assert [stop for _, stop in spans[:-1]] == [start for start, _ in spans[1:]]


def test_items_are_sorted_as_a_stable_sort_does() -> None:
    rows = np.random.default_rng(0).integers(0, 9, 500)
    order = np.empty(500, np.int64)

    def put(start: int, stop: int, places: np.ndarray, only_count: bool) -> None:
        for item in range(start, stop):
            if not only_count:
                order[places[rows[item]]] = item
            places[rows[item]] += 1

    for count in (1, *COUNTS):
        with using_threads(count, few=10):
            offsets = counting_sort(put, 500, 9)
        assert np.array_equal(order, np.argsort(rows, kind="stable"))
        assert np.array_equal(offsets, np.concatenate(([0], np.cumsum(np.bincount(rows)))))


@pytest.mark.parametrize("seed", range(6))
def test_connected_parts_are_known_from_any_ranges(seed: int) -> None:
    """Random numbering: most edges lead from one range to another."""
    rng, mesh = np.random.default_rng(seed), samples.voronoi(200, seed=seed)
    order = rng.permutation(mesh.n_cells)
    graph = mesh.graph.subgraph(order, [0, mesh.n_cells])
    near = np.linalg.norm(mesh.cell_centroids[order][:, None] - rng.random((9, 2)), axis=2).argmin(axis=1)
    whole = graph.components(frozen_int(near))
    broken = whole.copy()
    broken[rng.integers(200)] = rng.integers(whole.max() + 1)
    for labels in (whole, frozen_int(broken), frozen_int(np.zeros(200))):
        wanted = len(np.unique(graph.components(labels))) == len(np.unique(labels))
        for count in (1, *COUNTS):
            with using_threads(count, few=1):
                assert parts_connected(graph.indptr, graph.indices, labels) == wanted


def test_calls_run_at_the_same_time_and_see_one_thread() -> None:
    both = threading.Barrier(2, timeout=20)

    def call(item: int) -> tuple[int, int]:
        both.wait()
        return item, thread_count()

    with using_threads(2):
        assert list(mapped(call, [1, 2])) == [(1, 1), (2, 1)]


def failing(started: list[int]) -> Callable[[int, int], int]:
    """A call that fails on the second of its ranges."""

    def call(start: int, stop: int) -> int:
        started.append(start)
        if start == 10:
            raise ZeroDivisionError(f"at {start}")
        return stop

    return call


@pytest.mark.parametrize("count", [1, 2, 5])
def test_an_exception_in_a_range_reaches_the_caller(count: int) -> None:
    before, started = threading.active_count(), list[int]()
    with using_threads(count, few=10):
        n = 40 * count if count > 1 else 0
        with pytest.raises(ZeroDivisionError, match="at 10"):
            over_ranges(failing(started), n) if n else list(mapped(failing(started), [0, 10], [10, 20]))
    assert 10 in started
    assert threading.active_count() == before


def test_no_thread_and_no_waiting_call_outlives_a_caller_who_stops() -> None:
    before, done = threading.active_count(), list[int]()
    with using_threads(2):
        calls = mapped(done.append, range(2_000))
        next(calls)
        calls.close()  # type: ignore[attr-defined]
    assert threading.active_count() == before
    assert len(done) < 2_000


def test_a_listener_may_stop_a_run_in_several_threads() -> None:
    def listen(now: Any) -> None:
        if now.phase == "agglomerating" and now.fraction and now.fraction > 0.1:
            raise KeyboardInterrupt

    before = threading.active_count()
    with pytest.raises(KeyboardInterrupt):
        agglo.agglomerate(samples.squares(280), h_factor=4.0, progress=listen, threads=2)
    assert threading.active_count() == before


@pytest.mark.parametrize(("typed", "wanted"), [([], 1), (["--threads", "3"], 3)])
def test_a_command_uses_the_given_number_of_threads(typed: list[str], wanted: int) -> None:
    @click.command()
    @threads_option
    def count() -> None:
        click.echo(thread_count())

    assert CliRunner().invoke(count, typed).output == f"{wanted}\n"
    assert thread_count() == 1
    assert CliRunner().invoke(count, ["--threads", "0"]).exit_code == 2


def labels_of(seed: int) -> list[int]:
    """A run in two threads, for other threads and processes."""
    with using_threads(2, few=1):
        mesh = samples.voronoi(300, seed=seed)
        labels = agglo.agglomerate(mesh, n_parts=20).levels[0]
        agglo.quality(mesh, labels, threads=2)
    return labels.tolist()


def test_threads_and_forks_of_the_user_may_use_threads() -> None:
    wanted = [labels_of(seed) for seed in range(4)]
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(labels_of, range(4))) == wanted
    if "fork" in multiprocessing.get_all_start_methods():
        with multiprocessing.get_context("fork").Pool(2) as workers:
            assert workers.map_async(labels_of, range(4)).get(timeout=60) == wanted


def test_blas_uses_one_thread_in_its_context() -> None:
    threadpoolctl = pytest.importorskip("threadpoolctl")

    def counts() -> set[int]:
        return {pool["num_threads"] for pool in threadpoolctl.threadpool_info() if pool["user_api"] == "blas"}

    with threadpoolctl.threadpool_limits(3, user_api="blas"):
        with one_blas_thread():
            with one_blas_thread():
                pass
            assert counts() == {1}
        assert counts() == {3}


def test_blas_is_left_alone_without_threadpoolctl(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "threadpoolctl", None)
    monkeypatch.setattr("agglo_core.threads._thread_pools", cache(_thread_pools.__wrapped__))
    with one_blas_thread():
        assert np.linalg.inv(np.eye(2)).tolist() == [[1.0, 0.0], [0.0, 1.0]]
