"""Every example of the gallery runs and gives the numbers it gave when it was written."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

import pytest

GALLERY = Path(__file__).parents[2] / "docs" / "gallery"

GOLDEN: dict[str, dict[str, Any]] = {
    "a_front_on_moving_cuts": {"unknowns": (83868, 960), "gaps": [0.02, 0.06]},
    "an_adapted_layer": {"unknowns": (1569, 1569), "of_uniform": 0.5, "index": 1.7},
    "bisectors_compared": {
        "circle_ratios": {"kmeans": 0.529, "sweep": 0.507, "inertial": 0.508, "coordinate": 0.509}
    },
    "exact_counts": {"counts": [100, 20, 4]},
    "fewer_faces": {"faces": (855, 187)},
    "fine_at_a_well": {"levels_used": [-1, 0, 1, 2]},
    "four_metrics": {"worst": {"UF": 0.67, "CR": 0.28, "J": 0.57, "convexity": 0.68}},
    "layers_of_rock": {"mixed_parts": [63, 0]},
    "nested_levels": {"parts": [90, 19, 4]},
    "one_fracture": {"parts_across": [0, 0]},
    "own_bisector": {"parts": 8},
    "roundest_parts": {"parts": [28, 20]},
    "stretched_parts": {"ratio": 2.6},
    "two_grids": {"iterations": (142, 64)},
    "wave_on_the_brain": {"unknowns": [41934, 7000], "areas": [5080.0, 5230.0]},
}


def test_every_example_has_its_number_and_its_place() -> None:
    page = (GALLERY / "index.md").read_text(encoding="utf-8")
    shown = page.partition("```{gallery}\n")[2].partition("```")[0].split()
    assert sorted(shown) == sorted(GOLDEN) == sorted(script.stem for script in GALLERY.glob("*.py"))


LONG = "a_front_on_moving_cuts", "wave_on_the_brain"
"""Examples of several seconds."""


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name in LONG)) for name in GOLDEN]
)
def test_the_example_gives_its_numbers(name: str) -> None:
    found = runpy.run_path(str(GALLERY / f"{name}.py"))
    for variable, golden in GOLDEN[name].items():
        assert found[variable] == golden
