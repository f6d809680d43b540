"""Train the network by policy iteration: its targets are the part counts of its own recursions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import torch
from torch.nn import LeakyReLU as Leaky, Linear

import agglo_core as agglo
from agglo_core import Mesh, samples
from agglo_core.authoring import Float
from value_of_cuts.cuts import Cells, Network, Policy, cells_of, recursion
from value_of_cuts.features import setup_for


class Effort(NamedTuple):
    """Amount of data and of optimisation."""

    meshes: int
    validation: int  # meshes, for the choice of the round
    recursions: int  # of each mesh, for each round
    noise: Sequence[float]  # on costs, for each round after the first
    steps: int  # of the optimiser, for each round


NOISE: Final = (0.1, 0.08, 0.06, 0.05, 0.04, 0.03, 0.03, 0.02)
EFFORTS: Final = {2: Effort(40, 16, 4, NOISE, 1500), 3: Effort(60, 20, 8, NOISE, 2500)}
FILL: Final = {2: 2.7, 3: 12.0}  # usual value of parts · h*^dim / measure
MOST: Final = 150  # parts of the pieces in the data


def random_mesh(dim: int, random: np.random.Generator, seed: int) -> Mesh:
    """Return Voronoi cells or simplices, in 3-D also boxes or agglomerates."""
    kind, n = random.integers(2 if dim == 2 else 5), int(np.exp(random.uniform(np.log(300), np.log(2500))))
    if kind == 0:
        return samples.voronoi(n, seed) if dim == 2 else samples.voronoi3d(n, seed)
    if dim == 2:
        return samples.random_triangles(n // 2, seed)
    if kind == 1:
        return samples.boxes(round(n ** (1 / 3)))
    if kind == 2:
        return agglo.agglomerate(samples.random_tetrahedra(n // 2, seed), cells_per_part=6).mesh(0)
    return samples.random_tetrahedra(n // 5, seed)


def random_domain(dim: int, random: np.random.Generator, seed: int) -> Cells:
    """Return the cells of a random mesh, half of the time those near a corner, half of the time stretched."""
    centroids, measures, offsets, vertices, points = cells_of(random_mesh(dim, random, seed).graph)
    if random.random() < 0.5:
        # Keep those within a wavy outline around a corner. Graphs have their centre at 0.
        away, outline = centroids - 0.5, np.full(len(centroids), 0.38)
        radius = np.linalg.norm(away, axis=1)
        for waves in (2, 3, 5):
            angle = away @ random.normal(size=dim) / radius
            outline += 0.05 * np.cos(waves * angle + random.uniform(0, 2 * np.pi))
        inside = np.flatnonzero(radius < outline)
        vertices = np.concatenate([vertices[offsets[c] : offsets[c + 1]] for c in inside])
        offsets = np.append(0, np.cumsum(np.diff(offsets)[inside]))
        centroids, measures = centroids[inside], measures[inside]
    stretch = np.exp(random.uniform(-0.4, 0.4, dim)) if random.random() < 0.5 else np.ones(dim)
    return Cells(centroids * stretch, measures * stretch.prod(), offsets, vertices, points * stretch)


def random_size(cells: Cells, random: np.random.Generator) -> float:
    """Return a size h* for about 3 to 300 parts of at least 8 cells."""
    dim, n = cells.points.shape[1], len(cells.measures)
    parts = min(np.exp(random.uniform(np.log(3), np.log(300))), n / 8)
    return float((FILL[dim] * cells.measures.sum() / parts) ** (1 / dim))


def blank(dim: int) -> Network:
    """Return a network of zeros, for policies without one."""
    shapes = (len(setup_for(dim).axes) + 2 + dim, 16), 16, (16, 16), 16, 16, 1
    return Network(*(np.zeros(shape, np.float32) for shape in shapes))


def density(domains: list[Cells], sizes: list[float], learned: bool, network: Network) -> float:
    """Return the mean of parts · h*^dim / measure of recursions without noise."""
    found = []
    for cells, h_star in zip(domains, sizes, strict=True):
        dim, policy = cells.points.shape[1], Policy(h_star, learned, 0.0)
        parts = recursion(cells, setup_for(dim), np.eye(dim), policy, network, 0)[2]
        found.append(parts[0] * h_star**dim / cells.measures.sum())
    return float(np.mean(found))


def collect(
    domains: list[Cells], repeats: int, policy: Policy, network: Network, random: np.random.Generator
) -> tuple[Float, Float]:
    """Return inputs and logs of part counts of the pieces of recursions, with random sizes and frames."""
    dim = domains[0].points.shape[1]
    setup, inputs, counts = setup_for(dim), [], []
    for cells in domains * repeats:
        frame = np.ascontiguousarray(np.linalg.qr(random.normal(size=(dim, dim)))[0])
        own = policy._replace(h_star=random_size(cells, random))
        found, widths, parts = recursion(cells, setup, frame, own, network, int(random.integers(1 << 30)))
        used = (widths > setup.certain - 0.05) & (parts <= MOST)
        inputs.append(found[used, : len(network.w1)])
        counts.append(np.log(parts[used]))
    return np.concatenate(inputs), np.concatenate(counts).astype(np.float32)


def fit(model: Any, inputs: Float, targets: Float, steps: int, seed: int) -> Network:
    """Minimise squared errors of the log and of the count with Adam, and return the weights."""
    x, y = torch.tensor(inputs), torch.tensor(targets)
    optimiser = torch.optim.Adam(model.parameters(), 4e-3)
    rate = torch.optim.lr_scheduler.OneCycleLR(optimiser, 4e-3, steps)
    generator = torch.Generator().manual_seed(seed)
    for _ in range(steps):
        batch = torch.randint(len(x), (512,), generator=generator)
        gap = model(x[batch])[:, 0] - y[batch]
        loss = (gap**2).mean() + 0.3 * ((torch.exp(gap) - 1).clamp(max=3) ** 2).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        rate.step()
    w1, b1, w2, b2, w3, b3 = (value.detach().numpy().copy() for value in model.parameters())
    return Network(w1.T.copy(), b1, w2.T.copy(), b2, w3[0], b3)


def train(dim: int, seed: int, report: Callable[[str], object], effort: Effort | None = None) -> Network:
    """Return the network of the round with the fewest parts on the meshes for validation."""
    effort, network = effort or EFFORTS[dim], blank(dim)
    torch.set_num_threads(1)
    torch.manual_seed(seed)
    layers = Linear(len(network.w1), 16), Leaky(0.05), Linear(16, 16), Leaky(0.05), Linear(16, 1)
    model = torch.nn.Sequential(*layers)
    # Step 1: meshes. Those for validation do not depend on the seed.
    random = np.random.default_rng(999)
    tests = [random_domain(dim, random, 30_000 + k) for k in range(effort.validation)]
    sizes = [random_size(cells, random) for cells in tests]
    random = np.random.default_rng(seed)
    domains = [random_domain(dim, random, 20_000 + 1000 * seed + k) for k in range(effort.meshes)]
    report(f"most inertia between: {density(tests, sizes, False, network):.3f} parts · h^{dim} / measure")
    # Step 2: data from cuts with the most inertia between the sides.
    rounds = [collect(domains, effort.recursions, Policy(1.0, False, 0.05), network, random)]
    least, best = np.inf, network
    for k in range(1 + len(effort.noise)):
        # Step 3: fit to the data of the last two rounds.
        inputs, targets = (np.concatenate(each) for each in zip(*rounds[-2:], strict=True))
        network = fit(model, inputs, targets, effort.steps, seed + k)
        found = density(tests, sizes, True, network)
        report(f"round {k}: {found:.3f} ({len(inputs)} pieces)")
        if found < least:
            least, best = found, network
        # Step 4: data from the recursions of the network, with noise.
        if k < len(effort.noise):
            policy = Policy(1.0, True, effort.noise[k])
            rounds.append(collect(domains, effort.recursions, policy, network, random))
    return best
