"""Plan of each study: meshes, partitions, outcomes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final

from agglo_paper.work.store import Unit
from shape_study.levels import KINDS, measured_levels
from shape_study.partitions import chosen
from shape_study.solids import APPROXIMATION, SOLID_SOLVERS, measured_solids
from shape_study.work import ERRORS, SOLVERS, measured

_PACKAGES: Final = (
    "shape_study",
    "agglo_paper",
    "agglo_polydg_mg",
    "agglo_kmeans",
    "agglo_metis",
    "agglo_spectral",
    "agglo_gnn",
)
_COEFFICIENTS: Final = ("κ = 1", "κ jumps")
_WORDS: Final = {"counts": "equal numbers of parts", "sizes": "equal sizes"}


@dataclass(frozen=True)
class Size:
    """Size of a study: meshes and their cells, partitions of each, degrees, seed of the first mesh."""

    meshes: int
    cells: int
    partitions: int
    per_part: int
    degrees: tuple[int, ...]
    seed: int = 0
    what: str = "shapes"

    @property
    def command(self) -> str:
        """The command line that computes as much."""
        amounts = f"--meshes {self.meshes} --cells {self.cells} --partitions {self.partitions}"
        degrees = f" --degrees {','.join(map(str, self.degrees))}" if self.degrees else ""
        rest = f"--cells-per-part {self.per_part}{degrees} --seed {self.seed}"
        return f"python -m shape_study {self.what} {amounts} {rest}"


DEFAULTS: Final[Mapping[str, Size]] = MappingProxyType(
    {
        "shapes": Size(3, 500, 40, 16, (1, 2, 3)),
        "levels": Size(3, 500, 20, 4, (1, 2), what="levels"),
        "solids": Size(4, 2000, 20, 32, (), what="solids"),
    }
)
"""What is computed where nothing else is said."""


@dataclass(frozen=True)
class Work:
    """The units of a group, with the names of :class:`~shape_study.tables.Group`."""

    key: str
    title: str
    units: Sequence[Unit]
    kinds: Sequence[str]


@dataclass(frozen=True)
class Plan:
    """Groups of work; what the page says of them; outcomes of the figures by their labels."""

    groups: Sequence[Work]
    facts: Mapping[str, Any]
    shown: Mapping[str, str]
    caption: str


def sources(size: Size) -> list[str]:
    """The meshes: Voronoi, random triangles (or tetrahedra), squares (or cubes) by turns, with seeds."""
    found = []
    for place in range(size.meshes):
        seed = size.seed + place
        if size.what == "solids":
            side = round(size.cells ** (1 / 3)) + place // 3
            points = max(1, round(0.172 * size.cells))
            kinds = (f"voronoi3d:n={size.cells}", f"random_tetrahedra:n={points}", f"boxes:n={side}")
        else:
            side = round(size.cells**0.5) + 2 * (place // 3)
            kinds = (f"voronoi:n={size.cells}", f"random_triangles:n={size.cells // 2}", f"squares:n={side}")
        found.append(kinds[place % 3] + (f",seed={seed}" if place % 3 < 2 else ""))
    return found


def plan_of(size: Size) -> Plan:
    """The work of a study."""
    return {"shapes": _shapes, "levels": _levels, "solids": _solids}[size.what](size)


def _units(size: Size, work: Callable[..., Any], annealed: bool, settings: Mapping[str, Any]) -> list[Unit]:
    return [
        Unit(work, {"source": source, "recipe": recipe, "seed": seed, **settings}, _PACKAGES)
        for source in sources(size)
        for recipe, seed in chosen(size.partitions, annealed)
    ]


def _kinds(solvers: Mapping[str, Any]) -> list[str]:
    return [f"{name} {what}" for name in solvers for what in _COEFFICIENTS]


def _shapes(size: Size) -> Plan:
    parts, degrees = max(2, size.cells // size.per_part), list(size.degrees)
    units = _units(size, measured, False, {"parts": parts, "degrees": degrees})
    degree = min(2, max(degrees))
    shown = {
        "iterations, patches": f"patches κ = 1 p{degree}",
        "iterations, the paper's": f"paper κ = 1 p{degree}",
        f"L2 error, p = {degree}": f"L2 p{degree}",
    }
    facts = {"parts": parts, "degrees": ", ".join(map(str, degrees))}
    caption = "Errors and iterations against UF, CR, J and the energy of k-means"
    return Plan([Work("", "", units, [*_kinds(SOLVERS), *ERRORS])], facts, shown, caption)


def _levels(size: Size) -> Plan:
    per_part, degrees = [size.per_part * 4**level for level in range(3)], list(size.degrees)
    works = []
    for kind in KINDS:
        units = _units(size, measured_levels, True, {"kind": kind, "per_part": per_part, "degrees": degrees})
        works.append(Work(kind, _WORDS[kind], units, _kinds(SOLVERS) + ["parts"] * (kind == "sizes")))
    degree = min(2, max(degrees))
    shown = {
        "iterations, default, p = 1": "default κ = 1 p1",
        f"iterations, patches, p = {degree}": f"patches κ = 1 p{degree}",
        f"iterations, the paper's, p = {degree}": f"paper κ = 1 p{degree}",
    }
    shown = {label: name for label, name in shown.items() if 1 in degrees or not name.endswith("p1")}
    counts = _listed([max(2, size.cells // cells) for cells in per_part])
    facts = {"parts": counts, "degrees": ", ".join(map(str, degrees)), "per_part": _listed(per_part)}
    return Plan(
        works, facts, shown, "Iterations with four levels against UF, CR, J and the energy of k-means"
    )


def _solids(size: Size) -> Plan:
    several = [max(2, size.per_part // 4) * 8**level for level in range(3)]
    works = []
    for levels, per_part in (("two", [size.per_part]), ("four", several)):
        for kind in KINDS:
            units = _units(size, measured_solids, True, {"kind": kind, "per_part": per_part})
            kinds = [*_kinds(SOLID_SOLVERS), APPROXIMATION] + ["parts"] * (kind == "sizes")
            works.append(Work(f"{levels}-{kind}", f"{levels} levels, {_WORDS[kind]}", units, kinds))
    shown = {
        "iterations, smoothed": "smoothed κ = 1",
        "iterations, constants": "constants κ = 1",
        "iterations, the paper's": "paper κ = 1",
        "error of approximation": APPROXIMATION,
    }
    caption = "Iterations and errors against UF, isoperimetric quotient, J and the energy of k-means"
    return Plan(works, {"two": size.per_part, "four": _listed(several)}, shown, caption)


def _listed(numbers: Sequence[int]) -> str:
    *first, last = map(str, numbers)
    return f"{', '.join(first)} and {last}"
