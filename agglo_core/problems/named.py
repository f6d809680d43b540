"""Diffusion problems that have a name."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Float
from agglo_core.problems.diffusion import Diffusion


def constant(source: float = 8.0) -> Diffusion:
    """−Δu = f with u = 0 on the boundary.

    Parameters
    ----------
    source : float
        The constant f: 8 as in the paper's published counts.
    """
    return Diffusion(source=source)


def sine() -> Diffusion:
    """f = 2π² sin πx sin πy, that of the paper's text: u = sin πx sin πy on the unit square.

    In space f = 3π² u with u = sin πx sin πy sin πz on the unit cube.
    """
    return Diffusion(source=_sine_source, exact=_sine)


def _sine(points: Float) -> Float:
    return np.asarray(np.sin(np.pi * points).prod(axis=1))


def _sine_source(points: Float) -> Float:
    return np.asarray(points.shape[1] * np.pi**2 * _sine(points))
