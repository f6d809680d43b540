"""What is compiled before the first result: each function costs a user a few tenths of a second, once."""

from __future__ import annotations

import ast
import json
import os
import re
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numba
import numpy as np
import pytest
from numba.core import event
from syntax import syntax_tree

from agglo_core.compiled import ahead_of_time, helper
from agglo_core.compiled.first_run import watch_compilation
from agglo_core.compiled.kernel_cache import KernelCache

ROOT = Path(__file__).parents[3]
BENCHMARK = ROOT / "tests" / "benchmarks" / "first_run.py"
README = "run voronoi:n=60,seed=3 --bisector kmeans --bisector metis -o out.vtu --plot out.png"


@helper
def twice(x: int) -> int:
    return 2 * x


def sum_of_doubles(values: Any) -> int:
    total = twice(21)  # a literal, which a kernel would be compiled for once more
    for value in values:
        total += twice(value)
    return total


class Compiled(event.Listener):
    """The names of the functions that numba compiles."""

    def __init__(self) -> None:
        self.names: Counter[str] = Counter()

    def on_start(self, event: Any) -> None:
        self.names[event.data["dispatcher"].py_func.__name__] += 1

    def on_end(self, event: Any) -> None:
        pass


def test_a_helper_is_compiled_once_for_literals_and_variables() -> None:
    listener = Compiled()
    with event.install_listener("numba:compile", listener):
        assert numba.njit(sum_of_doubles)(np.arange(4)) == 54  # not from the disk cache, as a kernel would be
    assert listener.names["twice"] == 1


def test_a_helper_stays_a_function_of_python() -> None:
    assert twice(4) == 8
    assert not hasattr(twice, "py_func")


def decoration(node: ast.AST) -> str:
    """``"kernel"`` or ``"helper"`` for functions that are one, else an empty text."""
    if isinstance(node, ast.FunctionDef):
        for each in node.decorator_list:
            name = each.func if isinstance(each, ast.Call) else each
            if isinstance(name, ast.Name) and name.id in ("kernel", "helper"):
                return name.id
    return ""


def names_used(tree: ast.AST) -> Iterator[tuple[str, str]]:
    """Names that are read, each with the compiled function, or none, in which it stands."""
    nodes = [(tree, "")]
    while nodes:
        node, inside = nodes.pop()
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.Name) and isinstance(child.ctx, ast.Load):
                yield child.id, inside
            elif isinstance(child, ast.Attribute):
                yield child.attr, inside
            nodes.append((child, child.name if decoration(child) else inside))  # type: ignore[attr-defined]


def imported(tree: ast.Module) -> set[tuple[str, str]]:
    """Last part of the module and name of what is imported."""
    froms = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    return {(str(node.module).rpartition(".")[2], alias.name) for node in froms for alias in node.names}


TEXTS = {
    file: file.read_text() for top in ("agglo_core", "plugins") for file in sorted((ROOT / top).rglob("*.py"))
}


@pytest.fixture(scope="module")
def trees() -> dict[Path, ast.Module]:
    """The files that define kernels or helpers, parsed."""
    defining = (file for file, text in TEXTS.items() if re.search(r"@(kernel|helper)\b", text))
    return {file: syntax_tree(file) for file in defining}


@pytest.fixture(scope="module")
def compiled(trees: dict[Path, ast.Module]) -> tuple[dict[str, str], dict[str, set[str]]]:
    """Kernels and helpers by name, and for each the compiled functions ("" for Python) that use it."""
    own = {file: {n.name: decoration(n) for n in ast.walk(t) if decoration(n)} for file, t in trees.items()}  # type: ignore[attr-defined]
    kinds = {name: kind for names in own.values() for name, kind in names.items()}
    users: dict[str, set[str]] = {name: set() for name in kinds}
    homes = {(file.stem, name) for file, names in own.items() for name in names}
    homes |= {("authoring", name) for name in kinds}
    using = (file for file, text in TEXTS.items() if not kinds.keys().isdisjoint(re.findall(r"\w+", text)))
    for file in using:
        tree = syntax_tree(file)
        known = {name for _, name in imported(tree) & homes} | set(own.get(file, ()))
        for name, user in names_used(tree) if known else ():
            if name in known and name != user:
                users[name].add(user)
    return kinds, users


def test_what_only_kernels_call_is_a_helper(compiled: tuple[dict[str, str], dict[str, set[str]]]) -> None:
    kinds, users = compiled
    inner = {
        name for name, kind in kinds.items() if kind == "kernel" and users[name] and "" not in users[name]
    }
    # One calls itself, one is run as it is by its tests, one may sum in another order than its callers.
    inner -= {"_by_pairs", "direction", "moments"}
    assert inner == set(), "helpers compile in less time"


def test_python_calls_no_helper(compiled: tuple[dict[str, str], dict[str, set[str]]]) -> None:
    kinds, users = compiled
    slow = {name for name, kind in kinds.items() if kind == "helper" and "" in users[name]}
    assert slow == set(), "called from Python they run uncompiled"


MAKERS = {
    "empty",
    "zeros",
    "ones",
    "full",
    "arange",
    "empty_like",
    "zeros_like",
    "array",
    "concatenate",
    "copy",
}


GIVEN = {("piece_driver", "_cut_and_refine")}
"""Helpers that call one that is passed to them, which may make arrays."""


def calls_of(node: ast.AST) -> set[str]:
    """Names of the functions and methods that are called."""
    calls = [each.func for each in ast.walk(node) if isinstance(each, ast.Call)]
    plain = {func.id for func in calls if isinstance(func, ast.Name)}
    return plain | {func.attr for func in calls if isinstance(func, ast.Attribute)}


def test_helpers_that_make_arrays_or_call_such_say_so(trees: dict[Path, ast.Module]) -> None:
    said, needed = set(), set()
    calls: dict[tuple[str, str], set[tuple[str, str]]] = {}
    for file, tree in trees.items():
        froms = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
        home = {alias.name: str(node.module).split(".")[-1] for node in froms for alias in node.names}
        helpers = (node for node in tree.body if isinstance(node, ast.FunctionDef))
        for node in (node for node in helpers if decoration(node) == "helper"):
            key, used = (file.stem, node.name), calls_of(node)
            calls[key] = {(home.get(name, file.stem), name) for name in used}
            said |= {key} if "allocates=True" in ast.unparse(node.decorator_list[0]) else set()
            needed |= {key} if MAKERS & used or key in GIVEN else set()
    while wider := {key for key, used in calls.items() if used & needed} - needed:
        needed |= wider
    assert said == needed, "without it numba refuses to compile, or what a helper returned is never freed"


@pytest.mark.slow
def test_readme_compiles_few_functions(tmp_path: Path) -> None:
    report = tmp_path / "compiled.json"
    subprocess.run(
        [sys.executable, str(BENCHMARK), str(report), *README.split()],
        env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")},
        cwd=tmp_path, check=True, capture_output=True,
    )  # fmt: skip
    compiled = json.loads(report.read_text())["compiled"]
    names = [name for name, *_ in compiled if name.startswith("agglo_")]
    assert 20 < len(names) <= 210, Counter(names).most_common()
    # a part is compiled for callers that make arrays and for those that do not, and for labels of a level, of
    # sides and of pieces
    assert max(Counter(names).values()) <= 5, Counter(names).most_common(5)


def test_workers_compile_the_kernels_of_the_core_between_them(monkeypatch: pytest.MonkeyPatch) -> None:
    listed = [Mock(module=f"{package}.kernels") for package in ("agglo_core", "agglo_kmeans", "agglo_core")]
    monkeypatch.setattr(ahead_of_time, "read_signatures", lambda: listed)
    for first in range(2):
        ahead_of_time.compile_share(first, 2)
    assert [each.kernel().compile.call_count for each in listed] == [1, 0, 1]


@pytest.mark.parametrize(("processors", "workers"), [(1, 0), (2, 1), (64, 2)])
def test_workers_leave_a_processor_to_the_run(
    processors: int, workers: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ahead_of_time, "_processors", lambda: processors)
    monkeypatch.setattr(ahead_of_time, "_MOST_BESIDE", 2)
    started = Mock()
    monkeypatch.setattr(subprocess, "Popen", started)
    assert len(ahead_of_time.start_workers()) == started.call_count == workers
    for k, call in enumerate(started.call_args_list):
        assert call.args[0][-1].endswith(f"compile_share({k}, {workers})")


def test_no_worker_starts_where_nothing_can_be_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ahead_of_time, "_processors", lambda: 2)
    monkeypatch.setattr(ahead_of_time, "_MOST_BESIDE", 1)
    monkeypatch.setattr(KernelCache, "cache_path", None)
    assert ahead_of_time.start_workers() == []


def test_workers_import_this_package_and_end_with_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ahead_of_time, "_processors", lambda: 2)
    monkeypatch.setattr(ahead_of_time, "_MOST_BESIDE", 1)
    waiting = "import agglo_core.compiled.ahead_of_time, time; time.sleep(60); #{}"
    monkeypatch.setattr(ahead_of_time, "_SHARE", waiting)
    workers: list[Any] = []
    start = ahead_of_time.start_workers
    monkeypatch.setattr(ahead_of_time, "start_workers", lambda: workers.extend(start()) or workers)
    with watch_compilation(lambda: None, ahead=True):
        numba.njit(sum_of_doubles)(np.arange(4))
        with pytest.raises(subprocess.TimeoutExpired):
            workers[0].wait(timeout=3)  # an import that failed would end it
    assert workers[0].returncode == -signal.SIGTERM


@pytest.mark.slow
def test_readme_compiles_nothing_from_an_installed_wheel(tmp_path: Path) -> None:
    packages = tmp_path / "packages"
    options = ["-q", "--no-build-isolation", "--no-deps", "--no-index", "--target", str(packages)]
    command = [sys.executable, "-m", "pip", "install", *options, str(ROOT)]
    subprocess.run(command, env=os.environ | {"AGGLO_PREBUILD": "generic"}, check=True)
    report = tmp_path / "report.json"
    subprocess.run(
        [sys.executable, str(BENCHMARK), str(report), *README.split()],
        env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": str(packages)},
        cwd=tmp_path, check=True, capture_output=True,
    )  # fmt: skip
    found = json.loads(report.read_text())
    assert [name for name, *_ in found["compiled"] if name.startswith("agglo_")] == [], (
        "write the list anew: python tests/benchmarks/first_run.py --record"
    )
    assert len(found["loaded"]) > 20
