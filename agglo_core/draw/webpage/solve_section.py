"""Report section on solvers: costs per level and phase, and convergence.

The section is plain HTML and SVG without script. All texts are escaped.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any, Final

from agglo_core.draw.webpage.solve_curves import history_picture

_PHASES: Final = {"hierarchy": "hierarchy", "assemble": "assembly", "setup": "set-up", "solve": "solve"}
_CLOCKS: Final = {"cpu_seconds": "processor", "seconds": "clock"}
_MISSING: Final = "–"


def solve_section(solves: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the report section on solutions by name of solver or run, or an empty text for none.

    Parameters
    ----------
    solves : mapping of str to mapping
        Data from :func:`agglo_core.solvers.solution_report.report`, or ``{"error": why}``.
    """
    if not solves:
        return ""
    reports = {name: data for name, data in solves.items() if "error" not in data}
    failures = [_failure(name, data["error"]) for name, data in solves.items() if "error" in data]
    several = len(solves) > 1
    parts = [_summary(reports)] if several and reports else []
    parts += [*failures, history_picture(reports) if reports else ""]
    parts += [_details(name, data) if several else _story(data) for name, data in reports.items()]
    body = "\n".join(filter(None, parts))
    title = '<h2 id="solve-title">Solve</h2>'
    return f'<section class="solve" aria-labelledby="solve-title">\n{title}\n{body}\n</section>\n'


def _failure(name: str, why: str) -> str:
    return f'<p class="failed">{escape(f"{name}: {why}")}</p>'


def _summary(solves: Mapping[str, Mapping[str, Any]]) -> str:
    """Return an HTML table with iterations, convergence and costs of each run."""
    columns = ["run", "unknowns", "iterations", "converged", "contraction", "operator complexity", "MB"]
    columns += [f"{title} s" for title in _PHASES.values()]
    rows = []
    for name, data in solves.items():
        spent = data["cpu_seconds"] or data["seconds"]
        rows.append(
            [
                name,
                _whole_number(data["dofs"]),
                _whole_number(data["iterations"]),
                "yes" if data["converged"] else "no",
                _three_digits(data["contraction"]),
                _two_decimals(data["operator_complexity"]),
                _megabytes(data["memory"]),
                *(_two_decimals(spent.get(key)) for key in _PHASES),
            ]
        )
    hint = "CPU seconds, or elapsed seconds where the solver does not report CPU time."
    return f'<p class="hint">{hint}</p>\n{_table(columns, rows)}'


def _details(name: str, data: Mapping[str, Any]) -> str:
    return f"<details><summary>{escape(name)}</summary>\n{_story(data)}\n</details>"


def _story(data: Mapping[str, Any]) -> str:
    """Return outcome, reason and costs of one solution as HTML."""
    parts = [f"<p>{escape(_state(data))}</p>"]
    parts += [
        f"<p><b>{title}</b> {escape(data[key])}</p>"
        for key, title in (("choice", "Recipe:"), ("advice", "Advice:"))
        if data[key]
    ]
    parts += [_facts(data), "<h3>Levels</h3>", _levels(data["levels"]), "<h3>Seconds</h3>", _seconds(data)]
    return "\n".join(parts)


def _state(data: Mapping[str, Any]) -> str:
    if not data["converged"]:
        return f"Not converged: {data['reason']}; the solution is from iteration {data['iterations']}."
    by = f" by {' and '.join(data['tests_met'])}" if data["tests_met"] else ""
    return f"Converged after {data['iterations']} iterations: {data['reason']}{by}."


def _facts(data: Mapping[str, Any]) -> str:
    errors = {
        f"error {name.removeprefix('error_').upper()}": each
        for name, each in data.items()
        if name.startswith("error_")
    }
    facts = {
        "relative residual": _scientific_notation(data["relative_residual"]),
        "energy error, estimated": _scientific_notation(data["energy_error"]),
        "tolerance": _scientific_notation(data["tolerance"]),
        "contraction, mean": _three_digits(data["contraction"]),
        "contraction, second half": _three_digits(data["asymptotic_contraction"]),
        "operator complexity": _two_decimals(data["operator_complexity"]),
        "grid complexity": _two_decimals(data["grid_complexity"]),
        "memory of the levels": "" if data["memory"] is None else f"{_megabytes(data['memory'])} MB",
        "plain conjugate gradients": ""
        if data["cg_iterations"] is None
        else f"{data['cg_iterations']:,} iterations",
        "energy fᵀu": f"{data['energy']:.8g}",
        "integral of u": "" if data.get("integral") is None else f"{data['integral']:.8g}",
        **{name: "" if value is None else _scientific_notation(value) for name, value in errors.items()},
    }
    pairs = (
        f"<div><dt>{escape(name)}</dt><dd>{escape(value)}</dd></div>"
        for name, value in facts.items()
        if value not in ("", _MISSING)
    )
    return f'<dl class="facts">{"".join(pairs)}</dl>'


def _levels(levels: Sequence[Mapping[str, Any]]) -> str:
    rows = [
        [
            "mesh" if not place else str(place),
            _whole_number(level["dofs"]),
            _whole_number(level["nonzeros"]),
            _whole_number(level["cells"]),
        ]
        for place, level in enumerate(levels)
    ]
    return _table(["level", "unknowns", "nonzeros", "parts"], rows)


def _seconds(data: Mapping[str, Any]) -> str:
    """Return an HTML table of the time in each phase: processor time and elapsed time."""
    clocks = {title: data[key] for key, title in _CLOCKS.items() if data[key]}
    if not clocks:
        return '<p class="hint">Not reported by the solver.</p>'
    measured = dict.fromkeys(phase for clock in clocks.values() for phase in clock)
    phases = [
        *(each for each in _PHASES if each in measured),
        *(each for each in measured if each not in _PHASES),
    ]
    rows = [
        [_PHASES.get(each, each), *(_two_decimals(clock.get(each)) for clock in clocks.values())]
        for each in phases
    ]
    rows.append(["together", *(_two_decimals(sum(clock.values())) for clock in clocks.values())])
    return _table(["phase", *clocks], rows)


def _table(columns: Iterable[str], rows: Iterable[Sequence[str]]) -> str:
    head = "".join(f'<th scope="col">{escape(each)}</th>' for each in columns)
    body = "".join(
        f'<tr><th scope="row">{escape(first)}</th>{"".join(f"<td>{escape(each)}</td>" for each in rest)}</tr>'
        for first, *rest in rows
    )
    return f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'


def _whole_number(value: int | None) -> str:
    return _MISSING if value is None else f"{value:,}"


def _three_digits(value: float | None) -> str:
    return _MISSING if value is None else f"{value:.3g}"


def _two_decimals(value: float | None) -> str:
    return _MISSING if value is None else f"{value:.2f}"


def _scientific_notation(value: float | None) -> str:
    return _MISSING if value is None else f"{value:.2e}"


def _megabytes(value: int | None) -> str:
    return _MISSING if value is None else f"{value / 1e6:.1f}"
