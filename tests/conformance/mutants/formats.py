"""Correct formats, and formats that break one law first."""

from __future__ import annotations

import json
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from conformance.mutants.mutant import Mutant

from agglo_core import FileError, Hierarchy, Mesh, MeshError


class Toy:
    """JSON file with points, vertex loops and cell tags, for 2-D meshes without holes."""

    suffixes = (".toy",)
    lossless = False

    def read(self, path):
        try:
            found = json.loads(path.read_text())
            return Mesh.from_polygons(found["points"], found["cells"], cell_tags=found["tags"])
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise FileError(f"{path}: is no toy file: {error}") from error

    def write(self, path, mesh, hierarchy=None):
        if mesh.dim != 2 or len(mesh.boundary_loops.loop_offsets) != mesh.n_cells + 1:
            raise MeshError("a toy file holds cells of the plane, without holes")
        if hierarchy is not None:
            raise FileError("a toy file holds no hierarchy")
        loops = mesh.boundary_loops
        cells = [loop.tolist() for loop in np.split(loops.vertices, loops.loop_offsets[1:-1])]
        tags = {name: values.tolist() for name, values in mesh.cell_tags.items()}
        path.write_text(json.dumps({"points": mesh.points.tolist(), "cells": cells, "tags": tags}))


class RemembersTags(Toy):
    _tags = {}  # noqa: RUF012 - the bug

    def read(self, path):
        mesh = super().read(path)
        self._tags.update(mesh.cell_tags)
        fitting = {name: tag for name, tag in self._tags.items() if len(tag) == mesh.n_cells}
        return replace(mesh, cell_tags=fitting)


_PARTS = ("points", "face_offsets", "face_vertices", "face_cells")


class Archive:
    """Archive of numpy arrays, lossless and with hierarchies."""

    suffixes = (".toyz", ".toyz2")
    lossless = True

    def read(self, path):
        return self.read_hierarchy(path)[0]

    def read_hierarchy(self, path):
        try:
            with np.load(path, allow_pickle=False) as found:
                arrays = dict(found)
        except (OSError, ValueError, zipfile.BadZipFile, EOFError) as error:
            raise FileError(f"{path}: is no archive: {error}") from error
        tags = [
            {name[2:]: values for name, values in arrays.items() if name.startswith(sort)}
            for sort in ("c_", "f_")
        ]
        mesh = Mesh(*(arrays[name] for name in _PARTS), *tags)
        levels = [arrays[name] for name in sorted(arrays) if name.startswith("level")]
        targets = [{"n_parts": int(labels.max()) + 1} for labels in levels]
        return mesh, Hierarchy(mesh, mesh.graph, levels, targets, nested=True) if levels else None

    def write(self, path, mesh, hierarchy=None):
        if hierarchy is not None and not hierarchy.nested:
            raise FileError(f"{path}: an archive holds nested levels only")
        arrays = {name: getattr(mesh, name) for name in _PARTS}
        arrays |= {f"c_{name}": values for name, values in mesh.cell_tags.items()}
        arrays |= {f"f_{name}": values for name, values in mesh.face_tags.items()}
        arrays |= {f"level{i}": labels for i, labels in enumerate(hierarchy.levels if hierarchy else ())}
        with path.open("wb") as file:
            np.savez(file, **arrays)


class OnlyReads:
    suffixes = (".old",)
    lossless = False

    def read(self, path):
        return Toy().read(path)


class LoudSuffix(Toy):
    suffixes = ("TOY",)


class RefusesEverything(Toy):
    def write(self, path, mesh, hierarchy=None):
        raise MeshError("no room")


class SixDigits(Toy):
    def write(self, path, mesh, hierarchy=None):
        points = np.array([[float(f"{x:.6g}") for x in point] for point in mesh.points])
        super().write(
            path, Mesh(points, mesh.face_offsets, mesh.face_vertices, mesh.face_cells, mesh.cell_tags)
        )


class DropsTags(Toy):
    def read(self, path):
        mesh = super().read(path)
        return Mesh(mesh.points, mesh.face_offsets, mesh.face_vertices, mesh.face_cells)


class RefusesItsOwn(Toy):
    def read(self, path):
        raise FileError("not today")


class SaysLossless(Toy):
    """Claim to be lossless, but drop face tags."""

    lossless = True


class DropsTheHierarchy(Toy):
    def write(self, path, mesh, hierarchy=None):
        super().write(path, mesh)


class ExchangesTags(Archive):
    """Read the values of the tags in alphabetical order of their names."""

    def read_hierarchy(self, path):
        mesh, hierarchy = super().read_hierarchy(path)
        tags = dict(
            zip(mesh.cell_tags, [mesh.cell_tags[name] for name in sorted(mesh.cell_tags)], strict=True)
        )
        return replace(mesh, cell_tags=tags), hierarchy


class WrapsLargeTags(Toy):
    def read(self, path):
        mesh = super().read(path)
        tags = {name: tag.astype(np.int32).astype(int) for name, tag in mesh.cell_tags.items()}
        return replace(mesh, cell_tags=tags)


class TenDecimals(Toy):
    """Write coordinates with ten decimals, too few for small meshes."""

    def write(self, path, mesh, hierarchy=None):
        super().write(path, replace(mesh, points=mesh.points.round(10)), hierarchy)


class CoarsestFirst(Archive):
    def read_hierarchy(self, path):
        mesh, hierarchy = super().read_hierarchy(path)
        if hierarchy:
            levels, targets = hierarchy.levels[:1] * 2, hierarchy.targets
            hierarchy = Hierarchy(mesh, mesh.graph, levels, targets, nested=True)
        return mesh, hierarchy


class RaisesOnGarbage(Toy):
    def read(self, path):
        found = json.loads(path.read_text())
        return Mesh.from_polygons(found["points"], found["cells"], cell_tags=found["tags"])


class TakesWhatIsThere(Toy):
    """Write a line per cell, and read truncated files without an error."""

    def write(self, path, mesh, hierarchy=None):
        super().write(path, mesh, hierarchy)
        found = json.loads(path.read_text())
        lines = [found["points"], found["tags"], *found["cells"]]
        path.write_text("\n".join(map(json.dumps, lines)))

    def read(self, path):
        try:
            points, tags, *cells = [json.loads(line) for line in path.read_text().splitlines()]
        except ValueError as error:
            try:
                points, tags, *cells = [json.loads(line) for line in path.read_text().splitlines()[:-1]]
            except (ValueError, TypeError):
                raise FileError(f"{path}: {error}") from error
        if not cells or not isinstance(tags, dict):
            raise FileError(f"{path}: no cells")
        tags = {name: values[: len(cells)] for name, values in tags.items()}
        return Mesh.from_polygons(points, cells, cell_tags=tags)


class LeavesALog(Toy):
    def write(self, path, mesh, hierarchy=None):
        super().write(path, mesh, hierarchy)
        Path(path.parent / "toy.log").write_text("written")


class TouchesTheFile(Toy):
    def read(self, path):
        mesh = super().read(path)
        path.write_text(path.read_text() + "\n")
        return mesh


class PlaneFormat(Toy):
    def write(self, path, mesh, hierarchy=None):
        if mesh.dim == 3:
            raise RuntimeError("what is this?")
        super().write(path, mesh)


CORRECT = [(Toy, {"pickles": True}), (Archive, {"3d": True, "pickles": True}), (OnlyReads, {})]

MUTANTS = [
    Mutant("answers", RefusesEverything, "data that the format cannot store"),
    Mutant("answers", RefusesItsOwn, "then refused to read it"),
    Mutant("suffixes_declared", LoudSuffix, "lower case"),
    Mutant("read_back", SixDigits, "17 digits"),
    Mutant("read_back", DropsTags, "cell tag"),
    Mutant("read_back", RemembersTags, "keep nothing of a file"),
    Mutant("read_back", SaysLossless, "set lossless = False"),
    Mutant("read_back", ExchangesTags, "differs"),
    Mutant("read_back", WrapsLargeTags, "differs"),
    Mutant("read_back", TenDecimals, "17 digits"),
    Mutant("hierarchy_kept", DropsTheHierarchy, "refuse a hierarchy"),
    Mutant("hierarchy_kept", CoarsestFirst, "order of the levels"),
    Mutant("broken_files_refused", RaisesOnGarbage, "FileError"),
    Mutant("broken_files_refused", TakesWhatIsThere, "number of values read"),
    Mutant("files_left_alone", LeavesALog, "toy.log"),
    Mutant("files_left_alone", TouchesTheFile, "reading changed"),
    Mutant("space_served_or_refused", PlaneFormat, "only for 2-D"),
    Mutant("space", Toy, "drop the promise", {"3d": True}),
]
