"""Machine code is taken from disk for the sources, versions and processor it was made for, or not at all."""

from __future__ import annotations

import ast
import os
import pickle
import re
import shutil
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from forked import run_in_fork
from numba import int64
from numba.core.errors import TypingError
from syntax import syntax_tree

from agglo_core.compiled import compile_lock, kernel, kernel_cache
from agglo_core.compiled.ahead_of_time import compile_listed, read_signatures
from agglo_core.compiled.cpu_levels import LEVELS, supported_levels
from agglo_core.compiled.kernel_cache import KernelCache, source_stamp, sources
from agglo_core.lazy_names import names_in_stub

ROOT = Path(__file__).parents[3]


def files_of_kernels(folder: Path) -> list[Path]:
    """List the files that define kernels or helpers."""
    texts = {file: file.read_text("utf-8") for file in sorted(folder.rglob("*.py"))}
    return [file for file, text in texts.items() if re.search(r"^@(kernel|helper)\b", text, re.MULTILINE)]


KERNELS, PLUGINS = files_of_kernels(ROOT / "agglo_core"), files_of_kernels(ROOT / "plugins")
SUMS = ROOT / "agglo_core" / "compiled" / "sums.py"

HELPERS = """
from agglo_core.authoring import helper

@helper
def factor():
    return {factor}
"""
LOOPS = """
from agglo_core.authoring import kernel
from helpers import factor

@kernel
def multiplied(x):
    return factor() * x
"""
RUN = """
from pathlib import Path
from loops import multiplied
multiplied._cache.write_to(Path("installed")) if {write} else None
multiplied._cache._installed = multiplied._cache._files_in(Path("installed"))
print(multiplied(7), sum(multiplied.stats.cache_hits.values()))
"""


def test_a_kernel_whose_helper_changed_is_recompiled(tmp_path: Path) -> None:
    def run(factor: int, write: bool = False) -> list[int]:
        (tmp_path / "helpers.py").write_text(HELPERS.format(factor=factor))
        (tmp_path / "loops.py").write_text(LOOPS)
        found, _ = run_in_fork(RUN.format(write=write), tmp_path, tmp_path / "own")
        return [int(word) for word in found.split()]

    (tmp_path / "installed").mkdir()
    assert run(2, write=True) == [14, 0]
    assert run(2) == [14, 1]  # installed; there is no other
    assert not (tmp_path / "own").exists() or not list((tmp_path / "own").rglob("*.nbc"))
    assert run(3) == [21, 0]  # neither the installed one nor, next, that of the user
    assert run(3) == [21, 1]


MOMENTS = """
import numpy as np
from agglo_core.authoring import helper, kernel

@helper(reorder_sums=True)
def fourth_moment(x, y, w):
    re, im = 0.0, 0.0
    for i in range(len(x)):
        u, v = float(x[i]), float(y[i])
        p, q = u * u - v * v, 2.0 * u * v
        re += w[i] * (p * p - q * q)
        im += w[i] * 2.0 * p * q
    return re, im

@kernel
def moments(x, y, w):  # several calls, or the helper would be inlined
    return fourth_moment(x, y, w), fourth_moment(y, w, x), fourth_moment(w, x, y)
"""
BITS = """
from loops import moments, np
for n in (64, 100, 1000):
    values = np.random.default_rng(0).standard_normal((3, n)).astype(np.float32)
    print(*(each.hex() for pair in moments(*values) for each in pair))
print(sum(moments.stats.cache_hits.values()))
"""


def test_sums_keep_their_last_bit_when_a_kernel_is_loaded_instead_of_compiled(tmp_path: Path) -> None:
    """Both run the code in the file: a helper is compiled for itself, too, and rounds otherwise there."""
    (tmp_path / "loops.py").write_text(MOMENTS)
    compiled, loaded = (run_in_fork(BITS, tmp_path, tmp_path / "own")[0].splitlines() for _ in range(2))
    assert (compiled[-1], loaded[-1], len(compiled)) == ("0", "1", 4)
    assert compiled[:-1] == loaded[:-1]


def double(x: int) -> int:
    return 2 * x


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Any]:
    """A folder with one installed kernel, and what numba compiles for."""
    folder = tmp_path_factory.mktemp("installed")
    compiled = kernel(double)
    compiled._cache.write_to(folder)
    compiled.compile((int64,))
    return folder, compiled.targetctx


def loaded(folder: Path, context: Any) -> Any:
    cache = KernelCache(double, folder)
    cache._cache_file = cache._files_in(folder / "nothing")
    return cache.load_overload((int64,), context)


def test_an_installed_kernel_is_loaded(kept: tuple[Path, Any]) -> None:
    folder, context = kept
    assert loaded(folder, context).entry_point is not None


def test_machine_code_is_not_loaded_on_another_processor(kept: tuple[Path, Any]) -> None:
    folder, context = kept
    triple, name, features = context.codegen().magic_tuple()
    for machine in ((triple, "another", features), (triple, name, "")):
        codegen = SimpleNamespace(magic_tuple=lambda machine=machine: machine)
        other = SimpleNamespace(refresh=lambda: None, codegen=lambda codegen=codegen: codegen)
        assert loaded(folder, other) is None


def features_of(*levels: str) -> str:
    return ",".join(f"+{name}" for level in levels for name in LEVELS[level].split())


@pytest.mark.slow
def test_a_kernel_for_a_level_runs_on_all_processors_of_that_level(tmp_path: Path) -> None:
    (listed,) = [each for each in read_signatures() if each.name == "half_edges"]
    assert compile_listed(tmp_path, [listed], "x86-64-v2") == []
    cache = listed.kernel()._cache
    (_, (triple, level, features), _) = file_key(next(tmp_path.glob("*.nbc")))
    assert (level, features) == ("x86-64-v2", "")

    def found(cpu: str, features: str) -> bool:
        codegen = SimpleNamespace(magic_tuple=lambda: (triple, cpu, features))
        key = cache._index_key(listed.types(), codegen)
        files = cache._files_in(tmp_path)
        return any(files.load(each) is not None for each in kernel_cache._keys_of_levels(key))

    assert found("nehalem", features_of("x86-64-v2"))
    assert found("haswell", features_of("x86-64-v2", "x86-64-v3") + ",-avx512f,+newer")
    assert not found("core2", features_of("x86-64-v2").replace("+popcnt", "-popcnt"))
    assert not found("x86-64-v3", "")  # numba was told to compile for another processor


def file_key(file: Path) -> Any:
    """Key of numba under which a file holds machine code."""
    return pickle.loads(file.read_bytes()[kernel_cache._HASH :])[0]


def test_levels_end_at_the_first_feature_that_is_absent() -> None:
    with_v4_only = features_of("x86-64-v2", "x86-64-v4")
    assert supported_levels(with_v4_only) == ("x86-64-v2", "generic")
    assert supported_levels(features_of(*LEVELS)) == tuple(reversed(LEVELS))
    assert supported_levels("") == ("generic",)


def test_an_unknown_level_is_refused(tmp_path: Path) -> None:
    (line,) = compile_listed(tmp_path, read_signatures(), "v3")
    assert line == "unknown processor level 'v3': expected one of generic, x86-64-v2, x86-64-v3, x86-64-v4"


def test_machine_code_is_not_loaded_for_other_sources(
    kept: tuple[Path, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, context = kept
    monkeypatch.setattr(kernel_cache, "source_stamp", lambda file: "other")
    assert loaded(folder, context) is None


def test_machine_code_is_not_loaded_by_another_numba(
    kept: tuple[Path, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, context = kept
    monkeypatch.setattr("numba.__version__", "0.0")
    assert loaded(folder, context) is None


def test_another_numpy_has_another_stamp(monkeypatch: pytest.MonkeyPatch) -> None:
    before = source_stamp.__wrapped__(SUMS)
    assert source_stamp.__wrapped__(SUMS) == before
    monkeypatch.setattr(np, "__version__", "0.0")
    assert source_stamp.__wrapped__(SUMS) != before


def test_processes_that_save_at_once_keep_the_code_of_each_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second process saves other machine code while the first is about to write its own."""
    first, second = (KernelCache(double)._files_in(tmp_path) for _ in range(2))
    write = first._save_data

    def interrupted(name: str, data: Any) -> None:
        second.save("float64", "code for float64")
        write(name, data)

    monkeypatch.setattr(first, "_save_data", interrupted)
    first.save("int64", "code for int64")
    after = KernelCache(double)._files_in(tmp_path)
    assert [after.load(each) for each in ("int64", "float64")] == ["code for int64", "code for float64"]
    after.flush()
    assert not list(tmp_path.iterdir())


DAMAGES = {
    "cut": lambda data, at: data[:at],
    "a bit turned over": lambda data, at: data[:at] + bytes([data[at] ^ 16]) + data[at + 1 :],
    "zeros": lambda data, at: data[:at] + bytes(64) + data[at + 64 :],
    "empty": lambda data, at: b"",
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_file_is_recompiled_not_unpickled(tmp_path: Path, damage: str) -> None:
    """Machine code is not unpickled before its hash is right, and the file is mended."""
    found = kernel_cache._CacheFiles(str(tmp_path), "one", "stamp")
    kept = {("float64",): (b"machine code", 1.5), ("int64",): (b"other code", 2.5)}
    for key, data in kept.items():
        found.save(key, data)
    files = sorted(tmp_path.glob("*.nbc"))
    assert len(files) == len(kept)
    rng = np.random.default_rng(0)
    for _ in range(30):
        file = files[rng.integers(len(files))]
        whole = file.read_bytes()
        file.write_bytes(DAMAGES[damage](whole, rng.integers(len(whole) - 64)))
        assert None in [found.load(key) for key in kept]
        for key, data in kept.items():
            assert found.load(key) in (None, data)
            found.save(key, data)
        assert {key: found.load(key) for key in kept} == kept


@pytest.mark.slow
def test_runs_with_damaged_files_of_kernels_print_the_same(tmp_path: Path) -> None:
    cache, answers = tmp_path / "cache", set()
    rng = np.random.default_rng(1)
    for damage in (None, *DAMAGES.values()):
        if damage:  # to two files, which the run before has mended
            files = sorted(cache.rglob("*.nbc"))
            assert len(files) > 6
            for file in rng.choice(len(files), 2, replace=False):
                data = files[file].read_bytes()
                files[file].write_bytes(damage(data, rng.integers(max(1, len(data) - 64))))
        run = subprocess.run(
            [sys.executable, "-c", SMALL_KERNELS],
            env=os.environ | {"NUMBA_CACHE_DIR": str(cache)}, capture_output=True, text=True, check=True,
        )  # fmt: skip
        answers.add(run.stdout)
    assert len(answers) == 1


SMALL_KERNELS = """
import numpy as np
from agglo_core import samples
mesh, labels = samples.squares(8), np.arange(64) // 8
print(mesh.graph.part_diameters(labels), mesh.graph.components(labels), mesh.coarsen(labels).cells)
"""


AT_ONCE = """
import os, sys
import numba, numpy as np
from agglo_core.authoring import kernel

numba.njit(lambda x: 2 * x)(1.5)  # the compiler is there; what it does first is done once
for trial in range(10):
    numba.config.CACHE_DIR = f"cold{trial}"
    start = os.pipe()
    children = []
    for number in range(21):  # the last one after the others, to look at what they have kept
        if number == 20:
            os.close(start[1])
            codes = {os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) for child in children}
        child = os.fork()
        if child == 0:
            if number < 20:
                os.close(start[1])
                os.read(start[0], 1)  # until all are there
            from loops import multiplied
            x = (np.int64, np.float64, np.float32, np.int32)[number % 4](3)
            whole = multiplied(x) == 15 and type(multiplied(x)) is (int if number % 4 in (0, 3) else float)
            kept = number < 20 or sum(multiplied.stats.cache_hits.values()) == 1
            os._exit(0 if whole and kept else 1)
        children.append(child)
    codes.add(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
    print(*codes)
"""


@pytest.mark.slow
def test_twenty_processes_share_an_empty_cache(tmp_path: Path) -> None:
    """They compile four signatures of one kernel at once, ten times; one more finds its own on disk."""
    (tmp_path / "helpers.py").write_text(HELPERS.format(factor=5))
    (tmp_path / "loops.py").write_text(LOOPS)
    run = subprocess.run(
        [sys.executable, "-c", AT_ONCE], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert run.stdout.split() == ["0"] * 10
    assert run.stderr == ""


MISSES = """
import sys
from loops import multiplied
sys.stdin.readline()
multiplied(7)
print(sum(multiplied.stats.cache_misses.values()))
"""


@pytest.mark.slow
def test_of_processes_that_need_a_kernel_at_once_one_compiles_it(tmp_path: Path) -> None:
    (tmp_path / "helpers.py").write_text(HELPERS.format(factor=5))
    (tmp_path / "loops.py").write_text(LOOPS)
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    pipes |= {"cwd": tmp_path, "env": os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}}
    runs: list[Any] = [subprocess.Popen([sys.executable, "-c", MISSES], **pipes) for _ in range(2)]
    for run in runs:
        run.stdin.write("\n")
        run.stdin.flush()
    assert sorted(run.communicate()[0] for run in runs) == ["0\n", "1\n"]
    assert not list(tmp_path.rglob("*.lock"))


FAILS = """
from agglo_core.authoring import kernel

@kernel
def added(x):
    return x + "1"
"""


def test_a_kernel_that_does_not_compile_stays_unlocked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "fails.py").write_text(FAILS)
    monkeypatch.syspath_prepend(tmp_path)
    added = import_module("fails").added
    for _ in range(2):
        with pytest.raises(TypingError, match="No implementation of function"):
            added(1)
    assert not list(tmp_path.rglob("*.lock"))


def test_a_lock_in_a_removed_folder_is_released(tmp_path: Path) -> None:
    file = tmp_path / "kernels" / "one.lock"
    for _ in range(2):
        file.parent.mkdir()
        compile_lock.acquire(file)
        assert file.exists()
        shutil.rmtree(file.parent)
        compile_lock.release(file)


FULL = """
import logging, resource
logging.basicConfig(format="%(levelname)s %(message)s", force=True)
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
from loops import multiplied
print(multiplied(7), multiplied(7.0))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="limits of Linux")
def test_a_full_disk_costs_the_kernels_and_not_the_run(tmp_path: Path) -> None:
    (tmp_path / "helpers.py").write_text(HELPERS.format(factor=2))
    (tmp_path / "loops.py").write_text(LOOPS)
    out, err = run_in_fork(FULL, tmp_path, tmp_path / "own")
    assert out == "14 14.0\n"
    assert re.fullmatch(
        r"WARNING compiled kernels cannot be written to .*own.*: File too large; "
        r"kernels are compiled again in each run\. Set NUMBA_CACHE_DIR to a writable folder\n",
        err,
    )
    assert [file for file in (tmp_path / "own").rglob("*") if file.is_file()] == []


def test_machine_code_of_other_sources_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Several checkouts share one folder."""
    old = KernelCache(double)._files_in(tmp_path)
    old.save("signature", "old")
    monkeypatch.setattr(kernel_cache, "source_stamp", lambda file: "other")
    new = KernelCache(double)._files_in(tmp_path)
    assert new.load("signature") is None
    new.save("signature", "new")
    assert (old.load("signature"), new.load("signature")) == ("old", "new")


def test_files_unused_for_longest_are_removed_from_a_large_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = [kernel_cache._CacheFiles(str(tmp_path), name, "stamp") for name in "abc"]
    for age, file in enumerate(files):
        file.save("signature", "x" * 1000)
        os.utime(*tmp_path.glob(f"{file._name('signature')}"), (age, age))
    assert files[0].load("signature") is not None  # now the newest
    monkeypatch.setattr(kernel_cache, "_MOST_BYTES", 2500)
    kernel_cache._limit_size.__wrapped__(tmp_path)
    assert [file.load("signature") is None for file in files] == [False, True, False]


def test_a_copy_of_the_sources_compiles_nothing(tmp_path: Path) -> None:
    """As another environment or checkout does."""
    for folder, hits in (("first", 0), ("second", 1)):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "helpers.py").write_text(HELPERS.format(factor=2))
        (tmp_path / folder / "loops.py").write_text(LOOPS)
        found, _ = run_in_fork(SHARED, tmp_path / folder, tmp_path / "kernels")
        assert found.split() == ["14", str(hits)]


SHARED = """
from loops import multiplied
print(multiplied(7), sum(multiplied.stats.cache_hits.values()))
"""


def home(module: str, name: str) -> str:
    """Name of the module that a statement ``from module import name`` leads to."""
    if module == "agglo_core.authoring":
        module, name = names_in_stub(ROOT / "agglo_core" / "authoring.pyi")[name]
    return f"{module}.{name}" if f"{module}.{name}" in sys.modules else module


def imports(file: Path) -> set[Path]:
    """Twin of one step of ``sources``: from the syntax tree, and from where modules are in fact."""
    nodes = [node for node in syntax_tree(file).body if isinstance(node, ast.ImportFrom)]
    modules = {home(str(node.module), alias.name) for node in nodes for alias in node.names}
    packages = (
        "agglo_core",
        file.relative_to(ROOT / "plugins").parts[0] if file in PLUGINS else "agglo_core",
    )
    ours = {name for name in modules if name.split(".")[0] in packages}
    return {Path(str(import_module(name).__file__)) for name in ours}


def test_all_that_a_file_of_kernels_imports_is_in_its_stamp() -> None:
    assert len(KERNELS) > 50
    missing = []
    for file in [*KERNELS, *PLUGINS]:
        package = file.relative_to(ROOT / "plugins" if file in PLUGINS else ROOT).with_suffix("").parts
        import_module(".".join(package))
        found = sources(file)
        assert file in found
        missing += [
            (file, source, imports(source) - found) for source in found if not imports(source) <= found
        ]
    assert not missing


def test_packages_that_are_installed_beside_are_not_in_the_stamp(tmp_path: Path) -> None:
    """Otherwise the machine code of a wheel, built in a checkout, fits no installation."""
    for file, text in {
        "mine/__init__.py": "",
        "mine/loops.py": "from numba import njit\nfrom mine.parts import part\n",
        "mine/parts.py": "from agglo_core.compiled.sums import np\n",
        "numba/__init__.py": "njit = None\n",
    }.items():
        (tmp_path / file).parent.mkdir(exist_ok=True)
        (tmp_path / file).write_text(text)
    beside = {file for file in sources(tmp_path / "mine/loops.py") if file.is_relative_to(tmp_path)}
    assert beside == {tmp_path / "mine/loops.py", tmp_path / "mine/parts.py"}
    assert SUMS in sources(tmp_path / "mine/loops.py")


def test_every_kernel_is_kept_so() -> None:
    for one in read_signatures():
        assert isinstance(one.kernel()._cache, KernelCache), one


WITHOUT = """
import numba.core.caching
del numba.core.caching.CompileResultCacheImpl  # the name; numba itself does not look it up again
from agglo_core.compiled.graphs import components
print(type(components._cache).__name__)
"""


def test_a_numba_that_keeps_machine_code_otherwise_keeps_its_own_way(tmp_path: Path) -> None:
    run = subprocess.run(
        [sys.executable, "-c", WITHOUT], capture_output=True, text=True, check=True, cwd=tmp_path
    )
    assert run.stdout == "FunctionCache\n"


def test_what_is_listed_are_kernels_with_arguments() -> None:
    assert len(read_signatures()) > 20
    for one in read_signatures():
        function = one.kernel().py_func
        assert len(one.types()) == function.__code__.co_argcount, one


def test_a_kernel_that_does_not_compile_is_reported(tmp_path: Path) -> None:
    wrong = read_signatures()[-1]._replace(arguments="(int64,)")
    (line,) = compile_listed(tmp_path, [wrong], "generic")
    assert line.startswith(f"{wrong.module}.{wrong.name}: ")
    assert not list(tmp_path.iterdir())
