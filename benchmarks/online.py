"""Public graphs as streams: masat.OnlineMap and gtsam's ISAM2, all poses after each step.

    python -m benchmarks.online [GRAPH ..] [--no-peer] [--rounds N] [--sample N] [--steps N]

Poses arrive in the order of their ids, each with its edges to earlier ones, odometry first. A step
is the addition, the update, and reading all poses; times are those of the thread. Every N-th step
its own optimum is computed outside of the clock: the excess is (chi2 - optimum) / optimum.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from time import thread_time
from typing import Any

import numpy as np

import masat
from benchmarks.graphs import CASES, Case, quietly_read
from benchmarks.threads import single_threaded
from masat.arrays import Floats, Ids
from masat.online.growing import TOLERANCE

GRAPHS = (
    "M3500",
    "intel",
    "city10000",
    "10kHog-man",
    "sphere2500",
    "parking-garage",
    "torus3D",
)
# A chi2 below this is that of edges that agree up to rounding.
_NO_NOISE = 1e-6


@dataclass
class Stream:
    """A graph in the order of its poses.

    Attributes
    ----------
    graph : PoseGraph
        The graph, with edges in the order of the stream.
    begin : ndarray of int64, (n + 1,)
        Where the edges of each pose begin.
    """

    graph: masat.PoseGraph
    begin: Ids

    def prefix(self, nodes: int, poses: Floats) -> masat.PoseGraph:
        """Return the graph of the first nodes, at these poses."""
        edges = slice(self.begin[nodes])
        return masat.PoseGraph.from_arrays(
            self.graph.edges[edges],
            self.graph.measurements[edges],
            self.graph.information[edges],
            ids=self.graph.ids[:nodes],
            poses=poses,
        )


@dataclass
class Run:
    """Times of the steps in ms, and the excess of those that were sampled."""

    name: str
    times: list[float] = field(default_factory=list)
    excess: list[float] = field(default_factory=list)
    note: str = ""

    def __str__(self) -> str:
        t = np.array(self.times)
        out = (
            f"  {self.name:<28}{t.sum() / 1e3:9.2f}{np.median(t):9.3f}"
            f"{np.percentile(t, 99):8.2f}{t.max():8.1f}"
        )
        if self.excess:
            out += f"{np.mean(self.excess):10.1e}{max(self.excess):9.1e}"
        return f"{out}  {self.note}"


Step = Callable[[int], Floats]


def stream_of(case: Case) -> Stream:
    """Return a public graph as a stream."""
    graph = quietly_read(case.source)
    ends = graph.edge_indices
    newer, gap = ends.max(axis=1), np.abs(np.diff(ends, axis=1))[:, 0]
    order = np.lexsort((gap != 1, newer))
    begin = np.searchsorted(newer[order], np.arange(len(graph) + 1))
    ordered = masat.PoseGraph.from_arrays(
        graph.edges[order], graph.measurements[order], graph.information[order], ids=graph.ids
    )
    return Stream(ordered, begin)


def timed(run: Run, stream: Stream, step: Step, steps: int, optima: dict[int, float]) -> None:
    """Run all steps; sample those whose optimum is asked for, by the number of poses."""
    for k in range(steps):
        start = thread_time()
        poses = step(k)
        run.times.append(1e3 * (thread_time() - start))
        if k + 1 not in optima:
            continue
        at = stream.prefix(k + 1, np.array(poses))
        if np.isnan(optima[k + 1]):
            optima[k + 1] = masat.optimize(at, relative_tolerance=1e-11).chi2
        if optima[k + 1] > _NO_NOISE:
            run.excess.append(at.chi2 / optima[k + 1] - 1)


def with_masat(stream: Stream, steps: int, optima: dict[int, float], tolerance: float) -> Run:
    """Feed the stream to an `OnlineMap`."""
    graph, world = stream.graph, masat.OnlineMap(stream.graph.dimension, tolerance=tolerance)
    run = Run(f"masat {tolerance:g}")

    def step(k: int) -> Floats:
        world.add_pose(int(graph.ids[k]))
        rows = slice(stream.begin[k], stream.begin[k + 1])
        if rows.start < rows.stop:
            world.add_edges(graph.edges[rows], graph.measurements[rows], graph.information[rows])
        world.update()
        return world.poses

    timed(run, stream, step, steps, optima)
    memory = world._core.bytes_of_factor()
    final = world.optimize()
    batch = masat.optimize(final.graph, relative_tolerance=1e-13)
    matrix = final.graph.elimination.fill(final.graph.dof)
    run.note = (
        f"optimize() {world.chi2 / batch.chi2 - 1:+.0e} of batch, memory {memory / 2**20:.1f} MB, "
        f"{memory / 8 / matrix:.1f} times the batch factor's"
    )
    return run


def with_isam2(stream: Stream, steps: int, optima: dict[int, float], skip: int, method: str) -> Run:
    """Feed the stream to gtsam's ISAM2; relinearization threshold 0.1."""
    import gtsam

    from benchmarks.with_gtsam import poses_of

    graph = stream.graph
    parameters = gtsam.ISAM2Params()
    parameters.setRelinearizeThreshold(0.1)
    parameters.relinearizeSkip = skip
    parameters.setFactorization(method)
    isam = gtsam.ISAM2(parameters)
    run = Run(f"ISAM2 ({skip}, .1) {method}")
    dimension = graph.dimension
    factors = gtsam_factors(graph)
    pose = gtsam.Pose2 if dimension == 2 else gtsam.Pose3
    noise = gtsam.noiseModel.Isotropic.Sigma(graph.dof, 1e-4)
    prior = (gtsam.PriorFactorPose2 if dimension == 2 else gtsam.PriorFactorPose3)(
        int(graph.ids[0]), pose(), noise
    )
    values = gtsam.Values()

    def step(k: int) -> Any:
        nonlocal values
        new, guess, node = gtsam.NonlinearFactorGraph(), gtsam.Values(), int(graph.ids[k])
        if k == 0:
            new.add(prior)
            guess.insert(node, pose())
        for row in range(stream.begin[k], stream.begin[k + 1]):
            factor = factors[row]
            new.add(factor)
            if guess.size() == 0:
                a, b = factor.keys()
                known = values.atPose2 if dimension == 2 else values.atPose3
                z = factor.measured()
                guess.insert(
                    node, known(a).compose(z) if b == node else known(b).compose(z.inverse())
                )
        isam.update(new, guess)
        values = isam.calculateEstimate()
        return values

    sampled = dict(optima)
    try:
        for k in range(steps):
            start = thread_time()
            step(k)
            run.times.append(1e3 * (thread_time() - start))
            if k + 1 in sampled and optima[k + 1] > _NO_NOISE:
                at = stream.prefix(k + 1, poses_of(values, dimension))
                run.excess.append(at.chi2 / optima[k + 1] - 1)
    except RuntimeError as error:
        run.note = f"failed at step {len(run.times)}: {str(error).splitlines()[0][:60]}"
    return run


def gtsam_factors(graph: masat.PoseGraph) -> list[Any]:
    """Return gtsam's factors with the cost of the edges, to first order in the residuals.

    gtsam has the rotation first, as a rotation vector, which is twice the quaternion's part.
    """
    import gtsam

    out = []
    order, half = [3, 4, 5, 0, 1, 2], np.array([0.5, 0.5, 0.5, 1, 1, 1])
    for (a, b), z, w in zip(
        graph.edges.tolist(), graph.measurements, graph.information, strict=True
    ):
        if graph.dimension == 2:
            noise = gtsam.noiseModel.Gaussian.Information(w)
            out.append(gtsam.BetweenFactorPose2(a, b, gtsam.Pose2(*z), noise))
            continue
        noise = gtsam.noiseModel.Gaussian.Information(w[order][:, order] * np.outer(half, half))
        pose = gtsam.Pose3(gtsam.Rot3.Quaternion(z[6], *z[3:6]), z[:3])
        out.append(gtsam.BetweenFactorPose3(a, b, pose, noise))
    return out


def _peers(name: str) -> Iterator[tuple[int, str]]:
    """Return the settings that were best for each graph in design trials."""
    if name == "parking-garage":
        yield 1, "QR"
    else:
        yield (10 if name in ("sphere2500", "10kHog-man", "torus3D") else 1), "CHOLESKY"


def main() -> None:
    """Print a table for each graph."""
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    parser.add_argument("graphs", nargs="*", default=GRAPHS)
    parser.add_argument("--no-peer", action="store_true", help="leave out ISAM2")
    parser.add_argument(
        "--rounds", type=int, default=1, help="repetitions; the median of each time"
    )
    parser.add_argument(
        "--sample", type=int, default=50, help="steps between samples of the excess"
    )
    parser.add_argument("--steps", type=int, help="only so many steps")
    parser.add_argument("--tolerance", type=float, default=TOLERANCE)
    options = parser.parse_args()
    single_threaded()
    print(f"{'':30}{'total s':>9}{'median ms':>9}{'p99':>8}{'max':>8}{'excess':>10}{'max':>9}")
    for name in options.graphs:
        case = CASES[name]
        stream = stream_of(case)
        steps = min(options.steps or len(stream.graph), len(stream.graph))
        optima = dict.fromkeys(range(options.sample, steps + 1, options.sample), np.nan)
        print(f"{name}, {steps} poses, {stream.begin[steps]} edges", flush=True)
        runs = [with_masat(stream, steps, optima, options.tolerance) for _ in range(options.rounds)]
        print(_median(runs), flush=True)
        for skip, method in () if options.no_peer else _peers(name):
            peers = [with_isam2(stream, steps, optima, skip, method) for _ in range(options.rounds)]
            print(_median(peers), flush=True)
            print(_ratios(_median(peers), _median(runs)), flush=True)


def _median(runs: list[Run]) -> Run:
    shortest = min(len(run.times) for run in runs)
    times = np.median([run.times[:shortest] for run in runs], axis=0)
    return Run(runs[0].name, list(times), runs[0].excess, runs[0].note)


def _ratios(peer: Run, own: Run) -> str:
    a, b = np.array(peer.times), np.array(own.times[: len(peer.times)])
    figures = (a.sum() / b.sum(), np.median(a) / np.median(b))
    tails = (np.percentile(a, 99) / np.percentile(b, 99), a.max() / b.max())
    return (
        f"  {'ISAM2 / masat':<28}{figures[0]:9.1f}{figures[1]:9.1f}{tails[0]:8.1f}{tails[1]:8.1f}"
    )


if __name__ == "__main__":
    main()
