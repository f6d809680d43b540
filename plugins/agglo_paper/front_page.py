"""The front page of the results: verdicts on claims, numbers of reproduced rows, command and versions."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path

from agglo_paper.claims import claims
from agglo_paper.tables.published import EXACT, NEAR, NOT
from agglo_paper.tables.record import Page
from agglo_paper.work.plan import Plan
from agglo_paper.work.store import Results, versions

_INTRO = """# The paper, table by table

Antonietti, Farenga, Manuzzi, Martinelli, Saverio, *Agglomeration of polygonal grids using graph neural
networks with applications to multigrid solvers*: every table and figure, ours beside the printed numbers.

*Reproduced* is equal as printed. *Within band* is as near as one grid at one size can be expected to come
(UF ± .03, CR ± .02, ratios ± 5 %, iterations ± 35 %, CG ± 1 %), or the printed number lies inside the spread
of our own repetitions. A row is judged by its learned columns, k-means and the better of the two networks:
`GNN`, trained by the paper's recipe, and `gnn`, ours; columns with another verdict are named behind it.
What is not reproduced to the digit has its reason below its table.
"""


def front(plan: Plan, results: Results, pages: Sequence[Page], quick: bool, mesh: Path | None) -> str:
    """Return the front page ``README.md`` of the results in Markdown."""
    parts = [_INTRO, _provenance(quick, mesh), "## The claims\n", _claims(plan, results)]
    parts += ["## The tables\n", _summary(pages), *_authors(pages)]
    if problems := plan.problems():
        parts.append("\n".join(f"*{problem}.*" for problem in problems) + "\n")
    return "\n".join(parts)


def _provenance(quick: bool, mesh: Path | None) -> str:
    """Return the command line and package versions behind the results, without the mesh file's folder."""
    listed = ", ".join(f"{name} {version}" for name, version in versions().items())
    return f"Made by `{command('all', quick, mesh)}` with {listed}.\n"


def command(word: str, quick: bool, mesh: Path | None) -> str:
    """Return the command line that reproduces a page."""
    words = ["agglo", "paper", word, *(["--quick"] if quick else [])]
    return shlex.join([*words, *(["--mesh", mesh.name] if mesh is not None else [])])


def _claims(plan: Plan, results: Results) -> str:
    intro = (
        f"Each held against {plan.fresh} fresh meshes in each of {len(plan.families)} families "
        "([statistics](statistics.md)). Cells: mean paired difference ± standard deviation; wins:losses; p "
        "of the two-sided sign test; outcome at the level 0.01. `GNN` is the paper's network trained by its "
        "recipe, `gnn` ours.\n\n"
    )
    return intro + "\n".join(claim.markdown() for claim in claims(plan, results))


def _summary(pages: Sequence[Page]) -> str:
    """Return a table with the numbers of reproduced rows, rows within tolerance and other rows, per page."""
    lines = [f"| page | rows | {EXACT} | {NEAR} | {NOT} |", "|---|---|---|---|---|"]
    for page in pages:
        verdicts = [row.verdict for table in page.tables for row in table.rows if row.verdict]
        counts = [sum(each.startswith(kind) for each in verdicts) for kind in (EXACT, NEAR, NOT)]
        shown = [str(sum(counts)), *map(str, counts)] if sum(counts) else ["–"] * 4
        lines.append(f"| [{page.title}]({page.name}.md) | {' | '.join(shown)} |")
    return "\n".join(lines) + "\n"


def _authors(pages: Sequence[Page]) -> list[str]:
    """Return the table that compares `gnn` with files published by the authors.

    It refers to the user's mesh if one is given.
    """
    found = [table for page in pages for table in page.tables if table.name.endswith("-authors")]
    return [table.markdown() for table in found[-1:]]
