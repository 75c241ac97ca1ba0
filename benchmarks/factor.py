"""Numeric factorization of the normal equations: the core's against CHOLMOD's.

Run `python -m benchmarks.factor [GRAPH ...]`; needs the extra `bench`, and the data (MASAT_DATA).
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from functools import partial

import numpy as np

import masat
from benchmarks.cholmod import Cholmod, block_order
from benchmarks.data import medians
from benchmarks.graphs import CASES, CITY, graph_of
from benchmarks.system import assemble
from benchmarks.threads import single_threaded
from masat.optimizers.equations import normal_equations

WANTED, WANTED_OF_TWO = 1.0, 0.65


@dataclass(frozen=True)
class Row:
    """Medians in ms, and how exact the solutions are."""

    unknowns: int
    times: dict[str, float]
    residual: tuple[float, float]
    backward: tuple[float, float]

    @property
    def cholmod(self) -> float:
        """CHOLMOD's time in its better ordering."""
        return min(self.times["own"], self.times["block"])

    @property
    def ratio(self) -> float:
        """Time over CHOLMOD's, one thread each."""
        return self.times["one"] / self.cholmod

    @property
    def ratio_of_two(self) -> float:
        """The same of two threads, CHOLMOD's still one."""
        return self.times["two"] / self.cholmod


def analyze(graph: masat.PoseGraph) -> None:
    """Order the nodes anew, and lay out the factor."""
    graph.__dict__.pop("elimination", None)
    normal_equations(graph)


def measure(graph: masat.PoseGraph, rounds: int = 3) -> Row:
    """Time each step of both, and check that they have the same system."""
    assert graph.poses is not None
    one, two = (normal_equations(graph, threads) for threads in (1, 2))
    for equations in (one, two):
        equations.linearize(graph.poses)
    b, undamped = one.rhs(), np.zeros_like(one.rhs())
    system = assemble(graph, graph.elimination.free_nodes().astype(np.int64))
    assert np.allclose(one.diagonal(), system.diagonal(), rtol=1e-9)
    own, block = Cholmod(system), Cholmod(system, block_order(system, graph.dof))
    times = medians(
        {
            "one": partial(one.factorize, undamped),
            "two": partial(two.factorize, undamped),
            "own": own.factorize,
            "block": block.factorize,
        },
        rounds,
    )
    better = own if times["own"] < times["block"] else block
    times |= medians(
        {
            "analyze": partial(analyze, graph),
            "cholmod analyze": better.analyze,
            "solve": one.solve,
            "cholmod solve": partial(better.solve, b),
        },
        1,
    )
    solutions = one.solve(), better.solve(b)
    residual, other_residual = (system.residual(x, b) for x in solutions)
    backward, other_backward = (system.backward_error(x, b) for x in solutions)
    return Row(len(b), times, (residual, other_residual), (backward, other_backward))


def main() -> None:
    """Print a table of medians, ratios and errors."""
    single_threaded()
    print("numeric factorization, medians in ms; ratio to the better CHOLMOD on one thread, wanted")
    print(f"at most {WANTED}, and with two threads {WANTED_OF_TWO} in 3D and on {CITY}")
    print(
        f"{'graph':<16}{'unknowns':>9}{'masat':>8}{'2 thr.':>8}{'CHOLMOD':>9}{'block':>7}"
        f"{'ratio':>7}{'2 thr.':>7}  {'analyze':>13}{'solve':>12}{'residual':>17}"
        f"{'backward error':>18}"
    )
    for name in sys.argv[1:] or [*CASES, CITY]:
        row = measure(graph_of(name))
        t = row.times
        print(
            f"{name:<16}{row.unknowns:>9}{t['one']:>8.2f}{t['two']:>8.2f}{t['own']:>9.2f}"
            f"{t['block']:>7.1f}{row.ratio:>7.2f}{row.ratio_of_two:>7.2f}  "
            f"{t['analyze']:>6.1f}/{t['cholmod analyze']:<6.1f}"
            f"{t['solve']:>6.2f}/{t['cholmod solve']:<5.2f}"
            f"{row.residual[0]:>9.0e}/{row.residual[1]:<7.0e}"
            f"{row.backward[0]:>9.0e}/{row.backward[1]:<7.0e}",
            flush=True,
        )
    print("(a/b: masat's and that of CHOLMOD in its better ordering)")


if __name__ == "__main__":
    main()
