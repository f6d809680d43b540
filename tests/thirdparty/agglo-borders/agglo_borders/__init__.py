"""Declaration of agglo-borders: a component for each remaining kind."""

from agglo_core.authoring import Component, hookimpl


@hookimpl
def agglo_components() -> list[Component]:
    """Return all components."""
    borders = "agglo_borders"
    robust = {"3d": True, "pickles": True}
    return [
        Component(
            "format",
            "toy",
            f"{borders}.toy_file:Toy",
            summary="Cells of the plane, as JSON.",
            suffixes=(".toy",),
        ),
        Component("sample", "cross", f"{borders}.cross:cross", summary="A cross of five squares."),
        Component("problem", "heat", f"{borders}.heat:Heat", summary="A heated plate that leaks."),
        Component(
            "solver",
            "cells_cg",
            f"{borders}.cells_cg:CellsCG",
            promises={"deterministic": True, **robust},
            summary="Conjugate gradients on the fluxes between cells.",
        ),
        Component(
            "smoother",
            "two_sweeps",
            f"{borders}.two_sweeps:GaussSeidel",
            promises={"deterministic": True, "pickles": True, "symmetric": True},
            summary="Sweeps of Gauss and Seidel, there and back.",
        ),
        Component(
            "metric",
            "crowding",
            f"{borders}.crowding:Crowding",
            promises={"deterministic": True, **robust},
            summary="Cells of an agglomerate, squared.",
        ),
        Component(
            "constraint",
            "apart",
            f"{borders}.apart:Apart",
            promises=robust,
            summary="Keeps cells of different tags apart.",
        ),
        Component("section", "sizes", f"{borders}.sizes:Sizes", summary="Parts of every level of every run."),
    ]
