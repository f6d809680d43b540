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
    "h5py",
    "pyamg",
)
DECLARATIONS = sorted(
    point.value for point in metadata.entry_points(group="agglo") if point.dist and point.dist.name == "agglo"
)


def loaded_by(source: str) -> list[str]:
    """Heavy packages in sys.modules of a fresh interpreter after it ran ``source``."""
    report = f"\nimport json, sys; print(json.dumps([m for m in {HEAVY} if m in sys.modules]))"
    answer = subprocess.run(
        [sys.executable, "-c", source + report], capture_output=True, text=True, check=True
    )
    heavy: list[str] = json.loads(answer.stdout.splitlines()[-1])
    return heavy


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["--help"],
        ["--version"],
        ["plugins"],
        ["plugins", "-v"],
        ["plugins", "--json"],
        ["run", "--help"],
        ["solve", "--help"],
    ],
)
def test_the_command_line_starts_light(arguments: list[str]) -> None:
    source = f"""
from agglo_core.cli import main
try:
    main({arguments})
except SystemExit as done:
    assert done.code == 0, done.code
"""
    assert loaded_by(source) == []


def test_the_list_of_formats_loads_no_optional_package() -> None:
    source = 'from agglo_core.cli.app import app; app.main(["formats"], standalone_mode=False)'
    assert set(loaded_by(source)) <= {"numpy", "scipy"}


@pytest.mark.parametrize("arguments", [["--help"], ["run", "--help"], ["--version"]])
def test_help_does_not_load_rich(arguments: list[str]) -> None:
    source = f"from agglo_core.cli.app import app; app.main({arguments}, standalone_mode=False)"
    answer = subprocess.run(
        [sys.executable, "-c", f"{source}; import sys; print('rich' in sys.modules)"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert answer.stdout.splitlines()[-1] == "False"


@pytest.mark.parametrize(
    "source",
    [
        "import agglo_core",
        "from agglo_core import Command, Component, PluginError, Registry, hookimpl, plugins",
        "import agglo_core; agglo_core.__version__; agglo_core.registry.default().list()",
    ],
)
def test_the_package_is_lazy(source: str) -> None:
    assert loaded_by(source) == []


@pytest.mark.parametrize("module", DECLARATIONS)
def test_declarations_are_light(module: str) -> None:
    assert loaded_by(f"import {module} as m; getattr(m, 'agglo_components', list)()") == []


@pytest.mark.parametrize("name", agglo_core.__all__)
def test_every_public_name_can_be_had(name: str) -> None:
    assert name in dir(agglo_core)
    assert getattr(agglo_core, name) is not None


def test_other_names_are_refused() -> None:
    with pytest.raises(AttributeError, match="'agglo_core' has no attribute 'agglomorate'"):
        agglo_core.agglomorate  # noqa: B018
