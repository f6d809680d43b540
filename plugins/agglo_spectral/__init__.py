"""Declare the spectral plugin."""

from agglo_core.authoring import Component, hookimpl


@hookimpl
def agglo_components() -> list[Component]:
    """Return this plugin's component, the bisector ``spectral``."""
    return [
        Component(
            kind="bisector",
            name="spectral",
            target="agglo_spectral.spectral:Spectral",
            promises={
                "deterministic": True,
                "invariant": True,
                "balanced": 0.25,
                "3d": True,
                "pickles": True,
            },
            summary="Fiedler vector of the weighted graph Laplacian, cut at the smallest normalised cut.",
        )
    ]
