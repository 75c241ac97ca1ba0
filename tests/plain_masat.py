"""MASAT in plain Python: the readable specification, and the oracle of the native one.

And of its variant that goes on with the node of which most is known.
"""

from collections import deque

import numpy as np

from masat import PoseGraph, lie


def neighbors_of(graph: PoseGraph) -> list[list[tuple[int, int, bool]]]:
    neighbors = [[] for _ in graph.ids]
    for k, (a, b) in enumerate(graph.edge_indices):
        neighbors[a].append((b, k, False))
        neighbors[b].append((a, k, True))
    return neighbors


def plain_masat(graph: PoseGraph, root: int) -> np.ndarray:
    neighbors = neighbors_of(graph)
    placed = {root: lie.identity(graph.dimension)}
    queued = {root}
    queue = deque([root])
    while queue:
        node = queue.popleft()
        proposals = []
        for neighbor, k, leads_here in neighbors[node]:
            z = graph.measurements[k]
            if neighbor not in queued:
                queued.add(neighbor)
                queue.append(neighbor)
            elif neighbor in placed:
                step = z if leads_here else lie.inverse(z)
                proposals.append(lie.compose(placed[neighbor], step))
        if node != root:
            placed[node] = average(np.array(proposals))
    return np.array([placed[node] for node in range(len(graph.ids))])


def plain_most_informed_first(graph: PoseGraph, root: int) -> np.ndarray:
    neighbors = neighbors_of(graph)
    placed = {root: lie.identity(graph.dimension)}
    information = {}
    arrived = {}  # node: (class of its information, when it came there)
    time = 0

    def tell(node, variance):
        nonlocal time
        for neighbor, _, _ in neighbors[node]:
            if neighbor in placed:
                continue
            more = np.float32(1) / (variance + np.float32(1))
            information[neighbor] = information.get(neighbor, np.float32(0)) + more
            mantissa, exponent = np.frexp(information[neighbor])
            now = (exponent, np.floor(32 * mantissa))
            time += 1
            if neighbor not in arrived or arrived[neighbor][0] != now:
                arrived[neighbor] = (now, time)

    tell(root, np.float32(0))
    while arrived:
        best, _ = max(arrived.values())
        node = min((when, v) for v, (known, when) in arrived.items() if known == best)[1]
        del arrived[node]
        proposals = []
        for neighbor, k, leads_here in neighbors[node]:
            if neighbor in placed:
                z = graph.measurements[k]
                step = z if leads_here else lie.inverse(z)
                proposals.append(lie.compose(placed[neighbor], step))
        placed[node] = average(np.array(proposals))
        tell(node, np.float32(1) / information[node])
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
