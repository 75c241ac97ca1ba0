"""Whether certificates hold: small graphs with strong noise, against random restarts.

Run `python -m benchmarks.certificates [GRAPHS]`; needs no data. For each kind of information it
solves that many random graphs of 4 to 30 nodes, certifies the result and, where that is refused,
the local minimum of a poor guess, and compares with the lowest of 50 optimizations from random
poses. A false certificate is one above that minimum, a false bound one that lies above it.
"""

from __future__ import annotations

import sys
import warnings

import numpy as np

import masat
from masat import PoseGraph, lie
from masat.arrays import Floats

RESTARTS = 50
SAME, ZERO = 1e-6, 1e-20  # relative, and what is zero to rounding
KINDS = ("isotropic", "uncoupled", "coupled")


def random_graph(dimension: int, kind: str, seed: int) -> PoseGraph:
    """Return a random connected graph, whose noise goes from little to nearly uniform."""
    rng = np.random.default_rng([seed, dimension, KINDS.index(kind)])
    n = int(rng.integers(4, 31))
    chain = [(k, k + 1) for k in range(n - 1)]
    closures = rng.integers(0, n, (int(rng.integers(1, 2 * n)), 2))
    edges = np.array([*chain, *closures[closures[:, 0] != closures[:, 1]].tolist()])
    dof = lie.DOF[dimension]
    truth = lie.retract(np.tile(lie.identity(dimension), (n, 1)), _steps(rng, n, dimension, 3.0))
    exact = lie.between(truth[edges[:, 0]], truth[edges[:, 1]])
    sigma = float(rng.choice([0.1, 0.3, 0.6, 1.0]))
    measured = lie.retract(exact, _steps(rng, len(edges), dimension, sigma))
    half = rng.normal(size=(len(edges), dof, dof)) * 0.4 + np.eye(dof)
    w = half @ half.transpose(0, 2, 1)
    if kind != "coupled":
        w[:, :dimension, dimension:] = w[:, dimension:, :dimension] = 0
    if kind == "isotropic":
        scale = rng.uniform(0.5, 2, (len(edges), 2))
        diagonal = np.repeat(scale, (dimension, dof - dimension), axis=1)
        w = diagonal[:, :, None] * np.eye(dof)
    return PoseGraph.from_arrays(edges, measured, w / sigma**2)


def _steps(rng: np.random.Generator, count: int, dimension: int, scale: float) -> Floats:
    steps = rng.normal(size=(count, lie.DOF[dimension])) * scale
    if dimension == 3:
        steps[:, 3:] = np.clip(steps[:, 3:] / 2, -0.57, 0.57)
    return steps


def lowest(graph: PoseGraph, seed: int) -> float:
    """Return the lowest chi2 of many optimizations from random poses."""
    rng = np.random.default_rng(seed)
    n, best = len(graph), np.inf
    for _ in range(RESTARTS):
        start = np.tile(lie.identity(graph.dimension), (n, 1))
        start[1:] = lie.retract(start[1:], _steps(rng, n - 1, graph.dimension, 3.0))
        best = min(best, masat.optimize(graph.with_poses(start), "lm").chi2)
    return float(best)


def measure(dimension: int, kind: str, count: int) -> str:
    """Return a line of the table."""
    certified = false = false_bounds = above = wrong_certified = wrong = 0
    for seed in range(count):
        graph = random_graph(dimension, kind, seed)
        solved = masat.solve(graph)
        best = min(lowest(graph, seed), solved.chi2)
        proof = masat.certify(solved.graph, search=False)
        certified += proof.certified
        above += solved.chi2 > best * (1 + SAME) + ZERO
        false += proof.certified and solved.chi2 > best * (1 + SAME) + ZERO
        false_bounds += proof.bound > best * (1 + 1e-9) + ZERO
        poor = masat.optimize(masat.initialize(graph, "odometry"))
        if poor.chi2 > best * (1 + SAME) + ZERO:
            wrong += 1
            other = masat.certify(poor.graph, search=False)
            wrong_certified += other.certified
            false_bounds += other.bound > best * (1 + 1e-9) + ZERO
    return (
        f"{dimension}D {kind:<10}{count:7}{certified:11}{above:11}{false + wrong_certified:8}"
        f"{false_bounds:14}{wrong:14}"
    )


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    warnings.simplefilter("ignore", masat.MasatWarning)
    print(
        "information   graphs  certified  not lowest   false  false bounds  worse minima\n"
        "(not lowest: solve ended above the best restart; worse minima: tried from odometry)"
    )
    for dimension in (2, 3):
        for kind in KINDS:
            print(measure(dimension, kind, count), flush=True)


if __name__ == "__main__":
    main()
