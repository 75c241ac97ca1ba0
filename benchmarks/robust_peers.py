"""The robust solve beside gtsam's graduated non-convexity (GNC) and a Geman-McClure loss.

Run `python -m benchmarks.robust_peers [TEXT ...] [--seeds N]`, the rows as in `benchmarks.robust`;
needs the extra `bench` and the public graphs (MASAT_DATA). Each method gets the same graphs and
knows that odometry is right:

- masat: `masat.solve(graph, robust=True)`;
- GNC: gtsam.GncLMOptimizer with truncated least squares from odometry, odometry known as inliers,
  and as threshold the chi2 that one honest edge in 100 exceeds;
- GMR: the Geman-McClure loss with that threshold as scale^2 from odometry, one cut at the threshold
  and least squares of what is left (`masat.study.robust_methods.geman_mcclure_refit`).
"""

from __future__ import annotations

import warnings
from statistics import median
from time import perf_counter
from typing import Any

import gtsam
import numpy as np

import masat
from benchmarks.false_closures import labeled, labeled_names
from benchmarks.robust import arguments, selected
from benchmarks.spoiled import ROWS, plainly_solved, spoiled_graphs
from benchmarks.threads import single_threaded
from benchmarks.with_gtsam import poses_of
from masat import PoseGraph
from masat.arrays import Floats
from masat.chain import odometry_edges
from masat.study.closure_trial import Spoiled, unsolved
from masat.study.robust_methods import METHODS, Answer, RobustMethod
from masat.study.scores import Scores, score

_PROBABILITY = 0.99
_PRIOR_SIGMA = 1e-4
_MAX_ITERATIONS = 100
# gtsam has the rotation first, as a rotation vector, which is twice the quaternion's part.
_ORDER = [3, 4, 5, 0, 1, 2]
_HALVED = np.array([0.5, 0.5, 0.5, 1.0, 1.0, 1.0])


def gnc(graph: PoseGraph, max_iterations: int) -> Answer:
    """Run gtsam's GNC from odometry, with its own limits of the iterations, which it recommends."""
    factors, values, trusted = _in_gtsam(graph)
    parameters = gtsam.GncLMParams(gtsam.LevenbergMarquardtParams())
    parameters.setLossType(gtsam.GncLossType.TLS)
    # The prior, which is the last factor, is as right as odometry.
    parameters.setKnownInliers([*np.flatnonzero(trusted).tolist(), len(graph.edges)])
    optimizer = gtsam.GncLMOptimizer(factors, values, parameters)
    optimizer.setInlierCostThresholdsAtProbability(_PROBABILITY)
    found = optimizer.optimize()
    weights = np.asarray(optimizer.getWeights())[: len(graph.edges)]
    return Answer(trusted | (weights > 0.5), poses_of(found, graph.dimension))


def _in_gtsam(graph: PoseGraph) -> tuple[Any, Any, Any]:
    """Return factors in the order of the edges and a prior, values at odometry, and odometry."""
    start = masat.initialize(graph, "odometry")
    assert start.poses is not None
    planar = graph.dimension == 2
    make = _planar if planar else _spatial
    between = gtsam.BetweenFactorPose2 if planar else gtsam.BetweenFactorPose3
    prior = gtsam.PriorFactorPose2 if planar else gtsam.PriorFactorPose3
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, pose in enumerate(start.poses):
        values.insert(k, make(pose))
    for (a, b), measured, information in zip(
        graph.edge_indices.tolist(), graph.measurements, graph.information, strict=True
    ):
        if not planar:
            information = information[np.ix_(_ORDER, _ORDER)] * np.outer(_HALVED, _HALVED)
        noise = gtsam.noiseModel.Gaussian.Information(information)
        factors.add(between(a, b, make(measured), noise))
    tight = gtsam.noiseModel.Isotropic.Sigma(graph.dof, _PRIOR_SIGMA)
    factors.add(prior(0, make(start.poses[0]), tight))
    return factors, values, odometry_edges(graph)


def _planar(pose: Floats) -> Any:
    return gtsam.Pose2(*pose.tolist())


def _spatial(pose: Floats) -> Any:
    x, y, z, qx, qy, qz, qw = pose.tolist()
    return gtsam.Pose3(gtsam.Rot3.Quaternion(qw, qx, qy, qz), np.array([x, y, z]))


COMPARED: dict[str, RobustMethod] = {
    "masat": METHODS["robust"],
    "GNC": gnc,
    "GMR": METHODS["geman_mcclure_refit"],
}


def measure(name: str, graphs: list[Spoiled]) -> bool:
    """Print the lines of a row; return whether a peer has more successes than masat."""
    successes, times = {}, {}
    for method, run in COMPARED.items():
        found: list[Scores] = []
        seconds = []
        reason = ""
        for what in graphs:
            graph = unsolved(what.graph)
            begin = perf_counter()
            try:
                kept, poses = run(graph, _MAX_ITERATIONS)
            except (RuntimeError, masat.MasatError) as error:  # gtsam's are RuntimeErrors
                reason = f"  {str(error).strip().splitlines()[0][:60]}"
            else:
                found.append(score(what.clean, what.graph, what.is_false, kept, poses))
            seconds.append(perf_counter() - begin)
        successes[method] = sum(s.success for s in found), sum(s.strict_success for s in found)
        times[method] = median(seconds)
        recall = np.mean([s.recall or 0.0 for s in found]) if found else 0.0
        better = any(a > b for a, b in zip(successes[method], successes["masat"], strict=True))
        print(
            f"{name if method == 'masat' else '':<32}{method:<7}"
            f"{successes[method][0]:>7}/{len(graphs)}{successes[method][1]:>7}/{len(graphs)}"
            f"{recall:>8.3f}{sum(s.false_kept for s in found):>7}{times[method]:>9.3f}"
            f"{times[method] / times['masat']:>9.2f}"
            f"{median(t / g.plain_seconds for t, g in zip(seconds, graphs, strict=True)):>8.0f}"
            f"{'  more than masat' if better else ''}{reason}",
            flush=True,
        )
    return any(
        a > b for s in successes.values() for a, b in zip(s, successes["masat"], strict=True)
    )


def _labeled(name: str) -> list[Spoiled]:
    graph, is_true = labeled(name)
    clean, plain_seconds = plainly_solved(graph.without_edges(~is_true))
    return [Spoiled(clean.graph, graph, ~is_true, plain_seconds)]


def main() -> None:
    """Print a table, and the rows in which a peer has more successes."""
    single_threaded()
    warnings.simplefilter("ignore", masat.MasatWarning)
    texts, seeds = arguments("The robust solve beside gtsam's GNC and a Geman-McClure loss.")
    print(
        "successes and strict ones of the seeds, mean recall, false loop closures kept, median s,"
    )
    print(
        "the same over masat's (wanted at least 10 for GNC), and in plain solves of the clean graph"
    )
    print(
        f"{'':<32}{'':<7}{'success':>9}{'strict':>9}{'recall':>8}{'false':>7}{'s':>9}{'/ masat':>9}"
        f"{'units':>8}"
    )
    behind = []
    for name in selected((f"labeled {name}" for name in labeled_names()), texts):
        if measure(name, _labeled(name.removeprefix("labeled "))):
            behind.append(name)
    for name in selected(ROWS, texts):
        if measure(name, list(spoiled_graphs(ROWS[name], seeds))):
            behind.append(name)
    print(f"a peer has more successes in: {', '.join(behind) or 'no row'}")


if __name__ == "__main__":
    main()
