"""Which loop closures the losses accept, against the truth.

Run `python -m benchmarks.losses`. Manhattan worlds of 400 nodes with as many false loop closures as
true ones, from odometry, which is trusted. A closure is accepted if its weight is over a quarter.
"""

from __future__ import annotations

import warnings

import numpy as np

import masat
from masat.chain import odometry_edges
from masat.optimizers import LOSSES
from masat.worlds import add_false_closures, manhattan, normalized, perturb

_SEEDS, _NODES, _SIGMA = 3, 400, (0.05, 0.05, 0.02)
_ACCEPTED = 0.25


def measure(loss: str, kind: str) -> str:
    """Return a row of the table."""
    false_accepted = true_accepted = false = true = 0
    iterations: list[int] = []
    for seed in range(_SEEDS):
        world = perturb(manhattan(_NODES, seed=seed), _SIGMA, seed=seed)
        clean = normalized(masat.solve(world).graph)
        graph, is_false = add_false_closures(clean, kind, 0.5, seed=seed)
        odometry = odometry_edges(graph)
        start = masat.initialize(graph, "odometry")
        result = masat.optimize(start, loss=loss, trusted=odometry)
        assert result.weights is not None
        accepted = result.weights > _ACCEPTED
        false_accepted += int(np.count_nonzero(accepted & is_false))
        true_accepted += int(np.count_nonzero(accepted & ~is_false & ~odometry))
        false += int(np.count_nonzero(is_false))
        true += int(np.count_nonzero(~is_false & ~odometry))
        iterations.append(len(result.history))
    return (
        f"{kind:<8}{loss:<16}{false_accepted:>8} of {false:<6}{100 * true_accepted / true:>8.1f} %"
        f"{min(iterations):>10} to {max(iterations)}"
    )


def main() -> None:
    """Print the table."""
    warnings.simplefilter("ignore", masat.MasatWarning)
    print(f"{'':<24}{'false accepted':>18}{'true':>9}{'iterations':>18}")
    for kind in ("random", "alias"):
        for loss in sorted(LOSSES):
            print(measure(loss, kind), flush=True)


if __name__ == "__main__":
    main()
