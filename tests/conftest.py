"""Test configuration: worker threads, hypothesis profiles, command line, and published meshes."""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

if "PYTEST_XDIST_WORKER" in os.environ:  # a worker has one core: BLAS threads would compete
    for _library in ("OMP", "OPENBLAS", "MKL"):
        os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

import numpy as np
import pytest
from command_line import Agglo, caller
from hypothesis import HealthCheck, settings

from agglo_core import Mesh
from agglo_core.compiled import ahead_of_time

# Without byte code each worker and process would compile all sources again.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

ahead_of_time._MOST_BESIDE = 0  # short commands would end other processes before a kernel is compiled

# A compiler and syntax trees hold many objects, which the default would visit again and again.
gc.set_threshold(100_000)

# the first example of a run may compile kernels: disable deadlines and the check for slow data
_patient = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow]}
settings.register_profile("ci", derandomize=True, **_patient)
settings.register_profile("thorough", max_examples=2000, **_patient)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "ci"))

_PUBLISHED = Path(os.environ.get("AGGLO_PAPER_DATA", Path(__file__).parents[2] / "shared/data/paper"))


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Order tests so that two workers start with different kernels and end with short tests.

    xdist first gives each worker an equal part of the list, and later half of the remainder of the other
    worker.
    """
    if not hasattr(config, "workerinput"):
        return
    first, middle, rest = [], [], []
    for item in items:
        folder = item.path.relative_to(Path(__file__).parent).parts[0]
        chosen = {"multigrid": middle, "plugins": middle, "core": rest}.get(folder, first)
        chosen.append(item)
    half = max(len(items) // 2 - len(first), 0)
    items[:] = first + rest[:half] + middle + rest[half:]


@pytest.fixture
def agglo(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Agglo:
    """Run the command line in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return caller(capsys)


@pytest.fixture
def forked_readers() -> Iterator[None]:
    """Read files of the package meshlane in forks; new processes are tested in ``test_io_foreign``."""
    from fuzz.foreign_corpus import without_new_processes

    with without_new_processes():
        yield


@pytest.fixture(scope="session")
def published() -> Callable[[str], Mesh]:
    """Return a function that loads a mesh of the paper's authors by name, or skips the test if missing."""

    def load(name: str) -> Mesh:
        path = _PUBLISHED / f"{name}.npz"
        if not path.exists():
            pytest.skip(f"the authors' mesh {name} is not at {_PUBLISHED} (set AGGLO_PAPER_DATA)")
        data = np.load(path)
        return Mesh.from_polygons(data["points"], (data["cell_offsets"], data["cell_vertices"]), name=name)

    return load
