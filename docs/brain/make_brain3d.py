"""Label the voxels of the MNI152 template by tissue: the sample ``brain3d``.

Run ``python docs/brain/make_brain3d.py``; it rewrites agglo_core/samples/data/brain3d.npz. README.md
beside this file names the packages, the source of the template and its licence.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from nilearn.datasets import load_mni152_gm_template, load_mni152_template, load_mni152_wm_template
from scipy.ndimage import binary_fill_holes, gaussian_filter, label, map_coordinates

EDGE = 2.0  # mm, of a voxel
BLUR = 0.5  # mm; takes some specks off the boundaries between tissues
TISSUES = load_mni152_gm_template, load_mni152_wm_template
FLUID, GREY, WHITE = 1, 2, 3  # 0 is outside
DATA = Path(__file__).parents[2] / "agglo_core" / "samples" / "data"


def main() -> None:
    """Write the voxels and say how they came out."""
    tissue, low = trimmed(*tissues())
    counts = np.bincount(tissue.ravel(), minlength=4)
    print(  # noqa: T201
        f"{' x '.join(map(str, tissue.shape))} voxels of {EDGE} mm: "
        f"{counts[FLUID]} of fluid, {counts[GREY]} of grey and {counts[WHITE]} of white matter"
    )
    np.savez_compressed(DATA / "brain3d.npz", tissue=tissue, low=low)


def tissues() -> tuple[np.ndarray, np.ndarray]:
    """Tissue of each voxel, the likeliest at its centre, and the lowest corner of the first (MNI, mm).

    Fluid is what lies inside the template and is neither grey nor white matter. x is to the right, y to
    the front, z up.
    """
    images = [load(resolution=1) for load in (load_mni152_template, *TISSUES)]
    whole, grey, white = (image.get_fdata() for image in images)
    inside = binary_fill_holes(whole > 0).astype(float)
    inside, grey, white = (gaussian_filter(each, BLUR) for each in (inside, grey, white))
    fluid = np.clip(inside - grey - white, 0.0, None)
    axes = [centres(n) for n in whole.shape]  # aligned, 1 mm a voxel of the template
    at = np.meshgrid(*axes, indexing="ij")
    shares = [map_coordinates(each, at, order=1) for each in (fluid, grey, white)]
    found = np.where(map_coordinates(inside, at, order=1) > 0.5, 1 + np.argmax(shares, axis=0), 0)
    pieces = label(found > 0)[0]
    largest = 1 + np.argmax(np.bincount(pieces.ravel())[1:])
    low = images[0].affine[:3, 3] + [axis[0] for axis in axes] - EDGE / 2
    return np.where(pieces == largest, found, 0).astype(np.uint8), low


def centres(n: int) -> np.ndarray:
    """Centres of voxels along an axis of n millimetres, one of them in its middle: in its units, from 0."""
    half = np.arange(0.0, (n - 1) / 2, EDGE)
    return np.concatenate((-half[:0:-1], half)) + (n - 1) / 2


def trimmed(tissue: np.ndarray, low: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The voxels without empty layers around them, and their lowest corner."""
    filled = np.argwhere(tissue)
    first, last = filled.min(axis=0), filled.max(axis=0) + 1
    return tissue[tuple(map(slice, first, last))], low + EDGE * first


if __name__ == "__main__":
    main()
