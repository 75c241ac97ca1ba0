"""MASAT in plain Python: the readable specification, and the oracle of the native one."""

from collections import deque

import numpy as np

from masat import PoseGraph, lie


def plain_masat(graph: PoseGraph, root: int) -> np.ndarray:
    neighbours = [[] for _ in graph.ids]
    for k, (a, b) in enumerate(graph.edge_indices):
        neighbours[a].append((b, k, False))
        neighbours[b].append((a, k, True))

    placed = {root: lie.identity(graph.dimension)}
    queued = {root}
    queue = deque([root])
    while queue:
        node = queue.popleft()
        proposals = []
        for neighbour, k, leads_here in neighbours[node]:
            z = graph.measurements[k]
            if neighbour not in queued:
                queued.add(neighbour)
                queue.append(neighbour)
            elif neighbour in placed:
                step = z if leads_here else lie.inverse(z)
                proposals.append(lie.compose(placed[neighbour], step))
        if node != root:
            placed[node] = average(np.array(proposals))
    return np.array([placed[node] for node in range(len(graph.ids))])


def average(poses: np.ndarray) -> np.ndarray:
    d = 2 if poses.shape[1] == 3 else 3
    position, rotation = poses[:, :d].mean(axis=0), poses[:, d:]
    if d == 2:
        heading = np.arctan2(np.sin(rotation).mean(), np.cos(rotation).mean())
        return np.append(position, heading)
    aligned = rotation * np.where(rotation @ rotation[0] < 0, -1, 1)[:, None]
    mean = aligned.mean(axis=0)
    return np.append(position, mean / np.linalg.norm(mean))
