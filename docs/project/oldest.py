"""Print the oldest dependencies that ``pyproject.toml`` claims, as requirements for pip."""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path

EXTRAS = ("kmeans", "metis", "gnn", "plot")


def oldest() -> list[str]:
    """``name==version`` of every dependency and of those of the extras that users install."""
    project = tomllib.loads(Path(__file__).parents[2].joinpath("pyproject.toml").read_text(encoding="utf-8"))[
        "project"
    ]
    groups = [project["dependencies"], *(project["optional-dependencies"][name] for name in EXTRAS)]
    return [requirement.replace(">=", "==") for group in groups for requirement in group]


if __name__ == "__main__":
    sys.stdout.write("\n".join(oldest()) + "\n")
