"""Random connected pose graphs."""

import numpy as np

from masat import PoseGraph, lie
from masat.worlds import manhattan, perturb


def random_poses(dimension: int, count: int, random: np.random.Generator) -> np.ndarray:
    if dimension == 2:
        return np.column_stack(
            [random.normal(0, 5, (count, 2)), random.uniform(-np.pi, np.pi, count)]
        )
    q = random.normal(size=(count, 4))
    return np.hstack(
        [random.normal(0, 5, (count, 3)), q / np.linalg.norm(q, axis=1, keepdims=True)]
    )


def random_graph(
    dimension: int, nodes: int, extra: int, seed: int, noise: float | None = None
) -> PoseGraph:
    """A random tree and extra edges, either way round, with poses.

    The measurements are those of the poses, turned by the noise; without noise they are random.
    """
    random = np.random.default_rng(seed)
    parents = [random.integers(k) for k in range(1, nodes)]
    tree = np.column_stack([parents, np.arange(1, nodes)]).reshape(-1, 2)
    loops = random.integers(nodes, size=(extra, 2))
    pairs = np.concatenate([tree, loops[loops[:, 0] != loops[:, 1]]])
    flip = random.random(len(pairs)) < 0.5
    pairs[flip] = pairs[flip, ::-1]
    pairs = random.permutation(pairs)
    poses = random_poses(dimension, nodes, random)
    dof = lie.DOF[dimension]
    if noise is None:
        z = random_poses(dimension, len(pairs), random)
    else:
        exact = lie.between(poses[pairs[:, 0]], poses[pairs[:, 1]])
        z = lie.retract(exact, noise * random.normal(size=(len(pairs), dof)))
    root = random.normal(size=(len(pairs), dof, dof))
    information = root @ root.transpose(0, 2, 1) + 0.1 * np.eye(dof)
    return PoseGraph.from_arrays(pairs, z, information, ids=np.arange(nodes), poses=poses)


def with_false_closures(fraction: float, seed: int) -> tuple[PoseGraph, np.ndarray, np.ndarray]:
    """Return a Manhattan world with false closures, and masks of its odometry and true edges."""
    graph = perturb(manhattan(300, 480, seed=seed), (0.03, 0.03, 0.02), seed=seed)
    odometry = np.zeros(len(graph.edges), bool)
    _, first = np.unique(graph.edges, axis=0, return_index=True)
    odometry[first] = np.abs(np.diff(graph.edges[first], axis=1)).ravel() == 1
    random = np.random.default_rng(seed)
    count = round(fraction / (1 - fraction) * np.count_nonzero(~odometry))
    begin = random.integers(150, size=count)
    false = np.column_stack([begin, begin + random.integers(50, 150, size=count)])
    z = random.normal(0, (0.3, 0.3, 0.2), (count, 3))
    bad = PoseGraph.from_arrays(
        np.concatenate([graph.edges, false]),
        np.concatenate([graph.measurements, z]),
        np.concatenate([graph.information, np.repeat(graph.information[:1], count, axis=0)]),
        ids=graph.ids,
    )
    return bad, np.r_[odometry, np.zeros(count, bool)], np.arange(len(bad.edges)) < 480
