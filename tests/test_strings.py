"""Strings of edges between short cycles that may close either way."""

import numpy as np
import pytest

import masat
from masat.lie import between, identity, retract
from masat.optimality.strings import Strings, _short_cycles
from masat.worlds import WORLDS, perturb


def lattice(rows, columns, seed=None):
    """A square lattice in 3D with exact measurements; with a seed, poses rotated at random."""
    index = np.arange(rows * columns).reshape(rows, columns)
    along = np.column_stack([index[:, :-1].ravel(), index[:, 1:].ravel()])
    across = np.column_stack([index[:-1].ravel(), index[1:].ravel()])
    edges = np.concatenate([along, across])
    poses = np.tile(identity(3), (rows * columns, 1))
    poses[:, 0], poses[:, 1] = np.divmod(np.arange(rows * columns), columns)
    z = between(poses[edges[:, 0]], poses[edges[:, 1]])
    if seed is not None:
        step = np.zeros((len(poses), 6))
        step[:, 3:] = np.random.default_rng(seed).normal(size=(len(poses), 3)) * 0.4
        poses = retract(poses, step)
    return masat.PoseGraph.from_arrays(edges, z, poses=poses)


def sums(cycle, string):
    return sum(cycle[edge] * sign for edge, sign in string.items() if edge in cycle)


def test_the_short_cycles_of_a_lattice_are_its_squares():
    graph = lattice(4, 6)
    cycles = _short_cycles(graph)
    assert len(cycles) == 3 * 5
    assert all(len(cycle) == 4 for cycle in cycles)
    for cycle in cycles:
        # A closed walk enters each of its nodes as often as it leaves it.
        net = np.zeros(len(graph.ids), int)
        for edge, sign in cycle.items():
            i, j = graph.edge_indices[edge]
            net[i] -= sign
            net[j] += sign
        assert not net.any()


def test_a_tree_has_no_short_cycles_and_no_strings():
    chain = masat.PoseGraph.from_arrays(
        [(k, k + 1) for k in range(4)],
        np.tile(identity(3), (4, 1)),
        poses=np.tile(identity(3), (5, 1)),
    )
    strings = Strings(chain)
    assert strings._cycles == []
    assert strings.at(chain.poses) == []


def test_a_string_shifts_its_ends_and_no_cycle_between():
    graph = lattice(5, 7)
    strings = Strings(graph)
    every = np.full(len(strings._cycles), 3.0)
    found = strings._strings_from(0, every)
    assert len(found) > len(strings._cycles) - 1
    for string in found:
        turns = [sums(cycle, string) for cycle in strings._cycles]
        assert abs(turns[0]) == 1
        # At the other end is another cycle, or the border.
        assert np.count_nonzero(turns) in (1, 2)
        assert np.abs(turns).max() == 1


def test_where_all_residuals_are_zero_no_string_promises_anything():
    graph = lattice(5, 7)
    assert Strings(graph).at(graph.poses) == []


def test_the_strings_are_sorted_and_rotate_by_whole_turns():
    graph = perturb(WORLDS["sphere"](200, seed=1), [0.5, 0.5], seed=1)
    poor = masat.optimize(masat.initialize(graph, "chordal"))
    found = Strings(graph).at(poor.poses)
    assert len(found) > 0
    costs = [string.cost for string in found]
    assert costs == sorted(costs)
    assert costs[-1] < 0
    for string in found:
        assert np.allclose(np.linalg.norm(string.vectors, axis=1), 2 * np.pi)


@pytest.mark.parametrize("seed", [100, 101])
def test_at_much_noise_in_3d_the_truth_is_not_lower(seed):
    graph = perturb(WORLDS["sphere"](500, seed=seed), [0.5, 0.5], seed=seed)
    control = masat.optimize(graph, "gauss_newton")
    chordal = masat.optimize(masat.initialize(graph, "chordal"))
    assert chordal.chi2 > control.chi2 * 1.02
    assert masat.solve(graph).chi2 <= control.chi2 * (1 + 1e-6)
