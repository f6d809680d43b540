"""Python build backend: hatchling, plus numba for wheels with precompiled kernels.

Compiled kernels are valid for one version of numba, numpy and Python and one processor type; elsewhere
kernels are compiled on first use. Therefore the tested versions are required, which README installs, not the
newest.
"""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path
from typing import Any

from hatchling import build as hatchling
from hatchling.build import (
    build_editable,
    build_sdist,
    build_wheel,
    get_requires_for_build_editable,
    get_requires_for_build_sdist,
)

__all__ = [
    "build_editable",
    "build_sdist",
    "build_wheel",
    "get_requires_for_build_editable",
    "get_requires_for_build_sdist",
    "get_requires_for_build_wheel",
]

_NEWEST_TESTED = (3, 14)
_CONSTRAINING = ("PIP_CONSTRAINT", "PIP_BUILD_CONSTRAINT", "UV_BUILD_CONSTRAINT")
_CONSTRAINTS = Path(__file__).parents[2] / "constraints.txt"


def get_requires_for_build_wheel(config_settings: dict[str, Any] | None = None) -> list[str]:
    """Return the packages needed to build a wheel: those of hatchling, and those to compile kernels."""
    return [*hatchling.get_requires_for_build_wheel(config_settings), *compile_requirements()]


def compile_requirements() -> list[str]:
    """Return the packages needed to compile kernels, in tested versions unless the user constrains them.

    ``AGGLO_PREBUILD=0`` omits them, and the hook then omits the kernels.
    """
    if os.environ.get("AGGLO_PREBUILD") == "0":
        return []
    free = ["numba>=0.60", "numpy>=2.0"]
    constrained = any(name in os.environ for name in _CONSTRAINING)
    if constrained or sys.version_info[:2] > _NEWEST_TESTED or not _CONSTRAINTS.is_file():
        return free
    return re.findall(
        r"^(?:numba|llvmlite|numpy)==\S+", _CONSTRAINTS.read_text(encoding="utf-8"), re.MULTILINE
    )
