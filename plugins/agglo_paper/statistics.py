"""Comparison of methods over many newly generated meshes: means, paired differences, sign tests."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np

from agglo_core.authoring import Float
from agglo_paper.tables.record import Page, Row, Table
from agglo_paper.work.measures import FRESH, fresh, plain
from agglo_paper.work.plan import Plan
from agglo_paper.work.store import Data, Results, Unit
from agglo_paper.work.strategies import Strategy

MEASURES: Final[Mapping[str, tuple[str, int]]] = {
    "K": ("agglomerates", 1),
    "UF": ("UF", 3),
    "CR": ("CR", 3),
    "CRc": ("CRc", 3),
    "mg": ("iterations, ℓ = 3, m = 3", 1),
    "m1": ("iterations, ℓ = 3, m = 1, to 1e-8", 1),
}
"""Measured quantities on every fresh mesh: title, digits."""

_INTRO = (
    "{n} fresh meshes a family, made from seeds used for nothing else: triangles and squares of the paper "
    "with each inner point moved by up to a tenth of the spacing, Delaunay triangles of 128 random points, "
    "Voronoi cells of 256. Sizes are those of the paper's grids (a fifth more where points were moved). Mean "
    "± standard deviation; paired differences are taken mesh by mesh, then meshes on which the method is "
    "better : worse (ties apart), p of the two-sided sign test, outcome at the level 0.01. Comparisons are "
    "with METIS as the paper runs it (by count) and held to the same diameters (`metis` in our pipeline). "
    "Multigrid that does not converge loses, and is left out of means."
)


def fresh_unit(family: str, number: int, strategy: Strategy, solver: str) -> Unit:
    """Return the computation of a method's shapes and iterations on one newly generated mesh."""
    source = f"fresh:{family}:{number}"
    settings = {"source": source, "strategy": strategy.data(), "solve": bool(solver)}
    return Unit(fresh, settings, (strategy.package, solver))


def plain_fresh(family: str, number: int, solver: str) -> Unit:
    """Return the computation of CG iteration counts to 1e-6 and 1e-8 on one newly generated mesh."""
    settings = {"source": f"fresh:{family}:{number}", "degree": 1, "tolerances": [1e-6, 1e-8]}
    return Unit(plain, settings, (solver,))


def units(plan: Plan) -> Iterator[Unit]:
    """Yield all computations on newly generated meshes."""
    for family in plan.families:
        for number in range(plan.fresh):
            if plan.solver:
                yield plain_fresh(family, number, plan.solver)
            yield from (fresh_unit(family, number, each, plan.solver) for each in plan.usable)


def fresh_values(plan: Plan, results: Results, strategy: Strategy, family: str, name: str) -> Float:
    """Return one measured quantity on each newly generated mesh of a family ``(plan.fresh,)``.

    NaN means no value, ∞ no convergence. ``name`` is a key of :data:`MEASURES`, ``spread`` (of the counts
    over ℓ), or, for the strategy CG, ``1e-6`` or ``1e-8``.
    """
    numbers = []
    for number in range(plan.fresh):
        if strategy.name == "CG":
            data = results[plain_fresh(family, number, plan.solver).key]
            values = data.get("iterations", [None, None])
            numbers.append(values[("1e-6", "1e-8").index(name)])
        else:
            numbers.append(_value(results[fresh_unit(family, number, strategy, plan.solver).key], name))
    return np.array([np.nan if x is None else float(x) for x in numbers])


def _value(data: Data, name: str) -> float | None:
    levels: Sequence[float | None] = data.get("levels", [None] * len(FRESH))
    if name == "spread":
        known = [each for each in levels[:3] if each is not None]
        return max(known) - min(known) if len(known) == 3 else None
    if name in ("mg", "m1"):
        number = levels[1 if name == "mg" else 3]
        return np.inf if number is None and "levels" in data else number
    value: float | None = data.get(name)
    return value


class Paired:
    """Paired comparison of two samples ``(n,)``: mean difference, wins, losses, sign test.

    Parameters
    ----------
    first, second : (n,) float
        Meshes with NaN in either sample are left out; ∞ loses, and does not enter the mean.
    more : bool
        Whether larger values are better.
    """

    def __init__(self, first: Float, second: Float, more: bool) -> None:
        from scipy.stats import binomtest

        with np.errstate(invalid="ignore"):  # tie if neither converged
            difference = np.where(first == second, 0.0, first - second)
        difference = difference[~np.isnan(difference)]
        gains = difference if more else -difference
        self.n = len(gains)
        finite = difference[np.isfinite(difference)]
        self.mean = float(finite.mean()) if len(finite) else float("nan")
        self.std = float(finite.std(ddof=1)) if len(finite) > 1 else float("nan")
        self.wins, self.losses = int((gains > 1e-9).sum()), int((gains < -1e-9).sum())
        decided = self.wins + self.losses
        self.p = float(binomtest(self.wins, decided).pvalue) if decided else 1.0

    @property
    def outcome(self) -> str:
        """Sign test result at the level 0.01: ``better``, ``worse`` or ``no difference``."""
        if self.p >= 0.01:
            return "no difference"
        return "better" if self.wins > self.losses else "worse"

    def text(self, digits: int) -> str:
        """Return the comparison as text like ``+0.012 ± 0.030, 40:10, p = 2e-05, better``."""
        if not self.n:
            return "–"
        deviation = "–" if np.isnan(self.std) else f"{self.std:.{digits}f}"
        sizes = f"{self.mean:+.{digits}f} ± {deviation}"
        return f"{sizes}; {self.wins}:{self.losses}; p = {self.p:.1g}; {self.outcome}"


def compare_pairs(
    plan: Plan, results: Results, first: Strategy, second: Strategy, family: str, name: str
) -> Paired:
    """Compare a measured quantity of two methods on the newly generated meshes of a family."""
    ours, theirs = (fresh_values(plan, results, each, family, name) for each in (first, second))
    return Paired(ours, theirs, more=name in ("UF", "CR", "CRc"))


def page(plan: Plan, results: Results) -> Page:
    """Return the result page ``statistics``."""
    tables = [_means(plan, results, name) for name in MEASURES]
    by_count = plan.printed[0]
    for rival in (None if by_count.problem else by_count, same_sizes(plan)):
        if rival is not None:
            tables += [_differences(plan, results, rival, name) for name in ("CR", "CRc", "UF", "mg", "m1")]
    return Page("statistics", f"Over {plan.fresh} fresh meshes a family", _INTRO.format(n=plan.fresh), tables)


def same_sizes(plan: Plan) -> Strategy | None:
    """Return METIS by recursive bisection to a largest diameter, as used in agglo, or None if unavailable."""
    mine = [s for s in plan.usable if s.bisector == "metis" and not s.by_count and s.method == "recursive"]
    return mine[0] if mine else None


def _means(plan: Plan, results: Results, name: str) -> Table:
    title, digits = MEASURES[name]
    rows = []
    for strategy in plan.usable:
        cells: dict[str, Any] = {}
        for family in plan.families:
            values = fresh_values(plan, results, strategy, family, name)
            finite = values[np.isfinite(values)]
            failure_text = f" ({np.isinf(values).sum()} not converged)" if np.isinf(values).any() else ""
            spread = f" ± {finite.std(ddof=1):.{digits}f}" if len(finite) > 1 else ""
            cells[family] = (
                f"{finite.mean():.{digits}f}{spread}{failure_text}" if len(finite) else f"–{failure_text}"
            )
        rows.append(Row(strategy.name, cells))
    return Table(f"statistics-{name}", f"Mean {title}", rows, digits, "method")


def _differences(plan: Plan, results: Results, rival: Strategy, name: str) -> Table:
    title, digits = MEASURES[name]
    rows = []
    for strategy in plan.usable:
        if strategy.name != rival.name:
            compared = {
                f: compare_pairs(plan, results, strategy, rival, f, name).text(digits) for f in plan.families
            }
            rows.append(Row(strategy.name, compared))
    key = f"statistics-{name}-{'by-count' if rival.by_count else 'same-sizes'}"
    rival_text = "METIS as the paper runs it" if rival.by_count else "METIS to the same diameters"
    return Table(key, f"{title}: paired difference to {rival_text}", rows, digits, "method")
