"""What newcomers get wrong in a component, and that the message says whose it is and what was expected."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest
from cell_values import CellValues
from command_line import Agglo

import agglo_core as agglo
import agglo_core.builtin
from agglo_core import AggloError, Component, PluginError, Registry, Solution, hookimpl, samples
from agglo_core.authoring import load_mesh
from agglo_core.conformance import check
from agglo_core.problems import named_problem, read_problem, require_accepted
from agglo_core.registry import default

HERE = __name__
MESH = samples.squares(4)


class Tuple:
    """Returns more than labels."""

    objective = "interface"

    def refine(self, graph: Any, labels: Any, seeds: Any, target: Any) -> Any:
        return labels, 3

    def partition(self, graph: Any, target: Any, seed: int) -> Any:
        return np.zeros(graph.n, int), 3


class Forgets:
    """Has no return."""

    def bisect(self, graph: Any, rng: Any) -> None:
        pass


class Lossless:
    """Says in words whether it is lossless."""

    suffixes, lossless = (".one",), "mostly"

    def read(self, path: Path) -> Any:
        return MESH


class Changes:
    """A metric whose method has another signature."""

    better, bounds, homogeneity = "low", (0.0, np.inf), 0

    def measure(self, mesh: Any, labels: Any) -> Any:
        return np.bincount(labels) * 1.0

    def changes(self, graph: Any, labels: Any) -> float:
        return 0.0


@dataclass(frozen=True)
class Kindless:
    """A problem that does not name its kind."""

    @classmethod
    def from_table(cls, table: Any, mesh: Any, folder: Any) -> Kindless:
        return cls()


@dataclass(frozen=True)
class Bound:
    """``from_table`` is no class method."""

    kind: ClassVar[str] = "bound"

    def from_table(self, table: Any, mesh: Any, folder: Any) -> Any:
        return self


class Tableless:
    kind = "tableless"


class NoFunction:
    """A smoother that forgot to return the function."""

    def setup(self, level: Any) -> None:
        pass


class Short:
    def setup(self, level: Any) -> Any:
        return lambda b, x: x[:2]


class Nothing:
    """A solver without an answer."""

    def solve(self, problem: Any, hierarchy: Any) -> Any:
        return None


class Lonely:
    """A solver that wants no hierarchy."""

    def solve(self, problem: Any) -> Any:
        return None


class TextAccepted(Nothing):
    """``accepts`` without a comma."""

    accepts = "diffusion"


class OnlyHeat:
    """Says what it accepts and does not look again."""

    accepts = ("bound",)

    def solve(self, problem: Any, hierarchy: Any) -> Any:
        return problem.heat


class Unsampled(CellValues):
    """A discretisation that fails when it is drawn."""

    def sample(self, mesh: Any, x: Any) -> Any:
        raise KeyError("no such cell")


class Drawn:
    """A solver with that discretisation."""

    accepts = ("diffusion",)
    discretisation = Unsampled()

    def solve(self, problem: Any, hierarchy: Any) -> Solution:
        system = self.discretisation.assemble(problem, hierarchy.fine)
        x = np.linalg.solve(system.A.toarray(), system.b)
        norms = np.array([np.linalg.norm(system.b), 0.0])
        return Solution(x, system.A, system.b, [(system.A, None)], norms, True, "directly", 1, {"solve": 0.0})


KINDS = {
    "bisector": (Forgets,),
    "refiner": (Tuple,),
    "format": (Lossless,),
    "metric": (Changes,),
    "problem": (Kindless, Bound, Tableless),
    "smoother": (NoFunction, Short),
    "solver": (Nothing, Lonely, TextAccepted, OnlyHeat, Drawn),
}
WRONG = [
    Component(kind, each.__name__.lower(), f"{HERE}:{each.__name__}")
    for kind, all_ in KINDS.items()
    for each in all_
]
WRONG += [Component("bisctor", "unkind", f"{HERE}:Tuple"), Component("bisector", "direct", f"{HERE}:Tuple")]
PLUGIN = SimpleNamespace(agglo_components=hookimpl(lambda: WRONG))


@pytest.fixture
def registry() -> Registry:
    known = Registry()
    known.register(agglo_core.builtin, "defaults", distribution="agglo")
    known.register(PLUGIN, "newcomer", distribution="new", version="0.3")
    return known


@pytest.fixture
def strangers() -> Iterator[None]:
    default().register(PLUGIN, "newcomer", distribution="new", version="0.3")
    yield
    default().unregister("newcomer")


def whose(kind: str, name: str) -> str:
    return f"{kind} '{name}' (plugin 'newcomer', distribution new 0.3)"


@pytest.mark.parametrize(
    ("chosen", "title", "says"),
    [
        ({"refiners": ["tuple"]}, ("refiner", "tuple"), "refine: the result must be an array of numbers"),
        (
            {"method": "kway", "bisector": "direct"},
            ("bisector", "direct"),
            "partition: the result must be an array of numbers",
        ),
        ({"bisector": "forgets"}, ("bisector", "forgets"), "bisect returned None, expected (16,)"),
        (
            {"refiners": [("descent", {"objective": "changes"})]},
            ("metric", "changes"),
            "Changes.changes() takes 3 positional arguments",
        ),
    ],
)
def test_of_a_run(chosen: dict[str, Any], title: tuple[str, str], says: str, registry: Registry) -> None:
    given = {"bisector": "coordinate", "n_parts": 4, **chosen}
    with pytest.raises(PluginError) as caught:
        agglo.agglomerate(MESH, **given, registry=registry)
    assert whose(*title) in str(caught.value)
    assert says in str(caught.value)


def test_an_attribute_of_another_type_is_shown(registry: Registry) -> None:
    with pytest.raises(PluginError, match=r"which has lossless = 'mostly'; expected a bool"):
        registry.build("format", "lossless")


@pytest.mark.parametrize(
    ("kind", "says"),
    [
        ("kindless", "from_table returned Kindless(), expected a problem"),
        ("bound", "raised TypeError: Bound.from_table() missing 1 required positional argument"),
        ("tableless", "has no method from_table(table, mesh, folder)"),
    ],
)
def test_of_a_problem(kind: str, says: str, registry: Registry, tmp_path: Path) -> None:
    path = tmp_path / "p.toml"
    path.write_text(f'kind = "{kind}"\n')
    with pytest.raises(AggloError) as caught:
        read_problem(path, MESH, registry)
    assert str(caught.value).startswith(f"{path}: ")
    assert whose("problem", kind) in str(caught.value)
    assert says in str(caught.value)


def test_of_a_problem_by_name(registry: Registry) -> None:
    with pytest.raises(PluginError, match=r"problem 'kindless' .* returned .*, expected a problem"):
        named_problem("kindless", MESH, registry=registry)


@pytest.mark.usefixtures("strangers")
@pytest.mark.parametrize(
    ("solver", "title", "says"),
    [
        ("nothing", ("solver", "nothing"), "solve returned None, expected a Solution"),
        ("lonely", ("solver", "lonely"), "raised TypeError: Lonely.solve() takes 2 positional arguments"),
        (
            "polydg_mg_paper:smoother=nofunction",
            ("smoother", "nofunction"),
            "setup returned None, expected a function",
        ),
        (
            "polydg_mg_paper:smoother=short",
            ("smoother", "short"),
            "returned shape (2,) of float64, expected (48,)",
        ),
        ("drawn -o u.vtu", ("solver", "drawn"), "raised KeyError: 'no such cell'"),
    ],
)
def test_of_a_solution(solver: str, title: tuple[str, str], says: str, agglo: Agglo) -> None:
    answer = agglo("solve", "squares:4", "--solver", *solver.split())
    assert answer.code == 2
    assert whose(*title) in answer.err
    assert says in answer.err


def test_accepts_is_a_tuple() -> None:
    with pytest.raises(PluginError, match=r"mine: accepts is 'diffusion', expected a tuple such as"):
        require_accepted(TextAccepted(), agglo.Diffusion(), "mine")
    (broken,) = check(TextAccepted, laws=["answers"])
    assert broken.message.startswith("accepts is 'diffusion', expected a tuple")


def test_the_suite_asks_a_solver_for_what_it_accepts_alone(registry: Registry) -> None:
    messages = [result.message for result in check(OnlyHeat, registry=registry) if not result.passed]
    assert messages
    assert not any("Diffusion" in message or "diffusion" in message for message in messages)


def test_a_kind_that_does_not_exist_is_said_by_the_suite(registry: Registry) -> None:
    with pytest.raises(PluginError, match=r"'unkind' .* cannot be used: broken: unknown kind 'bisctor'"):
        check("unkind", registry=registry)
    with pytest.raises(PluginError, match=r"no bisector .*cannot be used: bisctor 'unkind' .*unknown kind"):
        registry.record("bisector", "unkind")


def test_commands_may_hand_over_a_path(tmp_path: Path) -> None:
    agglo.write(tmp_path / "m.npz", MESH)
    assert load_mesh(tmp_path / "m.npz").n_cells == 16


@pytest.mark.usefixtures("strangers")
def test_what_is_not_found_may_be_in_a_blocked_plugin(agglo: Agglo) -> None:
    default().register(SimpleNamespace(), "empty")
    try:
        for asked in (
            ("plugins", "nobody"),
            ("solve", "squares:4", "--solver", "polydg_mg_paper:smoother=nobody"),
        ):
            assert "plugins that cannot be used: plugin 'empty'" in agglo(*asked).err
    finally:
        default().unregister("empty")


def test_masked_results_of_components_are_refused() -> None:
    class Masked:
        def bisect(self, graph: agglo.Graph, rng: np.random.Generator) -> np.ndarray:
            return np.ma.masked_less(np.arange(graph.n) % 2, 1)

    with pytest.raises(PluginError, match=r"Masked.*: the result of bisect has masked entries"):
        agglo.agglomerate(samples.squares(4), n_parts=2, bisector=Masked())
