"""Comparison of ``gnn`` with agglomerated meshes published by the paper's authors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from agglo_paper.tables.published import published_values
from agglo_paper.tables.record import Cell, Row, Table
from agglo_paper.tables.shapes import cell, unit
from agglo_paper.work.plan import Plan
from agglo_paper.work.store import Results, Unit
from agglo_paper.work.strategies import Strategy

_UF_SLACK = 0.03


def _ours(plan: Plan) -> Strategy | None:
    return next((each for each in plan.usable if each.name == "gnn"), None)


def _cases(source: str) -> Mapping[str, tuple[str, str, str]]:
    """Return for each table row the key of the authors' numbers, the mesh, and the choice of targets."""
    brain = "brain (our section)" if source == "brain" else "brain (this mesh)"
    return {
        "random": ("random", "paper:random", "run"),
        "voronoi": ("voronoi", "paper:voronoi", "run"),
        brain: ("brain", source, "brain"),
    }


def authors_units(plan: Plan, source: str) -> Iterator[Unit]:
    """Yield the computations for the table."""
    ours = _ours(plan)
    if ours is not None:
        yield from (unit(mesh, convention, ours) for _, mesh, convention in _cases(source).values())


def authors_table(plan: Plan, results: Results, source: str, name: str) -> Table:
    """Return the table of part count, uniformity factor, circle ratios for the authors' files and `gnn`."""
    gnn, rows = _ours(plan), []
    for row, (key, mesh, convention) in _cases(source).items():
        authors = published_values()["authors"][key]
        cells: dict[str, Cell | str] = {
            f"authors' {method}": _words([numbers[m] for m in ("K", "UF", "CR", "CRc")])
            for method, numbers in authors.items()
        }
        if gnn is not None:
            gnn_values = [
                cell(plan, results, gnn, mesh, convention, m).ours for m in ("K", "UF", "CR", "CRc")
            ]
            cells["gnn"] = _words(gnn_values)
            other_mesh = key == "brain" and source == "brain"
            rows.append(
                Row(row, cells, "another mesh" if other_mesh else _verdict(gnn_values, authors["GNN"]))
            )
    note = "ahead: CR and CRc above the authors' GNN, UF no more than .03 below"
    return Table(f"{name}-authors", "gnn beside the authors' files: K / UF / CR / CRc", rows, 3, notes=[note])


def _words(values: list[float | None]) -> str:
    K, *shapes = values
    return " / ".join([Cell(K).text(0), *(Cell(value).text(3) for value in shapes)])


def _verdict(found: list[float | None], theirs: Mapping[str, float]) -> str:
    _, uf, cr, centred = (-1.0 if value is None else value for value in found)
    ahead = cr > theirs["CR"] and centred > theirs["CRc"] and uf >= theirs["UF"] - _UF_SLACK
    return "ahead" if ahead else "not ahead"
