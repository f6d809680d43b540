"""What a wheel is built with, and that one is built where kernels cannot be compiled."""

from __future__ import annotations

import subprocess
import tomllib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hatchling.build import get_requires_for_build_editable

from agglo_core.packaging import backend
from agglo_core.packaging.hook import CompiledKernels

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


@pytest.fixture(autouse=True)
def at_the_root(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    for name in ("AGGLO_PREBUILD", *backend._CONSTRAINING):
        monkeypatch.delenv(name, raising=False)


def needed() -> list[str]:
    return [line for line in backend.get_requires_for_build_wheel() if line.startswith(("num", "llvm"))]


def test_a_wheel_is_built_with_the_tested_versions() -> None:
    tested = (ROOT / "constraints.txt").read_text().split()
    assert sorted(line.partition("==")[0] for line in needed()) == ["llvmlite", "numba", "numpy"]
    assert set(needed()) <= set(tested)


@pytest.mark.parametrize("name", backend._CONSTRAINING)
def test_constraints_of_the_user_are_left_their_choice(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(name, "mine.txt")
    assert len(needed()) == 2
    assert set(needed()) <= set(PROJECT["project"]["dependencies"])


def test_a_newer_python_takes_the_versions_it_can(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(backend, "_NEWEST_TESTED", (3, 10))
    assert set(needed()) <= set(PROJECT["project"]["dependencies"])


def test_numba_is_not_asked_for_where_nothing_is_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    assert get_requires_for_build_editable() == backend.get_requires_for_build_editable()
    assert not any("numba" in line for line in backend.get_requires_for_build_editable())
    monkeypatch.setenv("AGGLO_PREBUILD", "0")
    assert needed() == []


def test_pyproject_names_the_backend_and_the_hook() -> None:
    assert PROJECT["build-system"]["build-backend"] == backend.__name__
    (hook,) = PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["hooks"].values()
    assert Path(str(CompiledKernels.initialize.__code__.co_filename)) == ROOT / hook["path"]


def hooked(
    version: str, monkeypatch: pytest.MonkeyPatch, returncode: int, kernels: int
) -> tuple[dict[str, Any], list[str]]:
    """Run the hook with a compiler that ends so, and return its build data and messages."""
    said: list[str] = []
    app = SimpleNamespace(display_info=said.append, display_warning=lambda text: said.append(f"! {text}"))

    def compile_some(command: list[str], **_: Any) -> Any:
        for number in range(kernels):
            Path(command[3], f"{number}.nbc").touch()
        return SimpleNamespace(returncode=returncode, stderr="graphs.components: no numba\n")

    monkeypatch.setattr(subprocess, "run", compile_some)
    hook: Any = CompiledKernels(str(ROOT), {}, None, None, str(ROOT), "wheel", app)  # type: ignore[arg-type]
    data: dict[str, Any] = {"force_include": {}}
    hook.initialize(version, data)
    hook.finalize(version, data, "")
    return data, said


def test_kernels_go_into_the_wheel(monkeypatch: pytest.MonkeyPatch) -> None:
    data, said = hooked("standard", monkeypatch, 0, 3)
    included = data["force_include"]
    assert list(included.values()) == ["agglo_core/compiled/machine_code"]
    assert (data["pure_python"], data["infer_tag"]) == (False, True)
    assert said[0] == "compiling numerical kernels, which takes about a minute"
    assert said[1:] == ["3 signatures of kernels compiled"]
    assert not any(map(Path.exists, map(Path, included))), "the folder goes when the wheel is written"


def test_a_wheel_without_kernels_is_built_where_none_compiles(monkeypatch: pytest.MonkeyPatch) -> None:
    data, said = hooked("standard", monkeypatch, 1, 0)
    assert data == {"force_include": {}}
    assert said[1] == "! these kernels are compiled on first use instead: graphs.components: no numba"


def test_a_wheel_has_those_that_compile(monkeypatch: pytest.MonkeyPatch) -> None:
    data, said = hooked("standard", monkeypatch, 1, 2)
    assert len(data["force_include"]) == 1
    assert said[1].startswith("! these kernels")


def test_nothing_is_compiled_for_an_editable_install_or_if_unwanted(monkeypatch: pytest.MonkeyPatch) -> None:
    assert hooked("editable", monkeypatch, 0, 3) == ({"force_include": {}}, [])
    monkeypatch.setenv("AGGLO_PREBUILD", "0")
    assert hooked("standard", monkeypatch, 0, 3) == ({"force_include": {}}, [])


def test_the_levels_of_the_environment_are_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AGGLO_PREBUILD", "x86-64-v2 x86-64-v4")
    commands: list[list[str]] = []

    def ended(command: list[str], **_: Any) -> Any:
        commands.append(command)
        return SimpleNamespace(returncode=0)

    monkeypatch.setattr(subprocess, "run", ended)
    app = SimpleNamespace(display_info=str)
    hook: Any = CompiledKernels(str(ROOT), {}, None, None, str(ROOT), "wheel", app)  # type: ignore[arg-type]
    hook.initialize("standard", {"force_include": {}})
    assert [command[4:] for command in commands] == [["x86-64-v2", "x86-64-v4"]]
