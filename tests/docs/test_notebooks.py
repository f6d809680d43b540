"""The notebooks run from top to bottom, show pictures and tables, and are kept without outputs."""

from __future__ import annotations

import json
import os
import re
import sys
from pathlib import Path
from typing import Any

import pytest

NOTEBOOKS = sorted((Path(__file__).parents[2] / "docs" / "notebooks").glob("*.ipynb"))


def test_the_list_of_notebooks() -> None:
    assert [path.stem for path in NOTEBOOKS] == [
        "materials-and-fractures",
        "mesh-to-levels",
        "solving-with-multigrid",
    ]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_no_outputs_are_kept(path: Path) -> None:
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert code
    assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in code)


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_runs_in_a_kernel_and_shows_pictures_and_tables(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    nbformat, nbclient = pytest.importorskip("nbformat"), pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    for variable in ("IPYTHONDIR", "JUPYTER_DATA_DIR", "JUPYTER_RUNTIME_DIR"):
        monkeypatch.setenv(variable, str(tmp_path / variable))
    folders = (*sys.path, os.environ.get("PYTHONPATH", ""))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, folders)))
    notebook = nbformat.read(path, as_version=4)
    nbclient.NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(tmp_path)}}).execute()
    outputs: list[Any] = [each for cell in notebook.cells for each in cell.get("outputs", [])]
    shown = [each.get("data", {}) for each in outputs]
    assert not [each for each in outputs if each.get("name") == "stderr"]
    assert sum("image/png" in data for data in shown) >= 1
    html = [data["text/html"] for data in shown if "text/html" in data]
    assert any("<table>" in each and "data:image/png;base64," in each for each in html)
    assert all(len(each) < 60_000 for each in html)
    if path.stem == "mesh-to-levels":  # of ``verbose=True`` one line is left
        lines = [data.get("text/plain", "") for data in shown]
        assert (
            sum(re.fullmatch(r"building .*agglomerating.*: [\d.]+ s", line) is not None for line in lines)
            == 1
        )
