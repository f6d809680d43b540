"""Read nodes, entities and elements from Gmsh files of all supported versions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.errors import FileError
from agglo_core.io.gmsh.sections import Numbers
from agglo_core.io.text.counted_lists import record_starts

_MOST = 1 << 22  # limit on group memberships, in addition to one per byte of the file
_LONGEST = 1 << 40  # limit on the number of tags in the search for the end of a record
_FACTOR = np.uint64(0x9E3779B97F4A7C15)

# Gmsh's type numbers of complete elements of order 1, 2, … per shape, and of serendipity elements.
_ORDERS = {
    "line": (1, 8, 26, 27, 28, 62, 63, 64, 65, 66),
    "triangle": (2, 9, 21, 23, 25, 42, 43, 44, 45, 46),
    "quad": (3, 10, 36, 37, 38, 47, 48, 49, 50, 51),
    "tetra": (4, 11, 29, 30, 31, 71, 72, 73, 74, 75),
    "hexahedron": (5, 12, 92, 93, 94, 95, 96, 97, 98),
    "wedge": (6, 13, 90, 91, 106, 107, 108, 109, 110),
    "pyramid": (7, 14, 118, 119, 120, 121, 122, 123, 124),
}
_SERENDIPITY = {
    "triangle": {20: 9, 22: 12, 24: 15},
    "quad": {16: 8, 39: 12, 40: 16, 41: 20},
    "hexahedron": {17: 20},
    "wedge": {18: 15},
    "pyramid": {19: 13},
}
_SHAPES = {  # dimension, VTK type
    "line": (1, 3),
    "triangle": (2, 5),
    "quad": (2, 9),
    "tetra": (3, 10),
    "hexahedron": (3, 12),
    "wedge": (3, 13),
    "pyramid": (3, 14),
}


def _node_count(shape: str, p: int) -> int:
    """Return the node count of the complete Lagrange element of order p."""
    triangle, square = (p + 1) * (p + 2) // 2, (p + 1) ** 2
    return {
        "line": p + 1,
        "triangle": triangle,
        "quad": square,
        "tetra": triangle * (p + 3) // 3,
        "hexahedron": square * (p + 1),
        "wedge": triangle * (p + 1),
        "pyramid": (p + 1) * (p + 2) * (2 * p + 3) // 6,
    }[shape]


def _tables() -> tuple[Int, Int, Int]:
    """Tabulate dimension (−1: unsupported), VTK type and node count of Gmsh's element types."""
    dims, types, nodes = np.full(256, -1), np.zeros(256, np.int64), np.ones(256, np.int64)
    dims[15], types[15] = 0, 1
    for shape, numbers in _ORDERS.items():
        counts = {number: _node_count(shape, p) for p, number in enumerate(numbers, 1)}
        for number, count in (counts | _SERENDIPITY.get(shape, {})).items():
            (dims[number], types[number]), nodes[number] = _SHAPES[shape], count
    return frozen_int(dims), frozen_int(types), frozen_int(nodes)


DIMS, VTK_TYPES, _NODES = _tables()


class Entity(NamedTuple):
    """Gmsh entity (point, curve, surface or volume of the geometry), or its share in one partition."""

    tag: int  # of the entity itself
    groups: Int  # numbers of its physical groups
    partition: int  # 0 where the mesh is not partitioned


Entities = Mapping[tuple[int, int], Entity]  # by dimension and tag


class Elements(NamedTuple):
    """Elements of a Gmsh file, in file order."""

    numbers: Int  # (n,)
    types: Int  # (n,) Gmsh's
    offsets: Int  # (n + 1,)
    nodes: Int  # numbers of the file
    geometrical: Int  # (n,)
    partition: Int  # (n,) 0 where there is none
    members: Int  # (m, 2) element and number of a physical group it belongs to


def read_nodes(numbers: Numbers) -> tuple[Int, Float]:
    """Read node numbers ``(n,)`` and coordinates ``(n, 3)``.

    Raises FileError if damaged.
    """
    version = numbers.header.version
    if version == "2":
        count = numbers.line_count()
        return numbers.rows(count, 3)
    blocks = int(numbers.sizes(4 if version == "4.1" else 2)[0])
    tags, points = [np.empty(0, np.int64)], [np.empty((0, 3))]
    for _ in range(blocks):
        first, second, parametric = numbers.ints(3).tolist()
        if parametric not in (0, 1):
            raise FileError(f"$Nodes: the parametric flag of a block is {parametric}, expected 0 or 1")
        count = int(numbers.sizes(1)[0])
        # Parametric nodes have up to three more columns; only the coordinates are kept.
        width = 3 + parametric * min(max(first if version == "4.1" else second, 0), 3)
        if version == "4.1":
            tags.append(numbers.sizes(count))
            points.append(numbers.reals(count * width).reshape(count, width)[:, :3])
        else:
            tag, table = numbers.rows(count, width)
            tags.append(tag)
            points.append(table[:, :3])
    return frozen_int(np.concatenate(tags)), frozen_float(np.concatenate(points))


def read_entities(numbers: Numbers) -> dict[tuple[int, int], Entity]:
    """Read ``$Entities`` or ``$PartitionedEntities`` as a mapping from (dimension, tag) to entity.

    Raises FileError if damaged.
    """
    partitioned = numbers.name == "PartitionedEntities"
    if partitioned:
        _, ghosts = numbers.sizes(2).tolist()
        numbers.ints(2 * ghosts)
    entities = {}
    for dim, count in enumerate(numbers.sizes(4).tolist()):
        for _ in range(count):
            tag, parent, partition = int(numbers.ints(1)[0]), (-1, 0), 0
            if partitioned:
                parent = tuple(numbers.ints(2).tolist())
                parts = numbers.ints(int(numbers.sizes(1)[0]))
                partition = int(parts[0]) if len(parts) else 0
            numbers.reals(3 if dim == 0 and numbers.header.version == "4.1" else 6)  # bounding box
            groups = np.abs(numbers.ints(int(numbers.sizes(1)[0])))  # negative where it is reversed
            if dim > 0:
                numbers.ints(int(numbers.sizes(1)[0]))  # boundary entities
            entities[dim, tag] = Entity(parent[1] if parent[0] == dim else tag, frozen_int(groups), partition)
    return entities


def read_elements(numbers: Numbers, entities: Entities) -> Elements:
    """Read the section ``$Elements`` of a file in any supported version.

    Raises FileError if damaged.
    """
    if numbers.header.version != "2":
        parts = list(_read_by_entity(numbers, entities))
    elif numbers.header.order:
        parts = list(_read_by_header(numbers, numbers.line_count()))
    else:
        parts = [_read_one_by_one(numbers, numbers.line_count())]
    # Join the blocks; element indices in the memberships are shifted by the block starts.
    starts = np.cumsum([0, *(len(part.types) for part in parts)])
    sizes = np.concatenate([np.empty(0, np.int64), *(np.diff(part.offsets) for part in parts)])
    members = [part.members + np.array([start, 0]) for part, start in zip(parts, starts[:-1], strict=True)]
    arrays = {
        name: frozen_int(np.concatenate([np.empty(0, np.int64), *(getattr(part, name) for part in parts)]))
        for name in ("numbers", "types", "nodes", "geometrical", "partition")
    }
    return Elements(
        offsets=frozen_int(np.concatenate(([0], np.cumsum(sizes)))),
        members=frozen_int(np.concatenate([np.empty((0, 2), np.int64), *members])),
        **arrays,
    )


def _read_by_entity(numbers: Numbers, entities: Entities) -> Iterator[Elements]:
    """Yield the element blocks of versions 4.0 and 4.1: elements of one type on one entity."""
    newer = numbers.header.version == "4.1"
    memberships = 0
    for _ in range(int(numbers.sizes(4 if newer else 2)[0])):
        first, second, kind = numbers.ints(3).tolist()
        dim, tag = (first, second) if newer else (second, first)
        n, width = int(numbers.sizes(1)[0]), 1 + _node_count_of(kind)
        table = (numbers.sizes if newer else numbers.ints)(n * width).reshape(n, width)
        entity = entities.get((dim, tag), Entity(tag, frozen_int([]), 0))
        groups = list(dict.fromkeys(entity.groups.tolist()))
        memberships += n * len(groups)
        if memberships > _MOST + len(numbers.content):
            raise FileError(f"its elements have {memberships} group memberships, too many for the file size")
        yield Elements(
            frozen_int(table[:, 0]),
            frozen_int(np.full(n, kind)),
            frozen_int(np.arange(0, n * (width - 1) + 1, width - 1)),
            frozen_int(table[:, 1:].ravel()),
            frozen_int(np.full(n, entity.tag)),
            frozen_int(np.full(n, entity.partition)),
            frozen_int(np.column_stack((np.repeat(np.arange(n), len(groups)), np.tile(groups, n)))),
        )


def _read_by_header(numbers: Numbers, n_elements: int) -> Iterator[Elements]:
    """Yield the element blocks of binary version 2: elements of one type with equally many tags."""
    n_read = 0
    while n_read < n_elements:
        kind, n, n_tags = numbers.ints(3).tolist()
        if n < 1 or n_tags < 0:
            raise FileError(f"$Elements: a block declares {n} elements with {n_tags} tags")
        width = 1 + n_tags + _node_count_of(kind)
        stream = numbers.ints(n * width)
        starts = np.arange(0, n * width, width)
        yield _build_elements(stream, stream[starts], np.full(n, kind), starts + 1, np.full(n, n_tags))
        n_read += n


def _read_one_by_one(numbers: Numbers, n_elements: int) -> Elements:
    """Read the elements of a version 2 text file: number, type, tag count, tags, nodes."""
    stream = numbers.rest()

    def ends(window: Int) -> Int:
        stops = np.full(len(window), len(window) + 1)
        kinds, n_tags = window[1:-1], window[2:]
        sizes = _NODES[np.clip(kinds, 0, 255)]  # 1 for unsupported types, rejected below
        stops[: len(n_tags)] = np.arange(len(n_tags)) + 3 + np.clip(n_tags, 0, _LONGEST) + sizes
        return frozen_int(stops)

    starts, _ = record_starts(stream, n_elements, ends)
    kinds, n_tags = stream[starts + 1], stream[starts + 2]
    for kind in np.unique(kinds).tolist():
        _node_count_of(kind)
    if n_tags.min(initial=0) < 0:
        raise FileError(f"$Elements: an element declares {n_tags.min()} tags")
    return _build_elements(stream, stream[starts], kinds, starts + 3, n_tags)


def _build_elements(stream: Int, numbers: Int, kinds: Int, first: Int, n_tags: Int) -> Elements:
    """Build elements from the numbers of a version 2 file, given the index of each first tag.

    Tags are the physical group, the geometrical entity, the partition count and the partitions; versions
    before 2.2 have a single partition instead.
    """

    def tag(place: int) -> Int:
        return frozen_int(np.where(n_tags > place, stream[np.minimum(first + place, len(stream) - 1)], 0))

    sizes = _NODES[kinds]
    offsets = np.concatenate(([0], np.cumsum(sizes)))
    places = np.arange(offsets[-1]) + np.repeat(first + n_tags - offsets[:-1], sizes)
    group = np.abs(tag(0))  # negative where it is reversed
    inside = np.flatnonzero(group)
    return Elements(
        numbers,
        frozen_int(kinds),
        frozen_int(offsets),
        frozen_int(stream[places]),
        tag(1),
        frozen_int(np.where(n_tags == 3, tag(2), tag(3))),
        frozen_int(np.column_stack((inside, group[inside]))),
    )


def _node_count_of(kind: int) -> int:
    """Return the node count of a Gmsh element type.

    Raises FileError if it is unsupported.
    """
    if not 0 <= kind < len(DIMS) or DIMS[kind] < 0:
        raise FileError(f"Gmsh element type {kind} is not supported")
    return int(_NODES[kind])


def first_listings(elements: Elements) -> Int:
    """Return for each element ``(n,)`` the index of the earlier element that it repeats, or its own.

    Version 2 lists an element once per physical group. A repetition has the type and nodes of an earlier
    element but a new group. With a group listed before, it remains an element.
    """
    first = np.arange(len(elements.types))
    group = np.zeros(len(first), np.int64)
    group[elements.members[:, 0]] = elements.members[:, 1]
    for kind in np.unique(elements.types):
        # Hash the nodes; only elements with a repeated hash are compared in full.
        indices = np.flatnonzero(elements.types == kind)
        rows = elements.nodes[elements.offsets[indices][:, None] + np.arange(_NODES[kind])]
        key = rows.astype(np.uint64) @ (np.arange(rows.shape[1], dtype=np.uint64) * _FACTOR + _FACTOR)
        count = np.unique(key, return_inverse=True, return_counts=True)
        several = np.flatnonzero(count[2][count[1]] > 1)  # all repeated rows, and rarely others
        rows, indices = rows[several], indices[several]
        # Sort by nodes, then group, then position, and mark equal neighbours.
        order = np.lexsort((indices, group[indices], *rows.T))
        rows, indices = rows[order], indices[order]
        same_nodes = np.concatenate(([False], (rows[1:] == rows[:-1]).all(axis=1)))[: len(indices)]
        same_group = (
            np.concatenate(([False], group[indices][1:] == group[indices][:-1]))[: len(indices)] & same_nodes
        )
        # Number the classes of equal nodes and find the first element of each.
        number = np.cumsum(~same_nodes) - 1
        earliest = np.full(number.max(initial=-1) + 1, len(first))
        np.minimum.at(earliest, number, indices)
        first[indices] = np.where(same_group, indices, earliest[number])
    return frozen_int(first)
