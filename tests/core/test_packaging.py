"""Wheels without kernels by default, and with kernels where they are asked for."""

from __future__ import annotations

import subprocess
import tomllib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from agglo_core.packaging.hook import CompiledKernels

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def test_a_build_needs_hatchling_alone() -> None:
    (need,) = PROJECT["build-system"]["requires"]
    assert need.startswith("hatchling")
    assert PROJECT["build-system"]["build-backend"] == "hatchling.build"


def test_pyproject_names_the_hook() -> None:
    (hook,) = PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["hooks"].values()
    assert Path(str(CompiledKernels.initialize.__code__.co_filename)) == ROOT / hook["path"]


def hooked(
    version: str, levels: str, monkeypatch: pytest.MonkeyPatch, returncode: int = 0
) -> tuple[dict[str, Any], list[str], list[list[str]]]:
    """Run the hook with a compiler that ends so, and return its build data, messages and commands."""
    said: list[str] = []
    commands: list[list[str]] = []
    app = SimpleNamespace(display_info=said.append)

    def compile_some(command: list[str], **_: Any) -> Any:
        commands.append(command)
        for number in range(3):
            Path(command[3], f"{number}.nbc").touch()
        return SimpleNamespace(returncode=returncode, stderr="graphs.components: no numba\n")

    monkeypatch.setattr(subprocess, "run", compile_some)
    monkeypatch.setenv("AGGLO_PREBUILD", levels)
    hook: Any = CompiledKernels(str(ROOT), {}, None, None, str(ROOT), "wheel", app)  # type: ignore[arg-type]
    data: dict[str, Any] = {"force_include": {}}
    hook.initialize(version, data)
    hook.finalize(version, data, "")
    return data, said, commands


def test_kernels_of_the_levels_go_into_the_wheel(monkeypatch: pytest.MonkeyPatch) -> None:
    data, said, commands = hooked("standard", "x86-64-v2 x86-64-v4", monkeypatch)
    included = data["force_include"]
    assert [command[4:] for command in commands] == [["x86-64-v2", "x86-64-v4"]]
    assert list(included.values()) == ["agglo_core/compiled/machine_code"]
    assert (data["pure_python"], data["infer_tag"]) == (False, True)
    assert said[1:] == ["3 signatures of kernels compiled"]
    assert not any(map(Path.exists, map(Path, included))), "the folder goes when the wheel is written"


def test_no_wheel_is_built_without_kernels_that_were_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(RuntimeError, match=r"AGGLO_PREBUILD=generic: graphs\.components: no numba"):
        hooked("standard", "generic", monkeypatch, returncode=1)


@pytest.mark.parametrize(("version", "levels"), [("standard", ""), ("editable", "generic")])
def test_nothing_is_compiled_by_default_and_for_an_editable_install(
    version: str, levels: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert hooked(version, levels, monkeypatch) == ({"force_include": {}}, [], [])
