"""Whoever is given a registry looks names up there: the program's own one is out of bounds here."""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import pytest
from own_names import MINE, Asks
from syntax import syntax_tree

import agglo_core as agglo
import agglo_core.builtin
import agglo_core.registry.catalogue as catalogue
import agglo_polydg_mg
from agglo_core import AggloError, Registry, hookimpl, samples
from agglo_core.conformance import check, conformance
from agglo_core.conformance.base.subject import find, subject_of
from agglo_core.draw import plot
from agglo_core.draw.webpage import page
from agglo_core.io import check_writable
from agglo_core.measure import comparison, measure_levels, selection, summary
from agglo_core.multigrid import Composition, part
from agglo_core.problems import Diffusion, choosing
from agglo_core.refine.descent import DescentRefiner
from agglo_core.refine.objective_choice import choose_objective
from agglo_core.registry.construct import construct
from agglo_core.solvers.direct import Direct
from agglo_polydg_mg.paper.composed_multigrid import ComposedMultigrid
from agglo_polydg_mg.paper.paper_multigrid import PaperMultigrid
from agglo_polydg_mg.paper.schwarz import smoother_of
from agglo_polydg_mg.solver.polydg_multigrid import PolyDGMultigrid

ROOT = Path(__file__).parents[3]


@pytest.fixture
def registry() -> Registry:
    whole = Registry()
    whole.register(agglo_core.builtin, "defaults", distribution="agglo")
    whole.register(agglo_polydg_mg, "polydg_mg", distribution="agglo")
    whole.register(SimpleNamespace(agglo_components=hookimpl(lambda: MINE)), "mine")
    needy = "vtkhdf"  # of which h5py may be missing
    assert {record.state for record in whole.list() if record.name != needy} == {"ok"}
    return whole


@pytest.fixture(autouse=True)
def _no_default(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """``default()`` raises, under whatever name a module holds it, also one first imported meanwhile."""

    def refused() -> Registry:
        raise AssertionError("the registry of the program was asked")

    original = catalogue.default
    for name, module in list(sys.modules.items()):
        if name.split(".")[0].startswith("agglo_") and vars(module).get("default") is original:
            monkeypatch.setattr(module, "default", refused)
    yield
    for module in list(sys.modules.values()):
        if getattr(module, "__dict__", {}).get("default") is refused:
            vars(module)["default"] = original


MESH = samples.squares(8)
TARGET = {"n_parts": 4}


def run(registry: Registry, **chosen: object) -> agglo.Hierarchy:
    given = {"bisector": "straight", "fixer": "joins", **TARGET, **chosen}
    return agglo.agglomerate(MESH, **given, registry=registry)  # type: ignore[arg-type]


def report(registry: Registry, folder: Path) -> None:
    result = comparison.timed_run(MESH, "mine", lambda: run(registry), ["crowd"], registry)
    page.write_page(folder / "r.html", MESH, [result], registry=registry)
    assert "A note of mine" in (folder / "r.html").read_text()


def picture(registry: Registry, folder: Path) -> None:
    pytest.importorskip("matplotlib")
    plot.draw(MESH, {"mine": run(registry)}, folder / "p.png", metrics=["crowd"], registry=registry)
    assert (folder / "p.png").exists()
    axes = run(registry).plot(values="crowd", registry=registry)
    assert axes.figure.axes[-1].get_ylabel() == "crowd"
    axes.figure.clear()


def files(registry: Registry, folder: Path) -> None:
    path = folder / "m.tiny"
    check_writable(path, registry=registry)
    agglo.write(path, MESH, registry=registry)
    assert agglo.read(path, registry=registry).n_cells == 64
    assert agglo.read_hierarchy(path, registry=registry)[1] is None


def problems(registry: Registry, folder: Path) -> None:
    (folder / "p.toml").write_text('kind = "heating"\nsource = 2.0\n')
    assert isinstance(choosing.read_problem(folder / "p.toml", MESH, registry), Diffusion)
    assert isinstance(choosing.named_problem("eight", MESH, registry=registry), Diffusion)
    with pytest.raises(AggloError, match="eight"):
        choosing.named_problem("nine", MESH, registry=registry)


def subjects(registry: Registry, folder: Path) -> None:
    assert find("crowd", registry=registry).name == "crowd"
    assert subject_of("crowd", registry=registry).kind == "metric"
    assert subject_of(Asks, registry=registry).build().registry is registry
    assert subject_of("asks", registry=registry).build().registry is registry


def laws(registry: Registry, folder: Path) -> None:
    for name in ("downhill", "crowd", "free", "straight"):
        options = {"objective": "crowd"} if name == "downhill" else {}
        failed = [
            f"{r.law}: {r.message}" for r in check(name, options=options, registry=registry) if not r.passed
        ]
        assert failed == []
    assert callable(conformance("crowd", registry=registry))


def samples_by_name(registry: Registry, folder: Path) -> None:
    assert "patch" in samples.names(registry)
    assert samples.from_spec("patch:n=3", registry).n_cells == 9


def measures(registry: Registry, folder: Path) -> None:
    hierarchy = run(registry)
    assert agglo.quality(MESH, hierarchy.levels[0], ["crowd"], registry)["crowd"].tolist() == [256.0] * 4
    assert measure_levels(MESH, hierarchy, registry, ["crowd", "cut"])[0].metrics == ("crowd", "cut")
    assert measure_levels(MESH, hierarchy, registry)[0].metrics == ("UF", "CR", "CRc", "J", "isoperimetric")
    assert summary(MESH, hierarchy, registry, ["crowd"])[0]["crowd"] == 256.0
    assert list(selection.build_metrics(["crowd"], registry)) == ["crowd"]
    assert list(selection.select(["crowd", "interface"], registry).metrics) == ["crowd"]


def agglomerations(registry: Registry, folder: Path) -> None:
    downhill = ("downhill", {"objective": "crowd"})
    assert run(registry, refiners=["asks", downhill], post_refiners=[downhill]).parts == [4]
    assert run(registry, bisector="one_sided").statistics["fallbacks"] > 0
    assert run(registry, bisector="strips", method="kway").parts == [4]
    assert run(registry, constraints=["free"]).parts == [4]
    assert run(registry, bisector="mine/straight").parts == [4]
    assert agglo.Pipeline(bisector="straight", n_parts=4).run(MESH, registry).parts == [4]


def handed_on(registry: Registry, folder: Path) -> None:
    assert choose_objective("crowd", registry).title.startswith("metric 'crowd'")
    assert DescentRefiner("crowd", registry=registry).objective == "crowd"
    assert registry.build("refiner", "asks").registry is registry
    assert construct(registry.record("refiner", "asks"), {"rounds": 2}, registry).registry is registry


def smoothers(registry: Registry, folder: Path) -> None:
    assert type(smoother_of("jacobi", registry).tool).__name__ == "BlockJacobi"
    built = registry.build("solver", "polydg_mg_paper", smoother="jacobi")
    assert built.solve(Diffusion(), run(registry)).converged
    assert type(PaperMultigrid(smoother="jacobi", registry=registry).smoother).__name__ == "BlockJacobi"


def parts_of_multigrid(registry: Registry, folder: Path) -> None:
    mine = {
        "transfer": "inject",
        "coarse_operator": "products",
        "smoother": "jacobi",
        "coarse_solver": "eliminate",
    }
    for kind, name in mine.items():
        assert "mine" in part(kind, name, {}, registry).title
    built = registry.build("solver", "multigrid", **mine)
    assert built.solve(Diffusion(), run(registry)).converged
    assert agglo.solve(run(registry), solver=("multigrid", mine), registry=registry).converged
    assert ComposedMultigrid(**mine, registry=registry).composition.title == built.composition.title
    with pytest.raises(AggloError, match="transfer must be one of injection, smoothed, aggregation, inject"):
        Composition("wavelets", registry=registry)


def direct(registry: Registry, folder: Path) -> None:
    assert Direct(registry=registry).discretisation is not None
    assert Direct(registry=Registry()).discretisation is None
    for solver in (Direct, PolyDGMultigrid):
        with pytest.raises(AggloError, match="no discretisation is named 'vem'"):
            solver(discretisation="vem", registry=registry)


def time_steps(registry: Registry, folder: Path) -> None:
    steps = agglo.evolve(MESH, Diffusion(), 0.0, 0.2, 0.1, solver=("direct", {}), registry=registry)
    assert all(solution.converged for _, solution in steps)
    assert agglo.newton(MESH, lambda u: Diffusion(), solver=("direct", {}), registry=registry).converged


def adaptations(registry: Registry, folder: Path) -> None:
    found = agglo.adapt(run(registry), max_unknowns=60, solver="direct", registry=registry)
    assert found.reason == "max_unknowns"


def on_ranks(registry: Registry, folder: Path) -> None:
    pytest.importorskip("mpi4py")
    from agglo_core import Pipeline, distributed

    file = folder / "mesh.vtu"
    agglo.write(file, samples.squares(4), registry=registry)
    mesh = distributed.read(file, registry=registry)
    made = distributed.agglomerate(mesh, Pipeline("straight", n_parts=2), registry=registry)
    assert made.quality(0, registry=registry)["connected"] == 1.0


GROUPS: dict[Callable[[Registry, Path], None], set[str]] = {
    agglomerations: {"agglomerate", "run"},
    measures: {"quality", "measure_levels", "summary", "build_metrics", "select"},
    files: {"read", "read_hierarchy", "write", "check_writable"},
    samples_by_name: {"names", "from_spec"},
    picture: {"draw", "plot", "plot_level"},
    report: {"timed_run", "write_page", "sections_of_plugins"},
    problems: {"named_problem", "read_problem"},
    laws: {"check", "conformance"},
    subjects: {"find", "subject_of"},
    handed_on: {"choose_objective", "construct", "DescentRefiner"},
    smoothers: {"smoother_of", "PaperMultigrid"},
    parts_of_multigrid: {"part", "Composition", "ComposedMultigrid", "solve"},
    direct: {"Direct", "PolyDGMultigrid", "chosen_discretisation", "discretisation"},
    time_steps: {"evolve", "newton", "solver_member"},
    adaptations: {"adapt"},
    on_ranks: {"prepare_run", "evaluate_rules", "means"},
}
"""What is asked here, and the public functions with a parameter ``registry`` that this asks."""
PETSC = {"PetscMultigrid", "solve_across"}
"""Those that need petsc4py: tests/plugins/test_petsc_solver.py."""
ELSEWHERE = {"new_run", "build_component", "columns", "members"}
"""Those that are only ever called by the above, or by a command, which has the program's registry."""


@pytest.mark.parametrize(
    "asked",
    [pytest.param(each, marks=pytest.mark.slow if each is laws else ()) for each in GROUPS],
    ids=lambda group: group.__name__,
)
def test_names_are_looked_up_in_the_registry_given(
    asked: Callable[[Registry, Path], None], registry: Registry, tmp_path: Path
) -> None:
    asked(registry, tmp_path)


def test_without_a_registry_argument_the_default_is_used() -> None:
    with pytest.raises(AssertionError, match="the registry of the program"):
        agglo.agglomerate(MESH, n_parts=4)


def test_the_registry_is_no_option(registry: Registry) -> None:
    with pytest.raises(AggloError, match=r"has no option 'registry'; accepted: rounds"):
        registry.build("refiner", "asks", registry=3)
    with pytest.raises(AggloError, match=r"has no option 'registry'.*accepted: objective, sweeps"):
        registry.build("refiner", "downhill", registry=registry)


@cache
def _trees() -> dict[Path, ast.Module]:
    """Parse the files of the core and the plugins."""
    files = [*(ROOT / "agglo_core").rglob("*.py"), *(ROOT / "plugins").rglob("*.py")]
    return {file.relative_to(ROOT): syntax_tree(file) for file in files}


def test_every_public_function_with_a_registry_is_tested() -> None:
    known = set().union(*GROUPS.values()) | ELSEWHERE | PETSC
    found = set()
    for file, tree in _trees().items():
        if "cli" in file.parts:
            continue
        for node in (tree, *(each for each in tree.body if isinstance(each, ast.ClassDef))):
            for each in node.body:
                if isinstance(each, ast.FunctionDef) and "registry" in _parameters(each):
                    name = node.name if each.name == "__init__" else each.name  # type: ignore[union-attr]
                    found.add(name)
    assert {name for name in found if not name.startswith("_")} == known


def test_the_default_registry_is_used_only_if_none_is_given() -> None:
    """``default() if registry is None else registry``, and nowhere else in the core."""
    bare = []
    for file, tree in _trees().items():
        if file.parts[0] != "agglo_core":
            continue
        chosen = {id(node.body) for node in ast.walk(tree) if isinstance(node, ast.IfExp)}
        calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call) and id(node) not in chosen]
        if any(isinstance(call.func, ast.Name) and call.func.id == "default" for call in calls):
            bare.append(file.relative_to("agglo_core").as_posix())
    assert bare
    assert [name for name in bare if not name.startswith("cli/")] == []


def _parameters(function: ast.FunctionDef) -> set[str]:
    return {each.arg for each in (*function.args.args, *function.args.kwonlyargs)}
