"""Compare errors and cost of the sharp penalty with C = 10, C = 2 and the best approximation.

    python tests/benchmarks/penalty.py [--degrees P ...] [--repeats N]

u = sin πx sin πy on the unit square, direct solutions. ``L2`` and ``H1`` are errors relative to the L2
projection of u; ``DG`` is the error in the DG norm relative to C = 10, each with its own penalty; ``sigma``
is Σ |F| σ_F relative to C = 10; ``time`` is the time of ``discretise`` relative to C = 10: one thread, CPU
seconds after a warm-up, best repeat.
"""

from __future__ import annotations

import os

for _variable in ("OMP", "OPENBLAS", "MKL", "NUMBA", "BLIS"):
    os.environ[f"{_variable}_NUM_THREADS"] = "1"  # before numpy is imported

# ruff: noqa: E402
import argparse
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.sparse.linalg import spsolve

import agglo_core as agglo
from agglo_core import Mesh, samples
from agglo_core.problems import Diffusion
from agglo_polydg_mg.forms.assembly import discretise, jump_penalty
from agglo_polydg_mg.forms.norms import Errors, errors
from agglo_polydg_mg.space.basis import Basis

SINE = Diffusion(
    source=lambda x: 2 * np.pi**2 * np.sin(np.pi * x[:, 0]) * np.sin(np.pi * x[:, 1]),
    exact=lambda x: np.sin(np.pi * x[:, 0]) * np.sin(np.pi * x[:, 1]),
)
PENALTIES: dict[str, Any] = {"C = 10": "paper", "C = 2": 2.0, "sharp": "sharp"}


def agglomerated(mesh: Mesh, parts: int) -> Mesh:
    """Return the coarse mesh of a partition."""
    return mesh.coarsen(agglo.agglomerate(mesh.graph, n_parts=parts).levels[0])


MESHES: dict[str, Callable[[], Mesh]] = {
    "agglomerated Voronoi": lambda: agglomerated(samples.voronoi(1000, seed=3), 64),
    "agglomerated triangles": lambda: agglomerated(samples.random_triangles(1000, seed=3), 64),
    "Voronoi": lambda: samples.voronoi(400, seed=1),
    "squares": lambda: samples.squares(20),
    "random triangles": lambda: samples.random_triangles(400, seed=1),
}


def cpu(call: Callable[[], Any], repeats: int) -> float:
    """Return the minimum CPU seconds for a call."""
    found = []
    for _ in range(repeats):
        start = time.process_time()
        call()
        found.append(time.process_time() - start)
    return min(found)


def row(mesh: Mesh, degree: int, penalty: Any, repeats: int) -> tuple[Errors, float, float]:
    """Return the errors of the solution, Σ |F| σ_F, and CPU seconds of the assembly."""
    basis, none = Basis(mesh, degree), np.empty(0, np.int64)
    system = discretise(mesh, degree, SINE, penalty=penalty)
    found = errors(basis, spsolve(system.A.tocsc(), system.b), SINE, penalty=penalty)
    sigma = jump_penalty(basis, np.ones(mesh.n_cells), penalty, none)
    plain = Diffusion(source=8.0)
    seconds = cpu(lambda: discretise(mesh, degree, plain, penalty=penalty), repeats)
    return found, float(sigma @ mesh.face_measures), seconds


def main() -> None:
    """Read the arguments and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--degrees", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    print(f"{'mesh':<24}{'p':>2} {'penalty':<8}{'L2':>7}{'H1':>7}{'DG':>7}{'sigma':>8}{'time':>7}")
    for name, build in MESHES.items():
        mesh = build()
        for degree in options.degrees:
            basis = Basis(mesh, degree)
            best = errors(basis, basis.project(SINE.exact), SINE)
            rows = {name: row(mesh, degree, each, options.repeats) for name, each in PENALTIES.items()}
            paper = rows["C = 10"]
            for label, (found, sigma, seconds) in rows.items():
                print(
                    f"{name:<24}{degree:>2} {label:<8}{found.l2 / best.l2:>7.2f}{found.h1 / best.h1:>7.2f}"
                    f"{found.dg / paper[0].dg:>7.2f}{sigma / paper[1]:>8.3f}{seconds / paper[2]:>7.2f}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
