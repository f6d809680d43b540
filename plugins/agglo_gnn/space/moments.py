"""Compiled inputs of the 3-D network: principal axes, moments and features of a piece."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.authoring import helper, kernel
from agglo_core.compiled.frames import centre_block, largest_block
from agglo_core.split import piece_frames

_EVEN, _ODD = 16, 10  # numbers of features
# Ratio of second moments above which their axes carry little information, and fourth moments decide. The
# network is trained with this number: another requires new training (benchmarks/solid_parts.py).
_ISOTROPIC = 0.9
_TURNS = 6  # maximum number of rounds over the three planes, each of at most three rotations
_TURNED = 1e-9  # angle in radians below which rotation ends
_SECOND, _THIRD, _FOURTH, _END = 9, 18, 45, 126  # start of each order's moments, after the frame


@helper(allocates=True)
def moment_room():
    """Allocate the workspace for principal axes, moments and features.

    It consists of frame and moments ``(126,)``, ``(3, 3)`` twice, even and odd features, and sums
    ``(125,)``. Frame and moments are full tensors, one after the other: 3², then 3², 3³ and 3⁴ numbers with
    order 2 to 4, the last index running fastest. Sums of x^a y^b z^c are at ``25 a + 5 b + c``.
    """
    return np.empty(_END), np.empty((3, 3)), np.empty((3, 3)), np.empty(_EVEN), np.empty(_ODD), np.empty(125)


@helper(reorder_sums=True)
def _low_moments(n, x, y, z, w, M):
    """Compute the second and third moments: that of x^a y^b z^c is ``M[25 a + 5 b + c]``."""
    xx, xy, xz, yy, yz, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    xxx, xxy, xxz, xyy, xyz, xzz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    yyy, yyz, yzz, zzz = 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        a, b, c = w[i] * x[i], w[i] * y[i], w[i] * z[i]
        xx += a * x[i]
        xy += a * y[i]
        xz += a * z[i]
        yy += b * y[i]
        yz += b * z[i]
        zz += c * z[i]
        xxx += a * x[i] * x[i]
        xxy += a * x[i] * y[i]
        xxz += a * x[i] * z[i]
        xyy += b * x[i] * y[i]
        xyz += a * y[i] * z[i]
        xzz += c * x[i] * z[i]
        yyy += b * y[i] * y[i]
        yyz += b * y[i] * z[i]
        yzz += c * y[i] * z[i]
        zzz += c * z[i] * z[i]
    M[50], M[30], M[26], M[10], M[6], M[2] = xx, xy, xz, yy, yz, zz
    M[75], M[55], M[51], M[35], M[31], M[27] = xxx, xxy, xxz, xyy, xyz, xzz
    M[15], M[11], M[7], M[3] = yyy, yyz, yzz, zzz


@helper(reorder_sums=True)
def _fourth_moments(n, x, y, z, w, M):
    """Compute the fourth moments: that of x^a y^b z^c is ``M[25 a + 5 b + c]``."""
    m400, m310, m301, m220, m211, m202, m130, m121 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    m112, m103, m040, m031, m022, m013, m004 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        xx, xy, yy, yz, zz = x[i] * x[i], x[i] * y[i], y[i] * y[i], y[i] * z[i], z[i] * z[i]
        wxx, wxy, wyy, wzz = w[i] * xx, w[i] * xy, w[i] * yy, w[i] * zz
        m400 += wxx * xx
        m310 += wxx * xy
        m301 += wxx * x[i] * z[i]
        m220 += wxx * yy
        m211 += wxx * yz
        m202 += wxx * zz
        m130 += wxy * yy
        m121 += wxy * yz
        m112 += wxy * zz
        m103 += wzz * x[i] * z[i]
        m040 += wyy * yy
        m031 += wyy * yz
        m022 += wyy * zz
        m013 += wzz * yz
        m004 += wzz * zz
    M[100], M[80], M[76], M[60], M[56], M[52], M[40] = m400, m310, m301, m220, m211, m202, m130
    M[36], M[32], M[28], M[20], M[16] = m121, m112, m103, m040, m031
    M[12], M[8], M[4] = m022, m013, m004


@helper
def _fill_tensors(sums, inertia, t):
    """Expand the moments to full symmetric tensors, with lengths scaled to inertia 3."""
    scale = 1.0 / np.sqrt(inertia / 3.0)
    scale2 = scale * scale
    for i in range(3):
        for j in range(3):
            # An index 0, 1 or 2 means a factor x, y or z, hence 25, 5 or 1 in the index of a sum.
            ij = (5 ** (2 - i)) + (5 ** (2 - j))
            t[3 * i + j] = 1.0 if i == j else 0.0
            t[_SECOND + 3 * i + j] = scale2 * sums[ij]
            for k in range(3):
                ijk = ij + 5 ** (2 - k)
                t[_THIRD + 9 * i + 3 * j + k] = scale2 * scale * sums[ijk]
                for m in range(3):
                    t[_FOURTH + 27 * i + 9 * j + 3 * k + m] = scale2 * scale2 * sums[ijk + 5 ** (2 - m)]


@helper
def _turn_index(t, start, end, stride, turn):
    """Apply a rotation to one index of the tensor ``t[start:end]`` with stride ``stride``."""
    for outer in range(start, end, 3 * stride):
        for at in range(outer, outer + stride):
            x, y, z = t[at], t[at + stride], t[at + 2 * stride]
            for k in range(3):
                t[at + k * stride] = turn[k, 0] * x + turn[k, 1] * y + turn[k, 2] * z


@helper
def _turn_all(t, turn):
    """Rotate the axes, and all moment tensors with them."""
    # The frame is rotated by rows only; moments are rotated in all indices, with strides 1, 3, 9, 27.
    _turn_index(t, 0, _SECOND, 3, turn)
    stride = 1
    for order in range(1, 5):
        if order <= 2:
            _turn_index(t, _SECOND, _THIRD, stride, turn)
        if order <= 3:
            _turn_index(t, _THIRD, _FOURTH, stride, turn)
        _turn_index(t, _FOURTH, _END, stride, turn)
        stride *= 3


@helper
def _turn_to_least_fourth(t, turn):
    """Rotate axes with nearly equal second moments so that their fourth moments are minimal.

    For a cube these axes are parallel to its sides.
    """
    for _ in range(_TURNS):
        largest = 0.0
        for i in range(2):
            for j in range(i + 1, 3):
                # 1. Skip planes of two axes whose second moments determine a direction.
                one, other = t[_SECOND + 4 * i], t[_SECOND + 4 * j]
                if min(one, other) < _ISOTROPIC * max(one, other):
                    continue
                # 2. With p and q along the axes, ⟨p⁴ + q⁴⟩ is ¾ ⟨r⁴⟩ + ¼ Re ⟨(p + iq)⁴⟩. Rotation by θ
                # multiplies the latter by e^(−4iθ), and its real part is minimal where it is negative and
                # real. odd is a quarter of the imaginary part.
                iiii, jjjj, iijj = t[_FOURTH + 40 * i], t[_FOURTH + 40 * j], t[_FOURTH + 36 * i + 4 * j]
                odd = t[_FOURTH + 39 * i + j] - t[_FOURTH + 27 * i + 13 * j]
                angle = 0.25 * np.arctan2(-4.0 * odd, 6.0 * iijj - iiii - jjjj)
                # 3. Rotate frame and moments. This changes the other planes: repeat until no rotation is
                # left.
                for k in range(3):
                    for m in range(3):
                        turn[k, m] = 1.0 if k == m else 0.0
                turn[i, i], turn[j, j] = np.cos(angle), np.cos(angle)
                turn[i, j], turn[j, i] = np.sin(angle), -np.sin(angle)
                _turn_all(t, turn)
                largest = max(largest, abs(angle))
        if largest < _TURNED:
            break


@helper
def frame_by_moments(n, local, shares, inertia, workspace):
    """Compute the principal axes of a piece, as rows, and moments along them, in ``workspace``.

    Axes with nearly equal second moments are rotated to minimal fourth moments. Order and signs of the axes
    are arbitrary. Cells are read twice; after that only tensors are rotated.
    """
    t, values, frame, _, _, sums = workspace
    # 1. Moments along the coordinate axes.
    _low_moments(n, local[0], local[1], local[2], shares, sums)
    _fourth_moments(n, local[0], local[1], local[2], shares, sums)
    _fill_tensors(sums, inertia, t)
    # 2. Eigenvectors of the second moments, and moments along them.
    for i in range(3):
        for j in range(3):
            values[i, j] = t[_SECOND + 3 * i + j]
    piece_frames.diagonalise(values, frame)
    _turn_all(t, frame)
    # 3. Second moments leave a cube undetermined: fourth moments fix it.
    _turn_to_least_fourth(t, values)


@helper
def fill_features(n, t, i, j, k, even, odd):
    """Write the network inputs for axis i and its tilt towards axis j, where k is the third axis.

    Moments and moment products: ``even`` features do not change when an axis is reversed, ``odd``
    features change sign with i and with j. 3 / ∛n is the size in cells.
    """
    second, third, fourth = _SECOND, _THIRD, _FOURTH
    iii, jjj, kkk = t[third + 13 * i], t[third + 13 * j], t[third + 13 * k]
    iij, ijj, ikk = t[third + 12 * i + j], t[third + 9 * i + 4 * j], t[third + 9 * i + 4 * k]
    jkk, ijk, iik = t[third + 9 * j + 4 * k], t[third + 9 * i + 3 * j + k], t[third + 12 * i + k]
    # Even: moments with order 2 and 4 (⟨p⁴⟩ over its value for a normal distribution with variance 1),
    # products of two third moments, the size.
    even[0], even[1], even[2] = t[second + 4 * i], t[second + 4 * j], t[second + 4 * k]
    even[3], even[4], even[5] = t[fourth + 40 * i] / 3, t[fourth + 40 * j] / 3, t[fourth + 40 * k] / 3
    even[6], even[7] = t[fourth + 36 * i + 4 * j], t[fourth + 36 * i + 4 * k]
    even[8], even[9], even[10], even[11] = t[fourth + 36 * j + 4 * k], iii * iii, iii * ijj, iii * ikk
    even[12], even[13], even[14], even[15] = jjj * jjj, iij * iij, iik * iik, 3.0 / np.cbrt(n)
    # Odd: moments and products of two third moments with odd powers of i and j.
    odd[0], odd[1], odd[2] = t[second + 3 * i + j], t[fourth + 39 * i + j], t[fourth + 27 * i + 13 * j]
    odd[3], odd[4], odd[5] = t[fourth + 27 * i + 9 * j + 4 * k], iii * iij, ijj * iij
    odd[6], odd[7], odd[8], odd[9] = ijj * jjj, iii * jjj, ikk * jkk, ijk * kkk


@kernel
def describe_solids(offsets, centroids, weights, measures):
    """Compute the network inputs for each block in a 3-D graph.

    Returns even ``(B, 6, 16)`` and odd features ``(B, 6, 10)`` for axes (0, 1, 2), (0, 2, 1), (1, 2, 0),
    (1, 0, 2), (2, 0, 1) and (2, 1, 0); the frames ``(B, 3, 3)``, the moments along them ``(B, 117)``,
    positions ``(n, 3)`` about the centres of mass with lengths scaled to inertia 3, shares ``(n,)``, and
    the inverse measure of typical sections ``(B,)``.
    """
    blocks, total, largest = len(offsets) - 1, len(weights), largest_block(offsets)
    local, shares, workspace = np.empty((3, largest)), np.empty(largest), moment_room()
    even, odd, sections = np.empty((blocks, 6, _EVEN)), np.empty((blocks, 6, _ODD)), np.empty(blocks)
    frames, moments = np.empty((blocks, 3, 3)), np.empty((blocks, _END - _SECOND))
    cells, all_shares = np.empty((total, 3)), np.empty(total)
    for b in range(blocks):
        start, n = offsets[b], offsets[b + 1] - offsets[b]
        sections[b], inertia, _ = centre_block(start, n, centroids, weights, measures, local, shares)
        frame_by_moments(n, local, shares, inertia, workspace)
        t, unit = workspace[0], 1.0 / np.sqrt(inertia / 3.0)
        for i in range(3):
            # Features of each axis towards both others, in the order of the network.
            j, k = (i + 1) % 3, (i + 2) % 3
            fill_features(n, t, i, j, k, even[b, 2 * i], odd[b, 2 * i])
            fill_features(n, t, i, k, j, even[b, 2 * i + 1], odd[b, 2 * i + 1])
            for m in range(3):
                frames[b, i, m] = t[3 * i + m]
        for m in range(_END - _SECOND):
            moments[b, m] = t[_SECOND + m]
        for c in range(n):
            all_shares[start + c] = shares[c]
            for m in range(3):
                cells[start + c, m] = unit * local[m, c]
    return even, odd, frames, moments, cells, all_shares, sections
