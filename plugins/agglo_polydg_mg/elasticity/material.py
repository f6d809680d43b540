"""Isotropic materials: acoustic tensors of faces, weights of averages, and roots of the elasticity tensor.

On a face with unit normal n, the acoustic tensor μ (I − n nᵀ) + (2μ + λ) n nᵀ acts separately on
tangential and normal vectors, and so do the harmonic means and weights made of it: each is a pair of numbers.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from agglo_core.authoring import Float, Int, Mesh, frozen_float


class Material(NamedTuple):
    """Lamé parameters λ, μ ``(n_cells,)``."""

    lame: Float
    mu: Float

    @property
    def acoustic(self) -> Float:
        """Tangential and normal parts of acoustic tensors ``(n_cells, 2)``: μ and 2μ + λ."""
        return frozen_float(np.stack((self.mu, 2.0 * self.mu + self.lame), axis=1))


class FaceWeights(NamedTuple):
    """Tangential and normal parts of the weights of faces ``(f,)``.

    Attributes
    ----------
    average : (f, 2, 2) float
        Weight of the traction from owner and neighbour (second axis): W₁ + W₂ = I, and (I, 0) at the
        boundary.
    mean : (f, 2) float
        Harmonic mean Γ of both acoustic tensors, the weight of jumps.
    share : (f, 2, 2) float
        W Γ⁻¹ W for owner and neighbour, by which tractions count in the penalty.
    """

    average: Float
    mean: Float
    share: Float


def face_weights(mesh: Mesh, material: Material, faces: Int) -> FaceWeights:
    """Return the weights on some faces."""
    sides = mesh.face_cells[faces]
    inner = (sides[:, 1] >= 0)[:, None]
    own, other = (material.acoustic[sides[:, k]] for k in range(2))
    first = np.where(inner, other / (own + other), 1.0)
    average = np.stack((first, 1.0 - first), axis=1)
    mean = np.where(inner, 2.0 * own * (other / (own + other)), own)
    share = average * average / mean[:, None]
    return FaceWeights(frozen_float(average), frozen_float(mean), frozen_float(share))


def symmetric_pairs(dim: int) -> list[tuple[int, int]]:
    """Return the index pairs of a symmetric tensor's components: the diagonal, then the rest."""
    return [(k, k) for k in range(dim)] + [(i, k) for i in range(dim) for k in range(i + 1, dim)]


def root_of_tensor(material: Material, cells: Int, dim: int) -> Float:
    """Return C^½ ``(k, s, s)`` of some cells, in orthonormal components of symmetric tensors."""
    lame, mu = material.lame[cells], material.mu[cells]
    trace = np.zeros(dim * (dim + 1) // 2)
    trace[:dim] = 1.0
    shear, volume = np.sqrt(2.0 * mu), np.sqrt(2.0 * mu + dim * lame)
    identity = shear[:, None, None] * np.eye(len(trace))
    return np.asarray(identity + (volume - shear)[:, None, None] * np.outer(trace, trace) / dim)


def contraction(normals: Float) -> Float:
    """Return the maps A ``(t, d, s)`` from symmetric tensors to their products with ``normals (t, d)``."""
    dim = normals.shape[1]
    A = np.zeros((len(normals), dim, dim * (dim + 1) // 2))
    for place, (i, k) in enumerate(symmetric_pairs(dim)):
        factor = 1.0 if i == k else np.sqrt(0.5)
        A[:, i, place] = factor * normals[:, k]
        A[:, k, place] = factor * normals[:, i]
    return A


def along(pair: Float, normals: Float) -> Float:
    """Return the tensors ``(t, d, d)`` with tangential and normal parts ``pair (t, 2)``."""
    tangential, normal = pair[:, 0, None, None], pair[:, 1, None, None]
    return np.asarray(
        tangential * np.eye(normals.shape[1])
        + (normal - tangential) * normals[:, :, None] * normals[:, None, :]
    )
