"""Declaration of PolyDG and its multigrid solvers."""

from agglo_core import Command, Component, hookimpl


@hookimpl
def agglo_components() -> list[Component]:
    """The paper's solver."""
    return [
        Component(
            kind="solver",
            name="polydg_mg_paper",
            target="agglo_polydg_mg.paper:PaperMultigrid",
            promises={"deterministic": True, "pickles": True},
            summary="The paper's V-cycle: PolyDG with additive Schwarz smoothing.",
        )
    ]


@hookimpl
def agglo_commands() -> list[Command]:
    """Solve a problem; print the paper's table of counts."""
    return [
        Command(
            "solve", "agglo_polydg_mg.solve:solve", "Solve a diffusion problem with PolyDG and multigrid."
        ),
        Command(
            "paper-counts", "agglo_polydg_mg.tables:paper_counts", "The paper's multigrid counts, and ours."
        ),
    ]
