"""Random connected pose graphs."""

import numpy as np

from masat import PoseGraph, lie


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
