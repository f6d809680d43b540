"""Mesh a coronal section of the MNI152 template: the samples ``brain`` and ``brain_holes``.

Run ``python docs/brain/make_brain.py``; it rewrites agglo_core/samples/data/brain*.npz. README.md
beside this file names the packages, the source of the template and its licence.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import shapely
from contourpy import FillType, contour_generator
from nilearn.datasets import load_mni152_gm_template, load_mni152_wm_template
from scipy.ndimage import gaussian_filter
from scipy.spatial import Delaunay, cKDTree
from scipy.stats import qmc

SECTION = -16  # mm, MNI y: through the thalami, the insulae and the temporal horns
LEVEL = 0.9  # probability of grey plus white matter on the outline; lower values close the sulci
BLUR = 0.5  # mm; takes the voxel steps off the contour
NECK = 1.4  # mm; narrower tissue is removed, narrower gaps are filled
LEAST_HOLE = 20.0  # mm²: the ventricles and the cisterns stay, specks are filled
SPACING = 1.38  # mm along the boundary; gives about 14,000 triangles
SEED = 152
DATA = Path(__file__).parents[2] / "agglo_core" / "samples" / "data"


def main() -> None:
    """Write both meshes and say how they came out."""
    tissue = section()
    for name, domain in (("brain", shapely.Polygon(tissue.exterior)), ("brain_holes", tissue)):
        points, triangles = triangulate(domain)
        angle = smallest_angles(points[triangles])
        print(  # noqa: T201
            f"{name}: {len(triangles)} triangles, {len(points)} points, {len(domain.interiors)} holes, "
            f"area {domain.area:.0f} mm², smallest angle {angle.min():.1f}°, 1% below "
            f"{np.quantile(angle, 0.01):.1f}°"
        )
        DATA.mkdir(exist_ok=True)
        np.savez_compressed(
            DATA / f"{name}.npz", points=points.astype(np.float32), triangles=triangles.astype(np.uint16)
        )


def section() -> shapely.Polygon:
    """Outline of the tissue in the section, x to the right and z up (mm), smoothed and with its holes."""
    grey, white = load_mni152_gm_template(resolution=1), load_mni152_wm_template(resolution=1)
    at_x, at_y, at_z = (grey.affine[axis, 3] for axis in range(3))  # the axes are aligned, 1 mm a voxel
    index = round(SECTION - at_y)
    probability = gaussian_filter((grey.get_fdata() + white.get_fdata())[:, index, :].T, BLUR)
    x, z = at_x + np.arange(probability.shape[1]), at_z + np.arange(probability.shape[0])
    contours = contour_generator(x, z, probability, fill_type=FillType.OuterOffset)
    regions = [
        shapely.Polygon(points[offsets[0] : offsets[1]], np.split(points, offsets[1:-1])[1:])
        for points, offsets in zip(*contours.filled(LEVEL, np.inf), strict=True)
    ]
    tissue = largest(shapely.union_all(regions))
    opened = largest(tissue.buffer(-NECK / 2).buffer(NECK / 2))
    rounded = largest(opened.buffer(NECK / 2).buffer(-NECK).buffer(NECK / 2))
    holes = [ring for ring in rounded.interiors if shapely.Polygon(ring).area >= LEAST_HOLE]
    return shapely.Polygon(rounded.exterior, holes)


def largest(region: shapely.Geometry) -> shapely.Polygon:
    """The connected part of largest area."""
    return max(shapely.get_parts(region), key=lambda part: part.area)


def triangulate(domain: shapely.Polygon, rounds: int = 100) -> tuple[np.ndarray, np.ndarray]:
    """Delaunay triangles of evenly spaced boundary points and relaxed interior ones.

    The interior points start without order, so that no direction is favoured. Each round moves every
    one to the centre of its triangles, which makes the triangles alike (Chen and Holst, "Efficient
    mesh optimization schemes based on optimal Delaunay triangulations", 2011); the boundary stays.
    """
    rings = [evenly(ring) for ring in (domain.exterior, *domain.interiors)]
    domain = shapely.Polygon(rings[0], rings[1:])  # from here on with straight sides
    shapely.prepare(domain)
    boundary, segments = np.concatenate(rings), loops(rings)
    inside = scatter(domain, boundary)
    for _ in range(rounds):
        points = np.concatenate((boundary, inside))
        inside = patch_centres(points, inner_delaunay(points, domain))[len(boundary) :]
    points = np.concatenate((boundary, inside)).astype(np.float32).astype(np.float64)
    triangles = inner_delaunay(points, domain)
    require_boundary(triangles, segments)
    return points, triangles


def evenly(ring: shapely.LinearRing) -> np.ndarray:
    """Points ``(n, 2)`` evenly spaced along a ring."""
    n = round(ring.length / SPACING)
    return shapely.get_coordinates(shapely.line_interpolate_point(ring, np.arange(n) * ring.length / n))


def loops(rings: list[np.ndarray]) -> np.ndarray:
    """Segments ``(s, 2)`` of closed rings whose points are numbered one ring after the other."""
    number = np.split(np.arange(sum(map(len, rings))), np.cumsum([len(ring) for ring in rings])[:-1])
    return np.concatenate([np.stack((ring, np.roll(ring, -1)), axis=1) for ring in number])


def scatter(domain: shapely.Polygon, boundary: np.ndarray) -> np.ndarray:
    """Evenly scattered points inside, away from the boundary, as many as equilateral triangles need."""
    low, high = np.reshape(domain.bounds, (2, 2))
    n = round(np.prod(high - low) / (np.sqrt(3.0) / 2 * SPACING**2))
    points = qmc.scale(qmc.Halton(2, rng=SEED).random(n), low, high)
    clear = cKDTree(boundary).query(points)[0] > 0.6 * SPACING
    return points[clear & shapely.contains_xy(domain, *points.T)]


def patch_centres(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """For each point, the mean of the centroids of its triangles weighted by area."""
    corners = points[triangles]
    area = signed_areas(corners)
    weighted = np.column_stack((area, area[:, None] * corners.mean(axis=1)))
    sums = np.zeros((len(points), 3))
    np.add.at(sums, triangles, weighted[:, None])
    return sums[:, 1:] / sums[:, :1]


def inner_delaunay(points: np.ndarray, domain: shapely.Polygon) -> np.ndarray:
    """Delaunay triangles, counter-clockwise, whose centroid lies in the domain."""
    triangles = Delaunay(points).simplices
    corners = points[triangles]
    turned = signed_areas(corners) < 0
    triangles[turned] = triangles[turned][:, [0, 2, 1]]
    return triangles[shapely.contains_xy(domain, *corners.mean(axis=1).T)]


def require_boundary(triangles: np.ndarray, segments: np.ndarray) -> None:
    """The edges of one triangle alone are the boundary segments, each once; else AssertionError."""
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    edges, count = np.unique(edges, axis=0, return_counts=True)
    wanted = np.unique(np.sort(segments, axis=1), axis=0)
    if count.max() > 2 or not np.array_equal(edges[count == 1], wanted):
        raise AssertionError("the triangulation does not respect the outline: reduce SPACING or raise NECK")


def signed_areas(corners: np.ndarray) -> np.ndarray:
    """Areas of triangles ``(n, 3, 2)``, positive counter-clockwise."""
    (ax, ay), (bx, by) = (np.moveaxis(corners[:, k] - corners[:, 0], -1, 0) for k in (1, 2))
    return (ax * by - ay * bx) / 2


def smallest_angles(corners: np.ndarray) -> np.ndarray:
    """Smallest angle (degrees) of each triangle ``(n, 3, 2)``."""
    ahead = np.roll(corners, -1, axis=1) - corners
    back = np.roll(corners, 1, axis=1) - corners
    cosine = (ahead * back).sum(-1) / np.linalg.norm(ahead, axis=-1) / np.linalg.norm(back, axis=-1)
    return np.degrees(np.arccos(cosine)).min(axis=1)


if __name__ == "__main__":
    main()
