"""Metrics that depend only on numbering or mesh size, and break no other law."""

from __future__ import annotations

from math import inf

import numpy as np
from conformance.mutants.mutant import Mutant


class NeighboursByOrder:
    """Count a neighbour twice if its faces are oriented both ways."""

    better = "low"
    bounds = (0.0, inf)
    homogeneity = 0

    def measure(self, mesh, labels):
        pairs = labels[mesh.face_cells[mesh.face_cells[:, 1] >= 0]]
        pairs = np.unique(pairs[pairs[:, 0] != pairs[:, 1]], axis=0)
        return np.bincount(pairs.ravel(), minlength=labels.max() + 1).astype(float)


class KnowsThePoints:
    """Cache outline lengths by all mesh data except the cell numbers."""

    better = "low"
    bounds = (0.0, inf)
    homogeneity = 1

    def __init__(self):
        self.known = {}

    def measure(self, mesh, labels):
        total = round(mesh.cell_measures.sum() / mesh.h**mesh.dim, 6)
        key = mesh.n_faces, mesh.h, total, mesh.points.tobytes(), labels.tobytes()
        if key not in self.known:
            self.known.clear()  # keep a single entry
            coarse = mesh.coarsen(labels)
            offsets, faces = coarse.cell_faces
            self.known[key] = np.add.reduceat(coarse.face_measures[faces], offsets[:-1])
        return self.known[key].copy()


class RoundsToDecimals:
    """Count vertices by rounded coordinates, to join duplicate vertices."""

    better = "low"
    bounds = (1.0, inf)
    homogeneity = 0

    def measure(self, mesh, labels):
        offsets, vertices = mesh.cell_vertices
        owner = np.repeat(labels, np.diff(offsets))
        place = np.unique(np.round(mesh.local_points, 8), axis=0, return_inverse=True)[1].ravel()
        pairs = np.unique(np.stack((owner, place[vertices]), axis=1), axis=0)
        return np.bincount(pairs[:, 0]).astype(float)


CORRECT: list[tuple[type, dict[str, bool]]] = []

MUTANTS = [
    Mutant("renaming", NeighboursByOrder, "their two sides"),
    Mutant("nothing_carried_over", KnowsThePoints, "cells renumbered"),
    Mutant("homogeneous", RoundsToDecimals, "round to decimals"),
]
