"""The built-in components, declared through the same hook as any plugin's."""

from __future__ import annotations

from agglo_core.registry import Component, hookimpl

_METRICS = {
    "UF": ("UniformityFactor", "Diameter over the largest diameter (paper, §4)."),
    "UF99": ("UniformityFactor99", "Diameter over the 99th percentile of diameters; may exceed 1."),
    "CR": ("CircleRatio", "Largest inscribed circle's radius over half the diameter (paper, §4)."),
    "CRc": ("CentredCircleRatio", "The same with the circle centred at the centroid."),
    "diameter_ratio": ("DiameterRatio", "Diameter over a target h*."),
    "interface_length": ("InterfaceLength", "Measure of the faces shared with other agglomerates."),
    "cut": ("Cut", "Number of dual edges that leave (paper, §2.1)."),
    "ncut": ("NormalisedCut", "Cut over volume (paper, §2.1)."),
    "components": ("Components", "Number of connected components."),
    "cells": ("Cells", "Number of cells."),
}
_SHAPES = {
    "isoperimetric": ("IsoperimetricQuotient", "4π area over perimeter squared."),
    "convexity": ("Convexity", "Area over the area of the convex hull."),
    "star_shapedness": ("StarShapedness", "Area of the kernel (what sees the whole) over the area."),
    "box_ratio": ("BoxRatio", "Short over long side of the narrowest rectangle around it."),
    "edge_ratio": ("EdgeRatio", "Shortest over longest straight edge of the boundary."),
}
_PROBLEMS = {
    "diffusion": ("diffusion:Diffusion", "−∇·(κ∇u) = f; data by cell tag and boundary tag in a file."),
    "linear": ("linear:Linear", "A x = b from files, with unknowns in the cells of the mesh."),
    "constant": ("named:constant", "−Δu = 8 with u = 0 on the boundary (the paper's published counts)."),
    "sine": ("named:sine", "f = 2π² sin πx sin πy with u = 0 on the boundary (the paper's text)."),
}


@hookimpl
def agglo_components() -> list[Component]:
    """Refiner, fixer, metrics, geometric bisectors and problems."""
    geometric = {"deterministic": True, "balanced": True, "3d": True, "pickles": True}
    return [
        Component(
            kind="refiner",
            name="interface",
            target="agglo_core.components.refiners:InterfaceRefiner",
            promises={"deterministic": True, "invariant": True, "3d": True, "pickles": True},
            summary="Moves boundary cells to shorten the interface.",
        ),
        Component(
            kind="fixer",
            name="connectivity",
            target="agglo_core.components.fixers:ConnectivityFixer",
            promises={"deterministic": True, "invariant": True, "3d": True, "pickles": True},
            summary="Loose components join the neighbour they share most interface with.",
        ),
        Component(
            kind="bisector",
            name="coordinate",
            target="agglo_core.components.geometric:CoordinateBisection",
            promises=geometric,
            summary="Halves by measure across the longest extent along x, y (or z).",
        ),
        Component(
            kind="bisector",
            name="inertial",
            target="agglo_core.components.geometric:InertialBisection",
            promises=geometric | {"invariant": True},
            summary="Halves by measure across the principal axis.",
        ),
        Component(
            kind="bisector",
            name="sweep",
            target="agglo_core.components.straight_cuts:SweepBisection",
            promises={"deterministic": True, "invariant": True, "3d": True, "pickles": True},
            summary="The best straight cut along eight rotated principal axes: short and compact.",
        ),
        *(
            Component(
                kind="metric",
                name=name,
                target=f"agglo_core.components.metrics:{target}",
                promises={"deterministic": True, "pickles": True}
                | ({"3d": True} if "CR" not in name else {}),
                summary=summary,
            )
            for name, (target, summary) in _METRICS.items()
        ),
        *(
            Component(
                kind="metric",
                name=name,
                target=f"agglo_core.components.shape_metrics:{target}",
                promises={"deterministic": True, "pickles": True},
                summary=summary,
            )
            for name, (target, summary) in _SHAPES.items()
        ),
        *(
            Component(
                kind="problem",
                name=name,
                target=f"agglo_core.problems.{target}",
                promises={"pickles": True},
                summary=summary,
            )
            for name, (target, summary) in _PROBLEMS.items()
        ),
    ]
