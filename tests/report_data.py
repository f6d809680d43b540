"""Runs for report tests, and the data of a report read from its file."""

from __future__ import annotations

import base64
import json
import re
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from agglo_core import samples
from agglo_core.hierarchy import Hierarchy
from agglo_core.measure.agglomerates import measure_levels
from agglo_core.measure.comparison import RunResult
from agglo_core.mesh import Mesh

EVIL = '<b>&amp;</script><script>document.title = "taken"</script><!--title-->/*data*/'
TWO = 'two & <b>"more"</b>'
OF_TWO = "run=two+%26+%3Cb%3E%22more%22%3C%2Fb%3E"
"""Names with markup, and the URL fragment that selects the second run."""
KINDS = {"Uint8": "<u1", "Uint16": "<u2", "Uint32": "<u4", "Float32": "<f4"}


def sectors(mesh: Mesh, k: int) -> np.ndarray:
    """Return labels by k angular sectors around the origin."""
    x, y = mesh.local_centroids.T
    return np.unique(np.floor((np.arctan2(y, x) / (2 * np.pi) % 1.0) * k) % k, return_inverse=True)[1]


def made(mesh: Mesh, name: str, *counts: int) -> RunResult:
    """Return a run whose levels have these numbers of sectors."""
    targets = [{"h_star": 10.0 / k} for k in counts]
    hierarchy = Hierarchy(mesh, mesh.graph, [sectors(mesh, k) for k in counts], targets, nested=True)
    return RunResult(name, hierarchy, measure_levels(mesh, hierarchy), cpu_seconds=1.5)


def named_ring() -> Mesh:
    """Return 240 cells around a hole, with a name that contains markup."""
    ring = samples.ring(48)
    return Mesh(ring.points, ring.face_offsets, ring.face_vertices, ring.face_cells, name=EVIL)


def two_and_a_failure(mesh: Mesh) -> list[RunResult]:
    failed = RunResult("broken", None, error="bisector 'broken' said <i>no</i>")
    return [made(mesh, "one", 8, 4), failed, made(mesh, TWO, 12, 6, 3)]


def data_of(page: Path) -> dict[str, Any]:
    (found,) = re.findall(r'<script type="application/json" id="data">(.*?)</script>', page.read_text())
    data: dict[str, Any] = json.loads(found)
    return data


def unpacked(packed: dict[str, Any]) -> np.ndarray:
    raw = zlib.decompress(base64.b64decode(packed["data"]))
    kind = np.dtype(KINDS[packed["type"]])
    if packed.get("apart"):
        raw = np.frombuffer(raw, np.uint8).reshape(kind.itemsize, -1).T.tobytes()
    values = np.frombuffer(raw, kind)
    if not packed.get("differences"):
        return values
    codes = values.astype(np.int64)
    return np.cumsum(np.where(codes % 2, -(codes + 1) // 2, codes // 2))


def faces_of(data: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Return the face end points ``(n_faces, 2, 2)`` of a 2-D mesh, and the two cells of each face.

    Coordinates are relative to the lower left corner. Cells have mesh numbers, and -1 marks the outside.
    """
    plane, order = data["plane"], np.append(unpacked(data["order"]), -1)
    points, newest = [], 0
    for back in unpacked(plane["ends"]).tolist():
        points.append(newest - back)
        newest += back == 0
    places = plane["step"] * np.stack([unpacked(plane["x"]), unpacked(plane["y"])], axis=1)
    low, gap = unpacked(plane["low"]), unpacked(plane["gap"]).astype(int)
    cells = np.stack([order[low], order[np.where(gap, low + gap, -1)]], axis=1)
    return places[points].reshape(-1, 2, 2), cells
