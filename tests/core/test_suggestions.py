"""Wrong calls of public functions: the error names the closest keyword, or the call to write."""

from __future__ import annotations

import inspect
import pydoc
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given, strategies as st

import agglo_core as agglo
from agglo_core import OptionError, Pipeline
from agglo_core.agglomeration.keywords import NAMES
from agglo_core.suggestions import did_you_mean, suggest_keywords

MESH = agglo.samples.squares(4)
FUNCTIONS = [
    value
    for value in (getattr(agglo, name) for name in agglo.__all__)
    if inspect.isfunction(value) and len(inspect.signature(value).parameters) > 2
]


@given(st.sampled_from(NAMES), st.data())
def test_a_missing_letter_does_not_hide_a_keyword(name: str, data: st.DataObject) -> None:
    place = data.draw(st.integers(0, len(name) - 1))
    assert did_you_mean(name[:place] + name[place + 1 :], NAMES) == f" (did you mean {name!r}?)"


def test_names_that_are_not_close_are_not_suggested() -> None:
    assert did_you_mean("temperature", NAMES) == did_you_mean("n_parts", []) == ""


def test_the_functions_of_the_package_are_tested() -> None:
    names = {function.__name__ for function in FUNCTIONS}
    assert names == {
        "adapt",
        "agglomerate",
        "build_levels",
        "evolve",
        "newton",
        "quality",
        "read",
        "read_hierarchy",
        "solve",
        "write",
    }


CLASSES = [Pipeline, agglo.Diffusion, agglo.Elasticity, agglo.Linear]


@pytest.mark.parametrize("function", [*FUNCTIONS, *CLASSES])
def test_each_mistyped_keyword_names_the_right_one(function: Callable[..., Any]) -> None:
    first = () if function in CLASSES else (MESH,)
    names = [name for name in inspect.signature(function).parameters if len(name) > 3 and name != "options"]
    assert names
    required = {"problem": 1, "u0": 0.0, "t_end": 1.0, "step": 0.5} if function is agglo.evolve else {}
    required |= {"linearised": agglo.Diffusion} if function is agglo.newton else {}
    for name in names:
        given = {key: value for key, value in required.items() if key != name}
        with pytest.raises((TypeError, OptionError), match=rf"'{name[:-1]}' \(did you mean '{name}'\?\)"):
            function(*first, **given, **{name[:-1]: 1})


@pytest.mark.parametrize(
    ("arguments", "keywords", "call"),
    [
        ((50,), {}, "n_parts=50"),
        (((50, 10),), {"seed": 1}, "n_parts=(50, 10), seed=1"),
        ((0.5,), {}, "h_star=0.5"),
        (([0.5, 1],), {}, "h_star=[0.5, 1]"),
        (("metis",), {"n_parts": 3}, "bisector='metis', n_parts=3"),
        ((50, "metis"), {}, "n_parts=50, bisector='metis'"),
    ],
)
def test_values_without_a_name_are_refused_with_the_call(
    arguments: tuple[Any, ...], keywords: dict[str, Any], call: str
) -> None:
    with pytest.raises(TypeError) as caught:
        agglo.agglomerate(MESH, *arguments, **keywords)
    start = f"agglomerate() takes 1 positional argument (mesh), given {1 + len(arguments)}: "
    assert str(caught.value) == f"{start}write agglomerate(mesh, {call})"


def test_other_functions_list_the_names() -> None:
    with pytest.raises(TypeError) as caught:
        agglo.build_levels(None, None, [0, 2])  # type: ignore[call-arg]
    assert str(caught.value) == (
        "build_levels() takes 2 positional arguments (A, hierarchy), given 3: "
        "give the others by name (block_offsets, near_null)"
    )
    with pytest.raises(TypeError, match=r"^read\(\) .* 'temperature'; accepted: path, merge_points, allow"):
        agglo.read("a.vtu", temperature=3)  # type: ignore[call-arg]


@pytest.mark.parametrize(
    ("option", "hint"),
    [("degre", "degree"), ("toleranc", "tolerance"), ("verbos", "verbose"), ("problm", "problem")],
)
def test_options_of_a_solve_are_those_of_the_solver_and_of_the_function(option: str, hint: str) -> None:
    options: dict[str, Any] = {option: 1}
    with pytest.raises(OptionError, match=rf"no option '{option}' \(did you mean '{hint}'\?\)"):
        agglo.solve(MESH, **options)


def test_keywords_of_solve_beside_a_solver_object() -> None:
    solver = agglo.registry.default().build("solver", "direct")
    with pytest.raises(OptionError, match=r"given verbos \(did you mean 'verbose'\?\) with a solver object"):
        agglo.solve(MESH, solver=solver, verbos=True)


def test_signature_and_help_are_those_of_the_function() -> None:
    signature = inspect.signature(agglo.agglomerate)
    assert list(signature.parameters)[:3] == ["mesh", "h_star", "h_factor"]
    assert signature.parameters["n_parts"].kind is inspect.Parameter.KEYWORD_ONLY
    words = " ".join(pydoc.plain(pydoc.render_doc(agglo.agglomerate)).split())  # one line or several
    assert "agglomerate(mesh: 'Mesh | Graph', *, h_star: " in words.replace("( mesh", "(mesh")
    assert next(iter(inspect.signature(Pipeline).parameters)) == "bisector"


def test_type_errors_of_the_function_itself_pass() -> None:
    @suggest_keywords()
    def fail(mesh: object, *, axis: int = 0) -> None:
        raise TypeError("of the function")

    with pytest.raises(TypeError, match=r"^of the function$"):
        fail(MESH, axis=1)
    with pytest.raises(TypeError, match="missing 1 required positional argument: 'mesh'"):
        fail()  # type: ignore[call-arg]
