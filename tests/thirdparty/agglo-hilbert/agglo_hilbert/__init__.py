"""Declaration of agglo-hilbert: a bisector, a refiner, a metric and a command."""

from agglo_core import Command, Component, hookimpl


@hookimpl
def agglo_components() -> list[Component]:
    """The components ``hilbert``, ``leaves`` and ``gyration``."""
    kept = {"deterministic": True, "3d": True, "pickles": True}
    return [
        Component(
            kind="bisector",
            name="hilbert",
            target="agglo_hilbert.bisector:Hilbert",
            requires=("numpy",),
            promises=kept,
            summary="Halves the cells along the Hilbert curve.",
        ),
        Component(
            kind="refiner",
            name="leaves",
            target="agglo_hilbert.refiner:Leaves",
            requires=("numpy",),
            promises=kept,
            summary="Moves cells held by one neighbour only, where that shortens the interface.",
        ),
        Component(
            kind="metric",
            name="gyration",
            target="agglo_hilbert.metric:Gyration",
            requires=("numpy",),
            promises=kept,
            summary="Radius of gyration of the cells over the diameter.",
        ),
    ]


@hookimpl
def agglo_commands() -> list[Command]:
    """The command ``agglo hilbert-order``."""
    summary = "Print the cells of a sample along the curve."
    return [Command("hilbert-order", "agglo_hilbert.command:order", summary)]
