"""Which faces of a mesh become one: plane or in space, exactly or within a tolerance."""

from __future__ import annotations

from collections.abc import Mapping

from agglo_core.arrays import Int
from agglo_core.errors import OptionError
from agglo_core.mesh.derived import Derived
from agglo_core.mesh.simplify.edges import fewer_edges
from agglo_core.mesh.simplify.patches import fewer_faces
from agglo_core.mesh.simplify.record import Fewer

_MOST = 0.5  # of a cell: beyond it next to no interface keeps a vertex


def simplify(mesh: Derived, tags: Mapping[str, Int], tolerance: float) -> Fewer:
    """Faces of ``Mesh.simplified``, whose arguments and errors these are, and what to call the change."""
    if not 0 <= tolerance <= _MOST:
        raise OptionError(f"simplified: tolerance must lie between 0 and {_MOST}, given {tolerance!r}")
    if mesh.dim == 3 and tolerance > 0:
        raise OptionError(
            f"simplified: in 3-D only flat patches become one face, tolerance=0; given {tolerance!r}"
        )
    fewer = fewer_faces(mesh, tags) if mesh.dim == 3 else fewer_edges(mesh, tags, tolerance)
    saved = mesh.n_faces - len(fewer.leads)
    what = (
        f"faces fewer, interfaces moved within {tolerance:g} of the cells"
        if tolerance
        else "straight faces joined"
    )
    return fewer._replace(repairs={what: saved})
