"""Declare the discretisation PolyDG, its estimator, its solvers and its smoother."""

from agglo_core.authoring import Component, hookimpl


@hookimpl
def agglo_components() -> list[Component]:
    """Return this plugin's components: two discretisations, an estimator, four solvers and a smoother."""
    return [
        Component(
            kind="discretisation",
            name="polydg",
            target="agglo_polydg_mg.polydg:PolyDG",
            promises={"deterministic": True, "3d": True, "pickles": True, "patch_test": True},
            summary="Discontinuous polynomials on polygons and polyhedra (paper, §5).",
        ),
        Component(
            kind="discretisation",
            name="polydg_elasticity",
            target="agglo_polydg_mg.elasticity.discretisation:PolyDGElasticity",
            promises={"deterministic": True, "3d": True, "pickles": True},
            summary="Discontinuous polynomial displacements on polygons and polyhedra.",
        ),
        Component(
            kind="estimator",
            name="hierarchical",
            target="agglo_polydg_mg.hierarchical:Hierarchical",
            promises={"deterministic": True, "3d": True, "pickles": True},
            summary="Energy of the difference to a solution of the next higher degree.",
        ),
        Component(
            kind="solver",
            name="polydg_mg",
            target="agglo_polydg_mg.solver.polydg_multigrid:PolyDGMultigrid",
            promises={"deterministic": True, "3d": True, "pickles": True, "symmetric": True},
            summary="PolyDG with preconditioned conjugate gradients; the recipe depends on the mesh.",
        ),
        Component(
            kind="solver",
            name="polydg_mg_paper",
            target="agglo_polydg_mg.paper.paper_multigrid:PaperMultigrid",
            promises={"deterministic": True, "pickles": True},
            summary="The paper's V-cycle: PolyDG with additive Schwarz smoothing.",
        ),
        Component(
            kind="solver",
            name="multigrid",
            target="agglo_polydg_mg.paper.composed_multigrid:ComposedMultigrid",
            promises={"deterministic": True, "3d": True, "pickles": True, "symmetric": True},
            summary="PolyDG with configurable multigrid: transfer, smoother, cycle and more by name.",
        ),
        Component(
            kind="solver",
            name="polydg_cg",
            target="agglo_polydg_mg.plain_cg:PlainCG",
            promises={"deterministic": True, "3d": True, "pickles": True, "symmetric": True},
            summary="PolyDG with plain conjugate gradients, for comparison.",
        ),
        Component(
            kind="smoother",
            name="schwarz",
            target="agglo_polydg_mg.paper.schwarz:Schwarz",
            promises={"deterministic": True, "pickles": True},
            summary="The paper's smoother: conjugate gradients preconditioned by additive Schwarz.",
        ),
    ]
