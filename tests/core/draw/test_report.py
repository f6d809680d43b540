"""quality and summary: names, options and objects; one line of plain data per level."""

from __future__ import annotations

import json
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from agglo_core import samples
from agglo_core.errors import MeshError, OptionError, PluginError
from agglo_core.hierarchy import Hierarchy
from agglo_core.measure.agglomerates import measure_levels, quality, summary
from agglo_core.measure.selection import RATIOS
from agglo_core.mesh import Mesh
from agglo_core.registry import Component, Registry, hookimpl


class FirstCell:
    """A metric of a third party: the smallest cell number of each part."""

    better, bounds, homogeneity = "low", (0.0, np.inf), 0

    def measure(self, mesh: Mesh, labels: np.ndarray) -> np.ndarray:
        return np.unique(labels, return_index=True)[1]


class Scalar:
    better, bounds, homogeneity = "low", (0.0, np.inf), 0

    def measure(self, mesh: Mesh, labels: np.ndarray) -> float:
        return 1.0


def _quarters(n: int) -> np.ndarray:
    side = np.arange(n) // (n // 2)
    return np.add.outer(2 * side, side).ravel()


def _hierarchy(mesh: Mesh, *levels: np.ndarray) -> Hierarchy:
    targets = [{"parts": int(labels.max()) + 1} for labels in levels]
    return Hierarchy(mesh, mesh.graph, levels, targets, nested=len(levels) == 1)


def test_default_metrics_on_quarters_of_a_square() -> None:
    values = quality(samples.squares(8), _quarters(8))
    assert list(values) == ["UF", "CR", "CRc", "J", "isoperimetric"]
    np.testing.assert_allclose(values["J"], 3 / np.pi)
    np.testing.assert_allclose(values["isoperimetric"], np.pi / 4)
    np.testing.assert_allclose(values["UF"], np.ones(4))
    np.testing.assert_allclose(values["CR"], np.full(4, 0.5**0.5))
    np.testing.assert_allclose(values["CRc"], np.full(4, 0.5**0.5))


def test_names_options_and_objects_mix() -> None:
    mesh = samples.squares(4)
    metrics = ("cells", ("diameter_ratio", {"h_star": 0.5}), FirstCell())
    values = quality(mesh, _quarters(4), metrics=metrics)
    assert list(values) == ["cells", "diameter_ratio", "FirstCell"]
    np.testing.assert_array_equal(values["cells"], [4, 4, 4, 4])
    np.testing.assert_allclose(values["diameter_ratio"], 2**0.5)
    np.testing.assert_array_equal(values["FirstCell"], [0, 2, 8, 10])  # it is given the fine mesh
    assert values["FirstCell"].dtype == np.float64


def test_quality_equals_each_metric_on_its_own() -> None:
    mesh = samples.voronoi(200, seed=1)
    labels = np.unique(np.floor(mesh.cell_centroids * 4).astype(int) @ [1, 4], return_inverse=True)[1]
    together = quality(mesh, labels, ("UF", "UF99", "CR", "CRc", "interface_length", "cut", "components"))
    for name, values in together.items():
        np.testing.assert_array_equal(values, quality(mesh, labels, (name,))[name])


def test_faulty_requests_are_explained() -> None:
    mesh, labels = samples.squares(2), np.array([0, 0, 1, 1])
    with pytest.raises(PluginError, match="UFO"):
        quality(mesh, labels, ("UFO",))
    with pytest.raises(OptionError, match="h_star"):
        quality(mesh, labels, ("diameter_ratio",))
    with pytest.raises(OptionError, match="given twice"):
        quality(mesh, labels, ("CR", "CR"))
    with pytest.raises(OptionError, match="not the text"):
        quality(mesh, labels, "CR")
    with pytest.raises(OptionError, match="is not a metric"):
        quality(mesh, labels, (object(),))  # type: ignore[arg-type]
    for wrong in (("UF", "CR"), ("UF",), ("UF", {}, {}), (3, {})):
        with pytest.raises(OptionError, match=r"a metric must be a name, \(name, options\) or an object"):
            quality(mesh, labels, [wrong])  # type: ignore[list-item]
    with pytest.raises(OptionError, match="is not a metric"):
        quality(mesh, labels, (Scalar,))  # type: ignore[arg-type]
    with pytest.raises(OptionError, match="list or tuple"):
        quality(mesh, labels, None)  # type: ignore[arg-type]
    with pytest.raises(OptionError, match="needs a Mesh and its labels, given Graph"):
        quality(mesh.graph, labels)  # type: ignore[arg-type]
    with pytest.raises(PluginError, match=r"'Scalar' .* expected \(2,\)"):
        quality(mesh, labels, (Scalar(),))  # type: ignore[arg-type]
    with pytest.raises(MeshError, match="gaps"):
        quality(mesh, [0, 0, 2, 2])


FIRST = ("target", "parts", "min_cells", "max_cells", "max_diameter")


def test_the_summary_has_the_fewest_and_the_most_cells_of_a_part() -> None:
    mesh = samples.squares(2)
    line, whole = summary(mesh, _hierarchy(mesh, np.array([0, 1, 1, 1]), np.zeros(4, int)))
    assert (line["min_cells"], line["max_cells"]) == (1, 3)
    assert (whole["min_cells"], whole["max_cells"]) == (4, 4)


def test_summary_of_a_plane_mesh() -> None:
    mesh = samples.squares(4)
    split = np.add.outer(np.arange(4), np.arange(4)).ravel() % 2
    lines = summary(mesh, _hierarchy(mesh, _quarters(4), split))
    assert [list(line) for line in lines] == [[*FIRST, *RATIOS, "connected", "diameter_ratio"]] * 2
    first, second = lines
    assert first["target"] == {"parts": 4}
    assert first["parts"] == 4
    assert first["max_diameter"] == pytest.approx(0.5**0.5)
    assert first["UF"] == pytest.approx(1.0)
    assert first["CR"] == first["CRc"] == pytest.approx(0.5**0.5)
    assert first["connected"] == 1.0
    assert second["connected"] == 0.0
    assert first["diameter_ratio"] is None
    json.dumps(lines)


def test_summary_of_solids_has_balls() -> None:
    mesh = samples.boxes(2)
    (line,) = summary(mesh, _hierarchy(mesh, np.repeat([0, 1], 4)))
    assert [line["CR"], line["CRc"]] == pytest.approx([1 / 3, 1 / 3])  # radius 1/4, diameter 3/2
    assert line["UF"] == pytest.approx(1.0)
    assert line["max_diameter"] == pytest.approx(1.5)


def test_levels_are_measured_by_the_metrics_that_are_chosen() -> None:
    mesh = samples.squares(4)
    hierarchy = _hierarchy(mesh, _quarters(4))
    metrics = ("CR", ("diameter_ratio", {"h_star": 0.5}), FirstCell(), "interface", "balance")
    (level,) = measure_levels(mesh, hierarchy, metrics=metrics)
    assert level.metrics == ("CR", "diameter_ratio", "FirstCell")
    assert set(level.values) == {"cells", "diameter", "measure", *level.metrics, "components"}
    assert list(level.line) == [*(*FIRST, "CR", "diameter_ratio", "FirstCell", "connected", "objectives")]
    assert level.line["FirstCell"] == 5.0  # the mean of 0, 2, 8, 10
    assert level.line["diameter_ratio"] == pytest.approx(2**0.5)
    assert level.line["objectives"] == pytest.approx({"interface": 2.0, "balance": 0.25})
    assert summary(mesh, hierarchy, metrics=metrics) == [level.line]


def test_a_metric_comes_before_an_objective_of_its_name() -> None:
    mesh = samples.squares(4)
    (level,) = measure_levels(mesh, _hierarchy(mesh, _quarters(4)), metrics=["cut", "compactness"])
    assert level.line["cut"] == 4.0  # the mean over the parts, not the 8 edges in all
    assert list(level.objectives) == ["compactness"]


def test_names_are_looked_up_in_the_registry_that_is_given(monkeypatch: pytest.MonkeyPatch) -> None:
    registry, home = Registry(), SimpleNamespace(FirstCell=FirstCell)
    monkeypatch.setitem(sys.modules, "first_home", home)
    import agglo_core.builtin

    registry.register(agglo_core.builtin, "defaults", distribution="agglo")
    mine = Component("metric", "first", "first_home:FirstCell")
    registry.register(SimpleNamespace(agglo_components=hookimpl(lambda: [mine])), "mine")
    mesh = samples.squares(4)
    hierarchy = _hierarchy(mesh, _quarters(4))
    assert summary(mesh, hierarchy, registry, ["first"])[0]["first"] == 5.0
    with pytest.raises(PluginError, match="no metric or objective is named 'first'"):
        summary(mesh, hierarchy, metrics=["first"])


def test_choices_that_make_no_sense_are_explained() -> None:
    mesh, solid = samples.squares(4), samples.boxes(2)
    hierarchy = _hierarchy(mesh, _quarters(4))
    with pytest.raises(PluginError, match=r"is named 'compactnes' \(did you mean 'compactness'\?\)"):
        summary(mesh, hierarchy, metrics=["compactnes"])
    with pytest.raises(OptionError, match="'balance' is given twice"):
        summary(mesh, hierarchy, metrics=["balance", "balance"])
    with pytest.raises(OptionError, match="not the text 'UF'"):
        summary(mesh, hierarchy, metrics="UF")
    parts = type("parts", (FirstCell,), {})()
    with pytest.raises(OptionError, match="the name is reserved"):
        summary(mesh, hierarchy, metrics=[parts])
    with pytest.raises(MeshError, match="edge_ratio exists only for 2-D"):
        summary(solid, _hierarchy(solid, np.repeat([0, 1], 4)), metrics=["UF", "edge_ratio"])
