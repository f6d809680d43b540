"""agglo: agglomeration of polygonal and polyhedral meshes into nested hierarchies, extensible by plugins.

>>> import agglo_core as agglo
>>> mesh = agglo.samples.voronoi(5000, seed=3)
>>> hierarchy = agglo.agglomerate(mesh, bisector="kmeans", h_factor=(2, 4, 8), seed=0)
>>> values = agglo.quality(mesh, hierarchy.levels[0], metrics=("UF", "CR", "CRc"))
>>> agglo.write("out.vtu", mesh, hierarchy)

The stub beside this file lists the names, which are imported on first use, so that a plugin with component
declarations imports neither numpy nor other dependencies.
"""

from __future__ import annotations

from pathlib import Path

from agglo_core.lazy_names import import_name, names_in_stub

_STUB = Path(__file__).with_suffix(".pyi")

__all__ = sorted(["__version__", *names_in_stub(_STUB)])


def __getattr__(name: str) -> object:
    if name == "__version__":
        from agglo_core.registry.discovery import version_of

        return version_of("agglo")
    return import_name(__name__, _STUB, name)


def __dir__() -> list[str]:
    return list(__all__)
