"""``python -m shape_study shapes``: partitions from excellent to bad, correlations, what is written."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.stats import spearmanr

from agglo_core import samples
from agglo_core.graph.objectives import OBJECTIVES
from agglo_paper.work.store import Unit
from shape_study.__main__ import study
from shape_study.page import page
from shape_study.partitions import RECIPES, Growth, Recipe, Scattered, Shaken, chosen
from shape_study.plan import Size, sources
from shape_study.ranks import Measured, correlations, costs, relative
from shape_study.tables import Group
from shape_study.work import measured

TINY = ["--meshes", "1", "--cells", "80", "--partitions", "4", "--degrees", "1"]
USABLE = [name for name, recipe in RECIPES.items() if not recipe.problem]


@pytest.mark.parametrize("name", USABLE)
def test_every_recipe_makes_so_many_connected_parts_and_repeats_itself(name: str) -> None:
    mesh = samples.voronoi(200, seed=5)
    labels = RECIPES[name].labels(mesh, 13, 2)
    assert labels.max() == 12
    np.testing.assert_array_equal(mesh.graph.components(labels), labels)
    np.testing.assert_array_equal(RECIPES[name].labels(mesh, 13, 2), labels)
    if not RECIPES[name].usual:
        assert (RECIPES[name].labels(mesh, 13, 3) != labels).any()


def energy(bisector: object) -> float:
    """Energy of k-means of a random partition, over that of the default."""
    mesh = samples.voronoi(600, seed=1)
    recipe = Recipe("", {"bisector": bisector, "method": "kway", "refiners": (), "polish": False})
    value = OBJECTIVES["compactness"].value
    return value(mesh.graph, recipe.labels(mesh, 40, 0)) / value(
        mesh.graph, RECIPES["kmeans"].labels(mesh, 40, 0)
    )


def test_partitions_are_from_excellent_to_bad() -> None:
    assert 0.95 < energy(Scattered(30)) < energy(Scattered(0))
    assert energy(Scattered(20)) < energy(Scattered(20, stretch=2.0)) < energy(Scattered(20, stretch=4.0))
    assert energy(Growth(0.0)) < energy(Growth(3.0))
    assert 1.0 < energy(Shaken(1)) < energy(Shaken(12))


def test_usual_and_random_partitions_take_turns_and_come_again_with_other_seeds() -> None:
    found = chosen(60)
    assert len(set(found)) == len(found) == 60
    assert [RECIPES[name].usual for name, _ in found[:4]] == [True, False, True, False]
    annealed = {name for name in USABLE if name.endswith("annealed")}
    assert {name for name, seed in found if seed == 0} == set(USABLE) - annealed
    assert len(annealed) == 1
    assert {name for name, seed in chosen(60, annealed=True) if seed == 0} == set(USABLE)
    assert all(RECIPES[name].seeded for name, seed in found if seed > 0)


def test_what_lacks_a_plugin_has_a_problem() -> None:
    assert "nobody" in Recipe("", {"bisector": ("nobody", {})}).problem
    assert RECIPES["kmeans"].problem == RECIPES["branches"].problem == ""


def row(source: str, recipe: str, uf: float, cut: float, error: float, steps: float = 5.0) -> Measured:
    """A partition of which one metric is better high, one better low."""
    result = {
        "metrics": {"UF": uf, "cut": cut},
        "better": {"UF": "high", "cut": "low"},
        "outcomes": {"L2 p1": error, "steps": steps},
    }
    return Measured(source, recipe, 0, result)


ROWS = [
    row("a", "kmeans", 0.9, 10, 1.0),
    row("a", "branches", 0.7, 40, 4.0),
    row("a", "shaken", 0.8, 20, 8.0),
    row("b", "kmeans", 0.9, 1, 1.0),
    row("b", "branches", 0.5, 3, 9.0),
    row("b", "shaken", 0.8, 2, 3.0),
]


def test_correlations_are_of_ranks_with_worse_metrics_and_mesh_by_mesh() -> None:
    found = correlations(ROWS, ["UF", "cut"], ["L2 p1", "steps"])
    assert found["UF"][0] == found["cut"][0] == pytest.approx((0.5 + 1.0) / 2)  # two ranks swapped on a
    assert math.isnan(found["UF"][1])
    turned = [row(each.source, each.recipe, -each.badness("UF"), 0, -each.outcome("L2 p1")) for each in ROWS]
    assert correlations(turned, ["UF", "cut"], ["L2 p1"])["UF"][0] == pytest.approx(-0.75)
    assert math.isnan(correlations(turned, ["cut"], ["L2 p1"])["cut"][0])


def test_what_differs_by_rounding_alone_has_no_rank() -> None:
    rows = [row("a", "kmeans", 0.5 + 1e-13 * k, 1, 1.0 + k) for k in range(5)]
    assert math.isnan(correlations(rows, ["UF"], ["L2 p1"])["UF"][0])


def test_costs_and_recipes_are_geometric_means_over_the_best_of_each_mesh() -> None:
    assert relative(ROWS, ["L2 p1"]) == {
        "kmeans": [1.0],
        "branches": [pytest.approx(6.0)],  # 4 and 9
        "shaken": [pytest.approx(24**0.5)],
    }
    found = costs(ROWS, ["L2 p1"])
    assert found["worst of all over best"] == [pytest.approx(72**0.5)]
    assert found["worst usual over best usual"] == [pytest.approx(1.0)]


def test_meshes_are_of_three_families_with_seeds_of_their_own() -> None:
    found = sources(Size(4, 400, 5, 16, (1,), seed=7))
    assert found == [
        "voronoi:n=400,seed=7",
        "random_triangles:n=200,seed=8",
        "squares:n=20",
        "voronoi:n=400,seed=10",
    ]


def test_bad_shapes_cost_and_metrics_tell() -> None:
    good = measured("voronoi:n=150,seed=2", 9, "kmeans", 0, [1])
    bad = measured("voronoi:n=150,seed=2", 9, "branches", 0, [1])
    assert good["metrics"]["J"] > bad["metrics"]["J"]
    assert good["better"]["J"] == "high"
    for outcome in ("L2 p1", "DG p1", "paper κ = 1 p1"):
        assert good["outcomes"][outcome] < bad["outcomes"][outcome]


@pytest.mark.slow
def test_the_command_writes_a_page_and_goes_on_where_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(study, ["shapes", *TINY, "-o", "out"])
    assert done.exit_code == 0
    text = (tmp_path / "out" / "shapes.md").read_text(encoding="utf-8")
    assert " ".join(text.split()) in " ".join(done.stdout.split())
    assert text.startswith("# What shapes are for")
    assert "`voronoi:n=80,seed=0` in 5 parts each, 4 of every mesh" in " ".join(text.split())
    amounts = f"{' '.join(TINY[:6])} --cells-per-part 16 --degrees 1 --seed 0"
    assert f"Made by `python -m shape_study shapes {amounts}`" in text
    data = json.loads((tmp_path / "out" / "shapes.json").read_text(encoding="utf-8"))
    assert [table["name"] for table in data["tables"]] == ["all", "usual", "p1", "costs", "recipes"]
    ranks = {each["name"]: each["cells"] for each in data["tables"][0]["rows"]}
    assert {"UF", "CR", "J", "isoperimetric", "compactness", "interface"} <= set(ranks)
    assert all(abs(cell.get("ours", 0.0)) <= 1.0 for cells in ranks.values() for cell in cells.values())
    assert (tmp_path / "out" / "shapes.svg").exists() == ("shapes.svg" in text)

    def never(self: Unit) -> dict[str, object]:
        raise AssertionError("computed again")

    monkeypatch.setattr(Unit, "run", never)
    done = CliRunner().invoke(study, ["shapes", *TINY, "-o", "out", "--json"])
    assert done.exit_code == 0
    assert json.loads(done.stdout) == data


@pytest.mark.parametrize("wrong", ["0", "7", "one", "", "1,,2"])
def test_wrong_degrees_are_refused(wrong: str) -> None:
    done = CliRunner().invoke(study, ["shapes", "--degrees", wrong])
    assert done.exit_code == 2
    assert "expected degrees from 1 to 6" in " ".join(done.stderr.split())


def test_the_page_of_one_degree_names_all_that_was_measured() -> None:
    result = measured("squares:n=8", 4, "kmeans", 0, [1])
    rows = [Measured("squares:n=8", name, 0, result) for name in ("kmeans", "branches", "shaken")]
    group = Group("", "", rows, ["L2", "paper κ = 1"], [1])
    found = page("shapes", [group], {"parts": 4, "degrees": "1"}, "python -m shape_study shapes", {})
    assert found.tables[0].rows == []  # nothing differs
    assert len(found.tables[-1].rows) == 3


def test_what_the_number_of_parts_explains_can_be_taken_out() -> None:
    metrics = {"parts": [1, 2, 3, 4, 5, 6], "UF": [1, 2, 3, 4, 6, 5], "J": [2, 1, 4, 3, 6, 5]}
    steps = [2, 1, 4, 3, 6, 5]
    rows = [
        Measured(
            "a",
            "kmeans",
            k,
            {
                "metrics": {name: values[k] for name, values in metrics.items()},
                "better": dict.fromkeys(metrics, "low"),
                "outcomes": {"steps": steps[k]},
            },
        )
        for k in range(6)
    ]
    found = correlations(rows, metrics, ["steps"], given="parts")
    assert math.isnan(found["parts"][0])
    assert found["J"][0] == pytest.approx(1.0)
    table = {name: spearmanr(metrics[name], steps).statistic for name in metrics}
    uf = spearmanr(metrics["UF"], metrics["parts"]).statistic
    slow = (table["UF"] - uf * table["parts"]) / math.sqrt((1 - uf**2) * (1 - table["parts"] ** 2))
    assert found["UF"][0] == pytest.approx(slow)
