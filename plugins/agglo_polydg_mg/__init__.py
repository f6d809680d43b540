"""Declaration of PolyDG and its multigrid solvers."""

from agglo_core import Command, Component, hookimpl


@hookimpl
def agglo_components() -> list[Component]:
    """The paper's solver, and the one it is compared with."""
    return [
        Component(
            kind="solver",
            name="polydg_mg_paper",
            target="agglo_polydg_mg.paper_multigrid:PaperMultigrid",
            promises={"deterministic": True, "pickles": True},
            summary="The paper's V-cycle: PolyDG with additive Schwarz smoothing.",
        ),
        Component(
            kind="solver",
            name="polydg_cg",
            target="agglo_polydg_mg.plain_cg:PlainCG",
            promises={"deterministic": True, "pickles": True},
            summary="PolyDG with plain conjugate gradients, for comparison.",
        ),
    ]


@hookimpl
def agglo_commands() -> list[Command]:
    """``agglo solve``."""
    return [
        Command(
            "solve", "agglo_polydg_mg.solve:solve", "Solve a diffusion problem with PolyDG and multigrid."
        ),
    ]
