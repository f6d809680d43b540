"""Hook of the build tool hatchling that adds compiled kernels to a wheel."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

__all__ = ["CompiledKernels"]

_COMPILE = "agglo_core.compiled.ahead_of_time"


class CompiledKernels(BuildHookInterface[Any]):
    """Build step that compiles the kernels into ``agglo_core/compiled/machine_code``.

    It runs if ``AGGLO_PREBUILD`` names feature levels of processors, and needs numba (``--no-isolation``).
    The wheel then has the tag of this Python and platform. By default a wheel contains no kernels and is for
    all platforms.
    """

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile the kernels (called by hatchling before it collects files)."""
        levels = os.environ.get("AGGLO_PREBUILD", "").split()
        if version == "editable" or not levels:
            return
        self._room = TemporaryDirectory()
        kernels, kept = Path(self._room.name, "compiled"), Path(self._room.name, "kept")
        kernels.mkdir()
        self.app.display_info("compiling numerical kernels, which takes about a minute")
        run = subprocess.run(
            [sys.executable, "-m", _COMPILE, str(kernels), *levels],
            env=os.environ | {"NUMBA_CACHE_DIR": str(kept), "PYTHONPATH": self._import_path()},
            cwd=self.root, capture_output=True, text=True,
        )  # fmt: skip
        if run.returncode:
            raise RuntimeError(f"AGGLO_PREBUILD={' '.join(levels)}: {run.stderr.strip()}")
        self.app.display_info(f"{len(list(kernels.glob('*.nbc')))} signatures of kernels compiled")
        build_data.update(pure_python=False, infer_tag=True)
        build_data["force_include"][str(kernels)] = "agglo_core/compiled/machine_code"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove temporary files (called by hatchling after the wheel is written)."""
        if hasattr(self, "_room"):
            self._room.cleanup()

    def _import_path(self) -> str:
        ours = [self.root, str(Path(self.root, "plugins"))]
        return os.pathsep.join([*ours, *filter(None, [os.environ.get("PYTHONPATH")])])
