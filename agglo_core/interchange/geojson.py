"""GeoJSON: a FeatureCollection of cells with tags, levels and measured values as properties."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from agglo_core.arrays import plain_array
from agglo_core.errors import MeshError, OptionError
from agglo_core.interchange.shapely_in import mesh_from_shapely
from agglo_core.interchange.shapely_out import mesh_to_shapely
from agglo_core.io.levels import check_belongs, coarse_cell_data, under_free_names
from agglo_core.io.tags import cell_data, is_level
from agglo_core.mesh import Mesh

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy

_log = logging.getLogger("agglo")


def to_geojson(
    mesh: Mesh,
    hierarchy: Hierarchy | None = None,
    *,
    level: int | None = None,
    properties: Mapping[str, ArrayLike] | None = None,
) -> dict[str, Any]:
    """Convert the cells of a 2-D mesh to a FeatureCollection (RFC 7946) for :func:`json.dump`.

    Each feature has the cell number as ``id``. Its properties are the cell tags and, with a hierarchy, its
    agglomerate on each level as ``level_0``, ``level_1``, …, which replace older tags with such names.
    Coordinates are those of the mesh, without a reference system.

    Parameters
    ----------
    mesh : Mesh
    hierarchy : Hierarchy, optional
    level : int, optional
        Level of the hierarchy. The features are then its agglomerates, with ``agglomerate`` (the label),
        ``parent`` (the agglomerate of the next coarser level, −1 if there is none), ``cells`` (cell
        count), ``measure`` and ``diameter``.
    properties : mapping of name to numbers, one for each feature, optional
        More properties, such as the values of :func:`agglo_core.quality`; NaN is written as null.

    Raises
    ------
    MeshError
        For a 3-D mesh, a hierarchy of another mesh, or values of another shape.
    OptionError
        For a level outside the hierarchy.

    Examples
    --------
    >>> import agglo_core as agglo
    >>> mesh = agglo.samples.squares(4)
    >>> hierarchy = agglo.agglomerate(mesh, bisector="coordinate", n_parts=(4, 2))
    >>> [each["properties"]["parent"] for each in to_geojson(mesh, hierarchy, level=0)["features"]]
    [0, 1, 0, 1]
    """
    import shapely

    if hierarchy is not None:
        check_belongs(mesh, hierarchy)
    data: Mapping[str, NDArray[Any]] = cell_data(mesh, hierarchy)
    if level is not None:
        mesh, data = _agglomerates(hierarchy, level)
    table = {name: values.tolist() for name, values in data.items()}
    table |= {name: _plain(name, values, mesh.n_cells) for name, values in (properties or {}).items()}
    features = [
        {
            "type": "Feature",
            "id": i,
            "properties": {name: values[i] for name, values in table.items()},
            "geometry": json.loads(text),
        }
        for i, text in enumerate(shapely.to_geojson(mesh_to_shapely(mesh)))
    ]
    name = {"name": mesh.name} if mesh.name else {}
    return {"type": "FeatureCollection", **name, "features": features}


def _agglomerates(hierarchy: Hierarchy | None, level: int) -> tuple[Mesh, dict[str, NDArray[Any]]]:
    """Return the coarse mesh of a level, and its tags and data per agglomerate."""
    count = 0 if hierarchy is None else len(hierarchy.levels)
    if hierarchy is None or not 0 <= level < count:
        raise OptionError(f"to_geojson: level {level!r} does not exist; the hierarchy has {count} levels")
    coarse = hierarchy.mesh(level)
    tags = {name: values for name, values in coarse.cell_tags.items() if not is_level(name)}
    data = coarse_cell_data(hierarchy.levels, level, coarse, {})
    return coarse, {**tags, **under_free_names(data, tags)}


def _plain(name: str, values: ArrayLike, count: int) -> list[Any]:
    """Convert ``count`` numbers to a list for JSON, with None for infinities and NaN."""
    array = plain_array(values, f"property {name!r}")
    if array.shape != (count,) or array.dtype.kind not in "iubf":
        raise MeshError(
            f"property {name!r} must be ({count},) numbers; given shape {array.shape}, dtype {array.dtype}"
        )
    return [
        value if finite else None for value, finite in zip(array.tolist(), np.isfinite(array), strict=True)
    ]


def from_geojson(collection: Mapping[str, Any], *, tolerance: float = 0.0, strict: bool = False) -> Mesh:
    """Build a mesh from a FeatureCollection of polygons.

    Feature i is cell i.

    Properties that are integers in every feature become cell tags (including ``level_0``, …); the names of
    other properties are logged.

    Parameters
    ----------
    collection : mapping
        Result of :func:`json.load`.
    tolerance, strict
        As in :func:`mesh_from_shapely`.

    Raises
    ------
    MeshError
        If it is not a FeatureCollection, or a feature (named) is not a polygon; also as
        :func:`mesh_from_shapely`.

    Examples
    --------
    >>> agglo.interchange.from_geojson(agglo.interchange.to_geojson(agglo.samples.squares(2)))
    Mesh('squares 2x2', 2-D, 4 cells, 12 faces, 9 points)
    """
    kind = collection.get("type") if isinstance(collection, Mapping) else type(collection).__name__
    features = collection.get("features") if isinstance(collection, Mapping) else None
    if kind != "FeatureCollection" or not isinstance(features, Sequence):
        raise MeshError(f"expected a GeoJSON FeatureCollection, given {kind!r}")
    for i, feature in enumerate(features):
        if not isinstance(feature, Mapping) or feature.get("geometry") is None:
            raise MeshError(f"feature {i} has no geometry")
        if not isinstance(feature.get("properties") or {}, Mapping):
            raise MeshError(f"feature {i}: its properties are {feature['properties']!r:.60}, not an object")
    name = collection.get("name")
    return mesh_from_shapely(
        _geometries([feature["geometry"] for feature in features]),
        cell_tags=_tags([feature.get("properties") or {} for feature in features]),
        tolerance=tolerance,
        strict=strict,
        name=name if isinstance(name, str) else "",
    )


def _geometries(members: Iterable[Any]) -> Any:
    """Convert GeoJSON geometries to shapely geometries."""
    import shapely

    texts = [_text(i, member) for i, member in enumerate(members)]
    geometries = shapely.from_geojson(texts, on_invalid="ignore")
    bad = np.flatnonzero(shapely.is_missing(geometries))
    if len(bad):
        try:
            shapely.from_geojson(texts[bad[0]])
        except shapely.GEOSException as error:
            raise MeshError(f"feature {bad[0]}: {error}") from None
        raise MeshError(f"feature {bad[0]} has no geometry")
    return geometries


def _text(i: int, member: Any) -> str:
    try:
        return json.dumps(member)
    except (TypeError, ValueError, RecursionError) as error:
        reason = "nested too deeply" if isinstance(error, RecursionError) else error
        raise MeshError(f"feature {i}: its geometry cannot be written as JSON: {reason}") from None


def _tags(rows: Sequence[Mapping[str, Any]]) -> dict[str, ArrayLike]:
    """Return the properties that are 64-bit integers in every feature as tags."""
    first = rows[0] if rows else {}
    tags: dict[str, ArrayLike] = {
        name: np.array([row[name] for row in rows], dtype=np.int64)
        for name in first
        if all(_is_int64(row.get(name)) for row in rows)
    }
    skipped_names = [
        str(name) for name in dict.fromkeys(name for row in rows for name in row) if name not in tags
    ]
    if skipped_names:
        _log.info(
            "properties left out because they are not integers in every feature: %s", ", ".join(skipped_names)
        )
    return tags


def _is_int64(value: object) -> bool:
    return isinstance(value, int) and -(2**63) <= value < 2**63
