"""The study from its size to its page: plan the work, do what is not stored yet, write."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from agglo_core.authoring import AggloError, FileError, staging
from agglo_paper.record import Page
from agglo_paper.store import Store, Unit
from agglo_paper.study.ranks import Measured
from agglo_paper.study.study_figure import draw
from agglo_paper.study.study_page import page
from agglo_paper.study.study_partitions import chosen
from agglo_paper.study.study_work import measured

__all__ = ["Size", "build", "sources"]

Begin = Callable[[Sequence[Unit], str], Callable[[Unit, bool], None]]
_PACKAGES: Final = (
    "agglo_paper",
    "agglo_polydg_mg",
    "agglo_kmeans",
    "agglo_metis",
    "agglo_spectral",
    "agglo_gnn",
)


@dataclass(frozen=True)
class Size:
    """How much is computed: meshes of so many cells, partitions of each, degrees; seed of the first mesh."""

    meshes: int
    cells: int
    partitions: int
    per_part: int
    degrees: tuple[int, ...]
    seed: int = 0

    @property
    def command(self) -> str:
        """The command line that computes as much."""
        amounts = f"--meshes {self.meshes} --cells {self.cells} --partitions {self.partitions}"
        degrees = ",".join(map(str, self.degrees))
        rest = f"--cells-per-part {self.per_part} --degrees {degrees} --seed {self.seed}"
        return f"agglo study shapes {amounts} {rest}"


def sources(size: Size) -> list[str]:
    """The meshes: Voronoi, random triangles, squares by turns, each with a seed of its own."""
    found = []
    for place in range(size.meshes):
        seed, side = size.seed + place, round(size.cells**0.5) + 2 * (place // 3)
        kinds = (f"voronoi:n={size.cells},seed={seed}", f"random_triangles:n={size.cells // 2},seed={seed}")
        found.append((*kinds, f"squares:n={side}")[place % 3])
    return found


def build(folder: Path, size: Size, begin: Begin) -> Page:
    """Compute, write ``shapes.md``, ``shapes.json`` and, with matplotlib, ``shapes.svg``.

    Raises
    ------
    FileError
        If the folder cannot be written to.
    AggloError
        If a partition could not be made or measured.
    """
    parts = max(2, size.cells // size.per_part)
    units = [
        Unit(
            measured,
            {"source": source, "parts": parts, "recipe": recipe, "seed": seed, "degrees": list(size.degrees)},
            _PACKAGES,
        )
        for source in sources(size)
        for recipe, seed in chosen(size.partitions)
    ]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        results = Store(folder / "cache").results(units, begin(units, "shapes"))
        rows = []
        for unit in units:
            result, asked = results[unit.key], unit.settings
            if "error" in result:
                raise AggloError(f"{asked['recipe']} on {asked['source']}: {result['error']}")
            rows.append(Measured(asked["source"], asked["recipe"], asked["seed"], result))
        made = page(rows, parts, size.degrees, size.command)
        if find_spec("matplotlib") is None:
            made = replace(made, figures={})
        else:
            draw(rows, min(2, max(size.degrees)), folder / "shapes.svg")
        _write(folder / "shapes.md", made.markdown())
        _write(folder / "shapes.json", json.dumps(made.data(), indent=1, allow_nan=False) + "\n")
    except OSError as error:
        raise FileError(f"{error.filename or folder}: {error.strerror or error}") from error
    return made


def _write(file: Path, text: str) -> None:
    with staging(file) as stage:
        (stage / file.name).write_text(text, encoding="utf-8")
