"""Declare the discretisation by virtual elements."""

from agglo_core.authoring import Component, hookimpl


@hookimpl
def agglo_components() -> list[Component]:
    """Return the plugin's component, a discretisation."""
    return [
        Component(
            kind="discretisation",
            name="vem",
            target="agglo_vem.virtual_elements:VirtualElements",
            promises={"deterministic": True, "3d": True, "pickles": True, "patch_test": True},
            summary="Conforming virtual elements: degrees 1 to 3 on polygons, 1 on polyhedra.",
        )
    ]
