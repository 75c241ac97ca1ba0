"""A g2o file as a stream: the map after each pose, and how far it is from the batch optimum.

    python examples/stream_g2o.py [graph.g2o] [--every N]

Without a file, a simulated Manhattan world is streamed.
"""

from __future__ import annotations

import argparse
from time import perf_counter

import numpy as np

import masat
from masat import worlds


def main(arguments: list[str] | None = None) -> tuple[float, float]:
    """Stream a graph and print the map's progress; return its last chi2 and the optimum."""
    parser = argparse.ArgumentParser(description="Stream a g2o file to a map that grows.")
    parser.add_argument("graph", nargs="?", help="a file; by default a world is simulated")
    parser.add_argument("--every", type=int, default=100, help="poses between two lines")
    options = parser.parse_args(arguments)
    if options.graph:
        graph = masat.read(options.graph)
    else:
        graph = worlds.perturb(worlds.manhattan(500, 800), (0.05, 0.05, 0.03))

    world = masat.OnlineMap(graph.dimension)
    newer = graph.edges.max(axis=1)  # an edge arrives with the newer one of its nodes
    seconds = []
    for k, node in enumerate(graph.ids.tolist(), 1):
        begin = perf_counter()
        world.add_pose(node)
        new = newer == node
        world.add_edges(graph.edges[new], graph.measurements[new], graph.information[new])
        done = world.update()
        seconds.append(perf_counter() - begin)
        if k % options.every == 0:
            print(f"{k:6d} poses, chi2 {done.chi2:10.4f}, {done.relinearized} linearized again")

    chi2, optimum = world.chi2, world.optimize().chi2
    print(f"chi2 {chi2:.6g}, optimum from there {optimum:.6g}")
    print(f"a step took {1e3 * np.median(seconds):.2f} ms in the median")
    return chi2, optimum


if __name__ == "__main__":
    main()
