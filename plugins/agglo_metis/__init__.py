"""Declare the METIS plugin."""

from agglo_core.authoring import Component, hookimpl


@hookimpl
def agglo_components() -> list[Component]:
    """Return this plugin's component, the bisector ``metis``."""
    return [
        Component(
            kind="bisector",
            name="metis",
            target="agglo_metis.metis:Metis",
            requires=("pymetis",),
            promises={"balanced": 0.05, "kway": True, "3d": True, "pickles": True},
            summary="METIS: multilevel bisection, or k-way partition in one call.",
        )
    ]
