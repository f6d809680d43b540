"""Names that users of version 0.1 hold lead to what they meant."""

from __future__ import annotations

import importlib
import subprocess
import sys

import pytest

import agglo_core
from agglo_core.moved import MOVED


@pytest.mark.parametrize("old", MOVED)
def test_an_old_name_gives_the_module_of_today(old: str) -> None:
    sys.modules.pop(f"agglo_core.{old}", None)
    with pytest.warns(DeprecationWarning, match=rf"agglo_core\.{old} is now agglo_core\.{MOVED[old]}"):
        found = importlib.import_module(f"agglo_core.{old}")
    assert found is importlib.import_module(f"agglo_core.{MOVED[old]}")
    assert found.__spec__ is not None
    assert found.__spec__.name == f"agglo_core.{MOVED[old]}"


OLD = [
    "from agglo_core.plot import draw, save_figure",
    "from agglo_core.problem import Diffusion, Linear, Problem, Solution",
    "from agglo_core.plugins import Component, default",
    "from agglo_core.functionals import cut",
    "from agglo_core.sweep import sweep",
    "from agglo_core.arguments import agglomeration_options, choice, load_mesh, parse_value, Value",
    "from agglo_core.comparison import Run, timed_run, wanted",
    "from agglo_core.interchange.rings import mesh_from_shapely",
    "from agglo_core.plugins.registry import Registry, default",
    "from agglo_core.protocols import Aiming, Bisector, LevelBisector, Partitioner",
    "from agglo_core.samples.grids import squares",
    "from agglo_core.report import quality, summary, measure_levels",
    "from agglo_core.pipeline import Pipeline, agglomerate",
    "from agglo_core.defaults.metrics import CircleRatio",
    "from agglo_core.mesh import Mesh, Loops, check_labels",
    "from agglo_core.graph import Graph",
    "from agglo_core.hierarchy import Hierarchy, Tree",
    "from agglo_core.io import read, read_hierarchy, write",
    "import agglo_core.plot; agglo_core.plot.draw",
]
FIRST_OF_ALL = """
import sys
found, modules = list(sys.meta_path), set(sys.modules)
for statement in sys.argv[1:]:
    sys.meta_path[:] = found
    for name in [each for each in sys.modules if each.startswith("agglo_") and each not in modules]:
        del sys.modules[name]
    try:
        exec(statement, {})
    except BaseException as error:
        print(statement, repr(error))
"""


def test_imports_of_old_programs_go_on_working() -> None:
    program = [sys.executable, "-W", "ignore", "-c", FIRST_OF_ALL, *OLD]
    done = subprocess.run(program, capture_output=True, text=True, check=True)
    assert done.stdout == ""


def test_modules_of_a_moved_folder_are_not_loaded_twice() -> None:
    with pytest.warns(DeprecationWarning, match="now agglo_core.registry.records"):
        old = importlib.import_module("agglo_core.plugins.records")
    assert old is importlib.import_module("agglo_core.registry.records")


def test_what_readme_names_is_at_hand_without_a_warning(recwarn: pytest.WarningsRecorder) -> None:
    assert agglo_core.plugins.default().record("bisector", "kmeans").state == "ok"
    assert callable(agglo_core.plot.draw)
    assert agglo_core.Diffusion(source=2.0).source == 2.0
    assert not recwarn.list


def test_the_package_can_be_run() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "agglo_core", "--version"], capture_output=True, text=True, check=True
    )
    assert done.stdout.startswith("agglo, version")


def test_names_that_never_were_are_not_found() -> None:
    with pytest.raises(ModuleNotFoundError):
        importlib.import_module("agglo_core.plotting")
