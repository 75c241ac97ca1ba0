import sys

import numpy as np
import pytest
from plain_rotations import connection_laplacian, nearest_rotation, rotations_of, rows
from random_graphs import random_graph

import masat
from masat import MasatWarning, PoseGraph, _core, lie
from masat.initializers.spectral import spectral
from masat.worlds import sphere

BOTH = pytest.mark.parametrize("dimension", [2, 3])


def dense(graph, poses):
    """The rotations from the eigenvectors of a dense matrix, in the frame of the anchors' poses.

    Anchors share one block of unknowns: they are known up to that.
    """
    d, n = graph.dimension, len(graph.ids)
    held = graph.index(graph.gauge)
    known = _core.rotation_matrices(poses[held]).transpose(0, 2, 1).reshape(-1, d)
    free = rows(np.setdiff1d(np.arange(n), held), d)
    basis = np.zeros((n * d, d + len(free)))
    basis[rows(held, d), :d] = known / np.sqrt(len(held))
    basis[free, d + np.arange(len(free))] = 1
    _, vectors = np.linalg.eigh(basis.T @ connection_laplacian(graph) @ basis)
    unknowns = basis @ vectors[:, :d]
    if np.mean(np.linalg.det(unknowns.reshape(n, d, d)) < 0) > 0.5:
        unknowns[:, 0] *= -1
    turn = nearest_rotation(unknowns[rows(held, d)].T @ known)
    return rotations_of(unknowns @ turn, d)


@BOTH
@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("noise", [0.1, 0.4])
@pytest.mark.parametrize("fixed", [[], [7], [2, 5, 6]])
def test_rotations_are_those_of_the_dense_eigenvectors(dimension, seed, noise, fixed):
    graph = random_graph(dimension, 20, 30, seed, noise)
    graph = PoseGraph.from_arrays(
        graph.edges, graph.measurements, graph.information, poses=graph.poses, fixed=fixed
    )
    guess = spectral(graph, tolerance=1e-8).poses
    expected = dense(graph, guess)
    held = graph.index(graph.gauge)
    rotations = _core.rotation_matrices(guess)
    free = np.setdiff1d(np.arange(20), held)
    assert np.allclose(rotations[free], expected[free], atol=1e-6)


def test_two_opinions_of_one_edge_are_averaged():
    # The blocks are 1 at either node: no node shrinks, and no node is privileged.
    graph = PoseGraph.from_arrays([(0, 1), (0, 1)], [(0, 0, 0.2), (0, 0, 1.0)])
    assert np.allclose(spectral(graph).poses, [(0, 0, 0), (0, 0, 0.6)])


def test_a_ring_spreads_any_error_evenly():
    # All nodes are alike but for their numbers; the chordal start's root is not.
    turns = [0.7, 0.7, 0.7, 0.7, 2.0]
    error = sum(turns) - 2 * np.pi
    graph = PoseGraph.from_arrays([(k, (k + 1) % 5) for k in range(5)], [(1, 0, t) for t in turns])
    headings = lie.local((0, 0, 0), spectral(graph).poses)[:, 2]
    expected = np.angle(np.exp(1j * np.arange(5) * (0.7 - error / 5)))
    assert np.allclose(headings, expected)
    by_chords = masat.initialize(graph, "chordal").poses[:, 2]
    assert not np.allclose(by_chords, expected, atol=0.01)


@BOTH
def test_each_component_is_as_if_it_were_alone(dimension):
    # Nodes and edges of the two alternate.
    parts = [random_graph(dimension, 10, 8, seed, noise=0.3) for seed in (1, 2)]
    order = np.random.default_rng(0).permutation(sum(len(p.edges) for p in parts))
    edges = np.concatenate([2 * parts[0].edges, 2 * parts[1].edges + 1])[order]
    z, information = (
        np.concatenate([getattr(p, name) for p in parts])[order]
        for name in ("measurements", "information")
    )
    with pytest.warns(MasatWarning, match="2 components"):
        both = masat.initialize(PoseGraph.from_arrays(edges, z, information), "spectral").poses
    for k, part in enumerate(parts):
        assert np.allclose(lie.local(spectral(part).poses, both[k::2]), 0, atol=1e-5)


@BOTH
def test_consistent_fixed_nodes_leave_the_truth(dimension):
    truth = random_graph(dimension, 30, 40, seed=5, noise=0.0)
    graph = PoseGraph.from_arrays(
        truth.edges, truth.measurements, truth.information, poses=truth.poses, fixed=[3, 8, 20]
    )
    assert np.allclose(lie.local(truth.poses, spectral(graph).poses), 0, atol=1e-9)


def test_a_search_cut_short_is_reported(monkeypatch):
    monkeypatch.setattr(sys.modules["masat.initializers.spectral"], "_MAX_STEPS", 1)
    graph = random_graph(3, 40, 60, seed=1, noise=0.4)
    with pytest.warns(MasatWarning, match="not found in 1 steps"):
        masat.initialize(graph, "spectral")


def test_large_noise_hurts_less_than_it_hurts_the_chordal_start(data_dir):
    graph = masat.read(data_dir / "3d" / "sphere_bignoise_vertex3.g2o")
    ours, theirs = (
        masat.optimize(masat.initialize(graph, m), max_iterations=0).chi2
        for m in ("spectral", "chordal")
    )
    assert ours < 0.97 * theirs


def test_large_worlds_converge():
    assert spectral(sphere(3000, seed=0)).notes == ()
