"""Help, listings and declarations import nothing heavy; every public name can be had."""

from __future__ import annotations

import json
import subprocess
import sys
from importlib import metadata

import pytest

import agglo_core

HEAVY = (
    "numpy",
    "scipy",
    "numba",
    "torch",
    "sklearn",
    "pymetis",
    "networkx",
    "shapely",
    "matplotlib",
    "meshlane",
    "pyamg",
)
DECLARATIONS = sorted(
    point.value for point in metadata.entry_points(group="agglo") if point.dist and point.dist.name == "agglo"
)


PACKAGE = [
    "import agglo_core",
    "from agglo_core import Command, Component, PluginError, Registry, hookimpl, plugins",
    "import agglo_core; agglo_core.__version__; agglo_core.registry.default().list()",
    *(f"import {module} as m; getattr(m, 'agglo_components', list)()" for module in DECLARATIONS),
]
HELP = [["--help"], ["run", "--help"], ["--version"], ["solve", "--help"], []]
LISTINGS = [["plugins"], ["plugins", "-v"], ["plugins", "--json"]]

PROGRAM = f"""
import json, sys
from contextlib import redirect_stdout
loaded = {{}}

def note(title):
    loaded[title] = [name for name in {(*HEAVY, "rich")} if name in sys.modules]

for source in {PACKAGE}:
    exec(source, {{}})
    note(source)
from agglo_core.cli import main
for arguments in {[*HELP, *LISTINGS, ["formats"]]}:
    with redirect_stdout(sys.stderr):
        try:
            main(arguments)
        except SystemExit as done:
            assert done.code == 0, (arguments, done.code)
    note(" ".join(arguments))
print(json.dumps(loaded))
"""
"""Import and call one after the other; a package that is loaded is also reported for all that follow."""


@pytest.fixture(scope="module")
def loaded() -> dict[str, list[str]]:
    """Return the heavy packages in ``sys.modules`` of a fresh interpreter after each import and call."""
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True)
    heavy: dict[str, list[str]] = json.loads(done.stdout)
    return heavy


@pytest.mark.parametrize("source", PACKAGE)
def test_the_package_and_its_declarations_are_lazy(source: str, loaded: dict[str, list[str]]) -> None:
    assert loaded[source] == []


@pytest.mark.parametrize("arguments", HELP, ids=" ".join)
def test_help_loads_neither_heavy_packages_nor_rich(
    arguments: list[str], loaded: dict[str, list[str]]
) -> None:
    assert loaded[" ".join(arguments)] == []


@pytest.mark.parametrize("arguments", LISTINGS, ids=" ".join)
def test_listings_start_light(arguments: list[str], loaded: dict[str, list[str]]) -> None:
    assert set(loaded[" ".join(arguments)]) <= {"rich"}


def test_the_list_of_formats_loads_no_optional_package(loaded: dict[str, list[str]]) -> None:
    assert set(loaded["formats"]) <= {"numpy", "rich", "scipy"}


@pytest.mark.parametrize("name", agglo_core.__all__)
def test_every_public_name_can_be_had(name: str) -> None:
    assert name in dir(agglo_core)
    assert getattr(agglo_core, name) is not None


def test_other_names_are_refused() -> None:
    with pytest.raises(AttributeError, match="'agglo_core' has no attribute 'agglomorate'"):
        agglo_core.agglomorate  # noqa: B018
