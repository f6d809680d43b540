"""``plot`` of meshes, hierarchies, solutions and samples: axes come back, colours mean what they say."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from agglo_core import agglomerate, samples
from agglo_core.draw.colours import by_number, by_tag
from agglo_core.errors import MeshError, OptionError, PluginError
from agglo_core.hierarchy import Hierarchy
from agglo_core.measure import quality
from agglo_core.mesh import Mesh
from agglo_core.problems import Diffusion, Linear, Samples, Solution
from agglo_core.registry import default

matplotlib = pytest.importorskip("matplotlib")
from matplotlib import pyplot as plt  # noqa: E402

SQUARES = samples.squares(4)
CUBES = samples.boxes(3)
SOLUTION = Solution(
    np.ones(2), np.eye(2), np.ones(2), [], np.array([2.0, 0.2, 0.02]), True, "done", 2, {}, tolerance=0.01
)
TRIANGLE = Samples(
    np.zeros(3, int), np.array([[0.0, 0], [1, 0], [0, 1]]), np.array([[0, 1, 2]]), np.arange(3.0)
)
TETRAHEDRON = Samples(
    np.zeros(4, int), np.vstack((np.zeros(3), np.eye(3))), np.arange(4)[None], np.array([0.0, 1, 2, 3])
)


@pytest.fixture(autouse=True)
def _no_figure_stays_open() -> Iterator[None]:
    plt.switch_backend("Agg")
    yield
    plt.close("all")


def halves(mesh: Mesh) -> Hierarchy:
    labels = (mesh.local_centroids[:, 0] > 0).astype(int)
    return Hierarchy(mesh, mesh.graph, [labels], [{}], nested=True)


def pixels(ax: Any, x: float, y: float) -> tuple[int, ...]:
    """Red, green and blue at a point of the axes."""
    ax.figure.canvas.draw()
    picture = np.asarray(ax.figure.canvas.buffer_rgba())
    column, row = ax.transData.transform((x, y)).astype(int)
    return tuple(int(each) for each in picture[picture.shape[0] - 1 - row, column, :3])


def solved(mesh: Mesh) -> Solution:
    """u = x, which every method reproduces."""
    problem = Diffusion(source=0.0, dirichlet={0: lambda points: points[:, 0]})
    solver: Any = default().build("solver", "direct", degree=1)
    found: Solution = solver.solve(problem, halves(mesh))
    return found


PLOTS: list[Callable[[Any], Any]] = [
    SQUARES.plot,
    CUBES.plot,
    lambda ax: halves(SQUARES).plot(0, ax),
    lambda ax: halves(CUBES).plot(0, ax),
    lambda ax: SOLUTION.plot(ax, convergence=True),
    lambda ax: solved(SQUARES).plot(ax),
    lambda ax: solved(CUBES).plot(ax),
    TRIANGLE.plot,
    TETRAHEDRON.plot,
]


@pytest.mark.parametrize("plot", PLOTS)
def test_plots_use_the_axes_of_the_caller_or_new_ones(plot: Callable[[Any], Any]) -> None:
    one, two = plot(None), plot(None)
    assert one is not two
    assert plt.fignum_exists(one.figure.number)
    figure, axes = plt.subplots(1, 2)
    assert plot(axes[1]) is axes[1]
    assert not axes[0].has_data()
    assert plot(figure.add_axes((0.1, 0.1, 0.3, 0.3))) is figure.axes[-1] or len(figure.axes) > 3
    inner = plt.figure().subfigures(1, 2)[0].subplots()
    assert plot(inner) is inner
    inner.figure.figure.canvas.draw()


@pytest.mark.parametrize("plot", PLOTS)
def test_other_things_than_plane_axes_are_refused_and_leave_no_figure(plot: Callable[[Any], Any]) -> None:
    space = plt.figure().add_subplot(projection="3d")
    before = plt.get_fignums()
    with pytest.raises(OptionError, match=r"ax must be matplotlib axes, .* given Figure"):
        plot(space.figure)
    with pytest.raises(OptionError, match="given projection '3d'"):
        plot(space)
    assert plt.get_fignums() == before


@pytest.mark.parametrize("plot", PLOTS)
def test_without_matplotlib_it_says_what_to_install(
    plot: Callable[[Any], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.axes", None)
    with pytest.raises(OptionError, match=r"plotting needs matplotlib: pip install .agglo\[plot\]"):
        plot(None)


def test_tags_have_their_colours_and_a_legend_at_the_true_place() -> None:
    far = Mesh.from_polygons([[5, 5], [6, 5], [6, 6], [5, 6], [7, 5], [7, 6]], [[0, 1, 2, 3], [1, 4, 5, 2]])
    ax = far.with_tags(rock=np.array([7, 3])).plot(values="rock")
    legend = ax.get_legend()
    assert legend.get_title().get_text() == "rock"
    assert [text.get_text() for text in legend.get_texts()] == ["3", "7"]
    shown = [patch.get_facecolor()[:3] for patch in legend.get_patches()]
    for x, colour in ((6.5, shown[0]), (5.5, shown[1])):
        np.testing.assert_allclose(pixels(ax, x, 5.5), 255 * np.array(colour), atol=1)


def test_numbers_have_a_colour_bar_that_agrees() -> None:
    ax = SQUARES.plot(values=np.arange(16.0), cmap="gray")
    bar = ax.figure.axes[-1]
    assert bar.get_ylim() == (0.0, 15.0)
    for cell in (0, 5, 15):
        grey = pixels(ax, *SQUARES.cell_centroids[cell])
        assert grey[0] == pytest.approx(255 * cell / 15, abs=2)


def test_metrics_colour_agglomerates() -> None:
    labels = np.array([0] * 4 + [1] * 12)
    two = Hierarchy(SQUARES, SQUARES.graph, [labels], [{}], nested=True)
    ax = two.plot(values="cells", cmap="gray")
    assert ax.figure.axes[-1].get_ylabel() == "cells"
    assert ax.figure.axes[-1].get_ylim() == (4.0, 12.0)
    centres = [SQUARES.cell_centroids[labels == part].mean(axis=0) + 0.05 for part in (0, 1)]
    assert [pixels(ax, *centre)[0] for centre in centres] == [0, 255]


def test_what_is_not_finite_is_grey_and_many_tags_are_numbers() -> None:
    paint = by_number([0.0, np.nan, 2.0, np.inf])
    assert paint.limits == (0.0, 2.0)
    assert [paint.palette[k] for k in paint.colours[[1, 3]]] == ["#BBBBBB"] * 2
    assert paint.colours[0] == 0
    assert by_number([np.nan]).limits == (0.0, 1.0)
    assert by_number([3.0, 3.0]).colours.tolist() == [0, 0]
    assert by_tag(np.arange(9), "tag").names == tuple("012345678")
    assert by_tag(np.arange(10), "tag").limits == (0.0, 9.0)


def test_a_solid_shows_its_tags() -> None:
    mesh = CUBES.with_tags(all=np.full(CUBES.n_cells, 4))
    ax = mesh.plot(values="all")
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["4"]
    picture = ax.get_images()[0].get_array()
    blue = (picture[..., 2] > picture[..., 0]) & (picture[..., 3] > 0)
    assert blue.mean() > 0.3  # the first colour of the palette


def test_curves_are_relative_to_the_first_residual() -> None:
    ax = SOLUTION.plot(convergence=True)
    np.testing.assert_allclose(ax.get_lines()[0].get_ydata(), [1.0, 0.1, 0.01])
    assert ax.get_yscale() == "log"


def test_a_solution_is_drawn_where_it_was_solved() -> None:
    ax = solved(SQUARES).plot(cmap="gray")
    grey = [pixels(ax, x, 0.6)[0] for x in (0.1, 0.4, 0.9)]  # between the edges of cells
    np.testing.assert_allclose(grey, [0.1 * 255, 0.4 * 255, 0.9 * 255], atol=4)
    assert len(ax.collections) == 2  # colours and edges
    space = solved(CUBES).plot(across="y")
    assert (space.get_xlabel(), space.get_ylabel()) == ("x", "z")
    np.testing.assert_allclose(space.collections[0].get_clim(), (0.0, 1.0), atol=1e-9)


@pytest.mark.parametrize("name", ["polydg_mg", "polydg_cg", "polydg_mg_paper", "multigrid"])
def test_every_solver_says_what_its_unknowns_are_on_the_mesh_of_the_user(name: str) -> None:
    mesh = samples.voronoi(150, seed=8)
    solver: Any = default().build("solver", name, degree=1, tolerance=1e-10)
    problem = Diffusion(source=0.0, dirichlet={0: lambda points: points[:, 0] - 2.0 * points[:, 1]})
    solution = solver.solve(problem, agglomerate(mesh, n_parts=(30, 6)))
    assert solution.mesh is mesh
    found = solution.samples()
    np.testing.assert_allclose(found.values, found.points[:, 0] - 2.0 * found.points[:, 1], atol=1e-6)


def test_solutions_of_linear_systems_plot_only_convergence() -> None:
    system = solved(SQUARES)
    solver: Any = default().build("solver", "direct")
    linear = solver.solve(Linear(system.A, system.b, 3 * np.arange(17)), halves(SQUARES))
    with pytest.raises(OptionError, match=r"not for linear systems; plot\(convergence=True\) shows"):
        linear.plot()
    assert linear.plot(convergence=True).get_xlabel() == "iteration"


@pytest.mark.parametrize(("across", "names"), [("x", "yz"), ("y", "xz"), ("z", "xy")])
def test_functions_of_space_are_shown_on_a_plane(across: str, names: str) -> None:
    ax = TETRAHEDRON.plot(across=across)
    assert ax.get_xlabel() + ax.get_ylabel() == names
    assert ax.collections[0].get_clim() == (0.0, 3.0)


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: SQUARES.plot(values="rock"), OptionError, "no cell tag 'rock'; .* has none"),
        (lambda: SQUARES.plot(values=[1.0]), OptionError, r"shape \(16,\), one per cell, given \(1,\)"),
        (lambda: SQUARES.plot(values=["a"] * 16), OptionError, "a name or numbers, one for each cell"),
        (
            lambda: SQUARES.plot(values=np.ones(16), cmap="no"),
            OptionError,
            "cmap must be the name .* given 'no'",
        ),
        (lambda: SQUARES.plot(section=(1, 0, 0)), OptionError, "section applies to 3-D meshes"),
        (
            lambda: halves(SQUARES).plot(1),
            IndexError,
            r"level 1 is out of range: the hierarchy has levels 0\.\.0",
        ),
        (lambda: halves(SQUARES).plot(values="UFO"), PluginError, "UFO"),
        (lambda: halves(SQUARES).plot(values=[1.0]), OptionError, r"shape \(2,\), one per agglomerate"),
        (lambda: halves(SQUARES).plot(explode=1), OptionError, "explode applies to 3-D meshes"),
        (lambda: halves(CUBES).plot(explode=-1), OptionError, "explode must be a number from 0"),
        (lambda: TRIANGLE.plot(across="w"), OptionError, "across must be 'x', 'y' or 'z', given 'w'"),
        (lambda: TRIANGLE.plot(cmap="no"), OptionError, "cmap must be the name"),
        (
            lambda: Hierarchy(None, SQUARES.graph, [np.zeros(16, int)], [{}], nested=True).plot(),
            MeshError,
            "belongs to a graph",
        ),
    ],
)
def test_what_is_refused_leaves_no_figure(
    call: Callable[[], Any], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        call()
    assert plt.get_fignums() == []


def test_metrics_are_looked_up_where_one_says() -> None:
    from agglo_core.registry import Registry

    with pytest.raises(PluginError):
        halves(SQUARES).plot(values="CR", registry=Registry())
    np.testing.assert_array_equal(quality(SQUARES, [0] * 16, ("cells",))["cells"], [16.0])
