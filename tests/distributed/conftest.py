"""Files written by three ranks, for all tests that only read files."""

from __future__ import annotations

from pathlib import Path

import pytest
from distributed.shared_meshes import write_all
from on_ranks import on_ranks


@pytest.fixture(scope="session")
def by_three(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the meshes of :mod:`shared_meshes` as ``.pvtu``."""
    folder = tmp_path_factory.mktemp("by_three")
    on_ranks(3, write_all, str(folder))
    return folder
