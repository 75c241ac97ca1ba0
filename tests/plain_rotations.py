"""Rotations from dense matrices: the specification of the starts that relax them."""

import numpy as np

from masat import _core


def connection_laplacian(graph):
    """The matrix L with sum of weight |R_j - R_i R|^2 = trace X'LX, X being the stack of R_i'."""
    d, n = graph.dimension, len(graph.ids)
    laplacian = np.zeros((n * d, n * d))
    measured = _core.rotation_matrices(graph.measurements)
    for (i, j), rotation, w in zip(graph.edge_indices, measured, graph.information, strict=True):
        weight = w[2, 2] / 2 if d == 2 else 3 / np.trace(np.linalg.inv(w[3:, 3:])) / 8
        row = np.zeros((d, n * d))
        row[:, i * d : i * d + d] = -rotation.T
        row[:, j * d : j * d + d] = np.eye(d)
        laplacian += weight * row.T @ row
    return laplacian


def nearest_rotation(matrix):
    u, _, v = np.linalg.svd(matrix)
    u[:, -1] *= np.linalg.det(u @ v)
    return u @ v


def rotations_of(unknowns, d):
    """The rotations nearest to a stack of R_i'."""
    return np.array([nearest_rotation(x.T) for x in unknowns.reshape(-1, d, unknowns.shape[1])])


def rows(nodes, d):
    """The rows of nodes in a stack."""
    return (np.asarray(nodes, int)[:, None] * d + np.arange(d)).ravel()
