"""Hypothesis profiles, the command line, and the authors' published meshes where they are at hand."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from command_line import Agglo, caller
from hypothesis import HealthCheck, settings

from agglo_core import Mesh

# the first example of a run may compile kernels: neither deadlines nor "too slow" mean anything
_patient = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow]}
settings.register_profile("ci", derandomize=True, **_patient)
settings.register_profile("thorough", max_examples=2000, **_patient)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "ci"))

_PUBLISHED = Path(os.environ.get("AGGLO_PAPER_DATA", Path(__file__).parents[2] / "shared/data/paper"))


@pytest.fixture
def agglo(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Agglo:
    """Run the command line in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return caller(capsys)


@pytest.fixture(scope="session")
def published() -> Callable[[str], Mesh]:
    """Function that loads a mesh of the paper's authors by name, or skips the test if it is not there."""

    def load(name: str) -> Mesh:
        path = _PUBLISHED / f"{name}.npz"
        if not path.exists():
            pytest.skip(f"the authors' mesh {name} is not at {_PUBLISHED} (set AGGLO_PAPER_DATA)")
        data = np.load(path)
        return Mesh.from_polygons(data["points"], (data["cell_offsets"], data["cell_vertices"]), name=name)

    return load
