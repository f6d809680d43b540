"""Verdicts on the paper's claims, from results on newly generated meshes and from timings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from agglo_paper.statistics import compare_pairs, fresh_values, same_sizes
from agglo_paper.tables.record import Row, Table
from agglo_paper.tables.runtime import curves
from agglo_paper.work.plan import Plan
from agglo_paper.work.store import Results
from agglo_paper.work.strategies import Strategy

_LEAST = 8  # smallest number of agreeing meshes for a sign test at the level 0.01
_MEASURES: Final = (
    ("CRc", "Learning-based strategies have rounder agglomerates than METIS (CRc, what the paper prints)"),
    ("CR", "The same, with CR as its text defines it"),
    ("mg", "With them multigrid needs fewer iterations than with METIS (ℓ = 3, m = 3, p = 1)"),
)


@dataclass(frozen=True)
class Claim:
    """A claim of the paper, its verdict, and a table with the evidence."""

    text: str
    verdict: str
    evidence: Table

    def markdown(self) -> str:
        """Return the claim in Markdown: heading, verdict and evidence."""
        title, rest = self.evidence.markdown().split("\n\n", 1)
        return f"{title}\n\n**{self.verdict}**\n\n{rest}"


def claims(plan: Plan, results: Results) -> Iterator[Claim]:
    """Yield the claims in the paper's order, each with its verdict and evidence."""
    for name, text in _MEASURES:
        for rival, setting in (
            (plan.printed[0], "METIS as the paper runs it, by count"),
            (same_sizes(plan), "METIS held to the same diameters"),
        ):
            if rival is not None and not rival.problem and (name != "mg" or plan.solver):
                yield _comparison(plan, results, f"{text}: {setting}", rival, name)
    if plan.solver:
        kmeans = plan.printed[1]
        if not kmeans.problem:
            yield _comparison(plan, results, "Of the two the network needs fewer than k-means", kmeans, "mg")
        yield _levels_claim(plan, results)
        yield _gradients_claim(plan, results)
    yield _speed_claim(plan, results)


def _claim(text: str, verdict: str, rows: Sequence[Row], notes: Sequence[str] = (), digits: int = 3) -> Claim:
    return Claim(text, verdict, Table("claim", text, rows, digits, "method", notes))


def _learned_strategies(plan: Plan) -> list[Strategy]:
    """Return the available learned methods: the paper's k-means and network, and `gnn`."""
    return [each for each in plan.compared[1:] if not each.problem]


def _judged_strategies(plan: Plan) -> list[Strategy]:
    """Return METIS as the paper runs it and the learned methods, as far as available."""
    return [each for each in plan.compared if not each.problem]


def _comparison(plan: Plan, results: Results, text: str, rival: Strategy, name: str) -> Claim:
    # 1. Paired differences to the rival, per family
    rows, outcomes = [], []
    for case in _learned_strategies(plan):
        if case is rival:
            continue
        pairs = {family: compare_pairs(plan, results, case, rival, family, name) for family in plan.families}
        outcomes += [case.outcome for case in pairs.values()]
        digits = 1 if name == "mg" else 3
        rows.append(Row(case.name, {family: case.text(digits) for family, case in pairs.items()}))
    # 2. Verdict by the number of better and worse outcomes
    better, worse, n = outcomes.count("better"), outcomes.count("worse"), len(outcomes)
    if plan.fresh < _LEAST:
        verdict = "Too few meshes to tell."
    elif n and better == n:
        verdict = "Confirmed: better in every comparison."
    elif not better:
        verdict = f"Refuted: better in none of {n} comparisons (method × family), worse in {worse}."
    else:
        verdict = f"In part: better in {better} of {n} comparisons (method × family), worse in {worse}."
    return _claim(text, verdict, rows)


def _levels_claim(plan: Plan, results: Results) -> Claim:
    rows, shares = [], []
    for strategy in _judged_strategies(plan):
        cells = {}
        for family in plan.families:
            spread = fresh_values(plan, results, strategy, family, "spread")
            counts = spread[~np.isnan(spread)]
            if len(counts):
                shares.append(float((counts <= 1).mean()))
                cells[family] = f"{100 * shares[-1]:.0f} % (at most {counts.max():.0f})"
        rows.append(Row(strategy.name, dict(cells)))
    verdict = f"In part: on {100 * np.mean(shares):.0f} % of the meshes." if shares else "Not measured."
    verdict = "Confirmed." if shares and min(shares) >= 0.9 else verdict
    note = "share of meshes where the counts for ℓ = 2, 3, 4 differ by at most 1 (by how much on any)"
    return _claim("Iterations do not depend on the number of levels ℓ (m = 3, p = 1)", verdict, rows, [note])


def _gradients_claim(plan: Plan, results: Results) -> Claim:
    rows = []
    shares: dict[str, list[float]] = {}
    for case in _judged_strategies(plan):
        cells: dict[str, str] = {}
        for family in plan.families:
            fair, as_printed = (
                _fraction_below_cg(plan, results, case, family, tol) for tol in ("1e-8", "1e-6")
            )
            shares.setdefault(case.name, []).append(fair)
            cells[family] = f"{100 * fair:.0f} % ({100 * as_printed:.0f} %)"
        rows.append(Row(case.name, dict(cells)))
    metis = shares.pop(plan.printed[0].name, [0.0] * len(plan.families))
    learned = [min(case) for case in zip(*shares.values(), strict=True)]
    verdict = _against_gradients(plan.families, learned, metis)
    text = "With one smoothing step learning-based strategies still beat CG, METIS does not (ℓ = 3, p = 1)"
    note = (
        "share of meshes with fewer iterations than plain CG, both to 1e-8; in parentheses multigrid to 1e-8 "
        "against CG to 1e-6, what the paper prints. What does not converge has lost. A V-cycle with m = 1 "
        "costs several iterations of CG"
    )
    return _claim(text, verdict, rows, [note])


def _against_gradients(families: Sequence[str], learned: Sequence[float], metis: Sequence[float]) -> str:
    """Return the verdict on the claim that multigrid with one smoothing step beats CG.

    It depends on the fraction of meshes per family on which learned methods and METIS do.
    """
    won = [family for family, share in zip(families, learned, strict=True) if share > 0.5]
    also = [family for family, share in zip(families, metis, strict=True) if share > 0.5]
    word = "Confirmed" if len(won) == len(families) and not also else "In part"
    word = "Refuted" if set(won) <= set(also) else word
    lost = [family for family in families if family not in won]
    missed = f", not of {' and '.join(lost)}" if lost else ""
    theirs = ", ".join(won) or "no family"
    return (
        f"{word}: learning-based strategies beat CG on most meshes of {theirs}{missed}; "
        f"METIS does so on most of {', '.join(also) or 'no family'}."
    )


def _fraction_below_cg(
    plan: Plan, results: Results, strategy: Strategy, family: str, tolerance: str
) -> float:
    """Return the fraction of a family's meshes where multigrid with m = 1 needs fewer iterations than CG."""
    multigrid_counts = fresh_values(plan, results, strategy, family, "m1")
    cg_counts = fresh_values(plan, results, Strategy("CG", ""), family, tolerance)
    valid = ~np.isnan(multigrid_counts + cg_counts)
    return float((multigrid_counts < cg_counts)[valid].mean()) if valid.any() else 0.0


def _speed_claim(plan: Plan, results: Results) -> Claim:
    at = max(n for n in plan.cells if n <= 5000)
    lines = curves(plan, results, "bisection")
    ms = {name: cell.ours for name, line in lines.items() for n, cell in line if n == at}
    times = {name: taken for name, taken in ms.items() if taken and not name.endswith("whole")}
    rows = [
        Row(name, {"CPU ms": f"{times[name]:.3g}"}) for name in sorted(times, key=lambda name: times[name])
    ]
    text = f"The network is the fastest online (one bisection of {at:,} cells; [all sizes](runtime.md))"
    return _claim(text, " ".join(_speed_verdict(times)), rows)


def _speed_verdict(times: Mapping[str, float]) -> Iterator[str]:
    """Yield sentences that compare all methods' CPU times for one bisection."""
    network, gnn = times.get("GNN, forward"), times.get("gnn")
    raw, wrapped = times.get("METIS, raw"), times.get("METIS through networkx")
    faster = [name for name in times if network is not None and times[name] < network]
    if network is None:
        yield "The paper's network cannot be used here."
    elif faster:
        yield f"Refuted for the paper's network: {len(faster)} of {len(times)} are faster."
    else:
        yield "Confirmed."
    if raw and wrapped:
        yield f"METIS through networkx, its rival there, takes {wrapped / raw:.1f} times METIS itself."
    if raw and gnn:
        place = sorted(times.values()).index(gnn) + 1
        yield f"gnn, ours, is {raw / gnn:.1f} times faster than METIS itself, number {place} of {len(times)}."
