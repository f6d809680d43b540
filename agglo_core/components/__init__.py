"""The built-in components, declared through the same hook as any plugin's: one table per kind."""

from __future__ import annotations

from agglo_core.components.declared import (
    CONSTRAINTS,
    FORMATS,
    METRICS,
    MULTIGRID,
    NEEDED_BY_FORMATS,
    PROBLEMS,
    ROUND,
    SAMPLES,
    SHAPES,
    SMOOTHERS,
    SOLID_FORMATS,
    SOLID_SAMPLES,
)
from agglo_core.registry import Component, hookimpl


@hookimpl
def agglo_components() -> list[Component]:
    """All that comes with agglo and with none of its plugins."""
    own = (_refiners, _bisectors, _constraints, _metrics, _formats, _samples, _problems)
    parts = (*own, _smoothers, _multigrid, _sections)
    return [component for each in parts for component in each()]


def _refiners() -> list[Component]:
    alike = {"deterministic": True, "3d": True, "pickles": True}
    return [
        Component(
            kind="refiner",
            name="interface",
            target="agglo_core.components.refiners:InterfaceRefiner",
            promises=alike | {"invariant": True},
            summary="Moves boundary cells to shorten the interface.",
        ),
        Component(
            kind="refiner",
            name="compactness",
            target="agglo_core.components.compactness:CompactnessRefiner",
            promises=alike | {"invariant": True},
            summary="Moves boundary cells for compact parts with short interfaces, many parts at once.",
        ),
        Component(
            kind="refiner",
            name="fm",
            target="agglo_core.components.fm:FMRefiner",
            promises=alike,
            summary="Moves chains of boundary cells for short interfaces at given balance (subdomains).",
        ),
        Component(
            kind="refiner",
            name="balance",
            target="agglo_core.components.balance:BalanceRefiner",
            promises=alike,
            summary="Hands cells on between parts until their sizes are even, within a tolerance or exactly.",
        ),
        Component(
            kind="refiner",
            name="descent",
            target="agglo_core.components.descent:DescentRefiner",
            promises=alike,
            summary="Moves boundary cells to improve an objective or a metric of your choice.",
        ),
        Component(
            kind="refiner",
            name="anneal",
            target="agglo_core.components.anneal:AnnealRefiner",
            promises={"3d": True, "pickles": True},
            summary="Anneals the parts of each block to be round and alike in width.",
        ),
        Component(
            kind="fixer",
            name="connectivity",
            target="agglo_core.components.fixers:ConnectivityFixer",
            promises=alike | {"invariant": True},
            summary="Loose components join the neighbour with which they share the most interface.",
        ),
    ]


def _bisectors() -> list[Component]:
    alike = {"deterministic": True, "3d": True, "pickles": True}
    return [
        Component(
            kind="bisector",
            name="coordinate",
            target="agglo_core.components.geometric:CoordinateBisection",
            promises=alike | {"balanced": True},
            summary="Halves by measure across the longest extent along x, y (or z).",
        ),
        Component(
            kind="bisector",
            name="inertial",
            target="agglo_core.components.geometric:InertialBisection",
            promises=alike | {"balanced": True, "invariant": True},
            summary="Halves by measure across the principal axis.",
        ),
        Component(
            kind="bisector",
            name="sweep",
            target="agglo_core.components.straight_cuts:SweepBisection",
            promises=alike | {"invariant": True},
            summary="The best straight cut along eight rotated principal axes: short and compact.",
        ),
    ]


def _metrics() -> list[Component]:
    targets = {name: (f"metrics:{target}", summary) for name, (target, summary) in METRICS.items()}
    targets |= {name: (f"round_shapes:{target}", summary) for name, (target, summary) in ROUND.items()}
    targets |= {name: (f"shape_metrics:{target}", summary) for name, (target, summary) in SHAPES.items()}
    return [
        Component(
            kind="metric",
            name=name,
            target=f"agglo_core.components.{target}",
            promises={"deterministic": True, "pickles": True}
            | ({} if name == "edge_ratio" else {"3d": True}),
            summary=summary,
        )
        for name, (target, summary) in targets.items()
    ]


def _formats() -> list[Component]:
    return [
        Component(
            kind="format",
            name=name,
            target=f"agglo_core.io.{target}",
            requires=NEEDED_BY_FORMATS.get(name, ()),
            promises={"pickles": True} | ({"3d": True} if name in SOLID_FORMATS else {}),
            summary=summary,
        )
        for name, (target, summary) in FORMATS.items()
    ]


def _samples() -> list[Component]:
    return [
        Component(
            kind="sample",
            name=name,
            target=f"agglo_core.samples:{name}",
            promises={"3d": True} if name in SOLID_SAMPLES else {},
            summary=summary,
        )
        for name, summary in SAMPLES.items()
    ]


def _problems() -> list[Component]:
    return [
        Component(
            kind="problem",
            name=name,
            target=f"agglo_core.problems.{target}",
            promises={"pickles": True},
            summary=summary,
        )
        for name, (target, summary) in PROBLEMS.items()
    ]


def _smoothers() -> list[Component]:
    return [
        Component(
            kind="smoother",
            name=name,
            target=f"agglo_core.multigrid.{target}",
            promises={"deterministic": True, "pickles": True, "symmetric": True},
            summary=summary,
        )
        for name, (target, summary) in SMOOTHERS.items()
    ]


def _multigrid() -> list[Component]:
    alike = {"deterministic": True, "pickles": True}
    return [
        Component(
            kind=kind,
            name=name,
            target=f"agglo_core.multigrid.{target}",
            promises=alike | ({"symmetric": True} if kind == "coarse_solver" else {}),
            summary=summary,
        )
        for (kind, name), (target, summary) in MULTIGRID.items()
    ]


def _constraints() -> list[Component]:
    return [
        Component(
            kind="constraint",
            name=name,
            target=f"agglo_core.components.{target}",
            promises={"pickles": True, "3d": True},
            summary=summary,
        )
        for name, (target, summary) in CONSTRAINTS.items()
    ]


def _sections() -> list[Component]:
    return [
        Component(
            kind="section",
            name="pareto",
            target="agglo_core.draw.webpage.pareto_section:ParetoSection",
            promises={"pickles": True},
            summary="Roundness, evenness and seconds of several runs, and the Pareto front.",
        )
    ]
