import numpy as np
import pytest

import masat
from masat import InitializationError, PoseGraph, lie
from masat.initializers.lago import lago
from masat.worlds import sphere


def off(headings, others):
    """The difference of angles, less whole turns."""
    return np.angle(np.exp(1j * (headings - np.asarray(others))))


def ring(turns, weights=None):
    """A polygon of sides of length 1; the last edge leads back to node 0."""
    n = len(turns)
    z = [(1, 0, turn) for turn in turns]
    information = [np.diag([1, 1, w]) for w in (np.ones(n) if weights is None else weights)]
    return PoseGraph.from_arrays([(k, (k + 1) % n) for k in range(n)], z, information)


def test_a_square_spreads_the_error_of_its_headings_evenly():
    quarter = np.pi / 2
    guess = lago(ring([quarter, quarter, quarter, quarter + 0.4]))
    expected = [0, quarter - 0.1, 2 * quarter - 0.2, 3 * quarter - 0.3]
    assert np.allclose(off(guess.poses[:, 2], expected), 0)


def test_a_strong_edge_takes_less_of_the_error():
    # As springs in a row: by 1 / weight.
    quarter = np.pi / 2
    guess = lago(ring([quarter, quarter, quarter, quarter + 0.5], [1, 2, 1, 0.5]))
    expected = np.arange(4) * quarter - 0.5 * np.array([0, 1, 1.5, 2.5]) / 4.5
    assert np.allclose(off(guess.poses[:, 2], expected), 0)


@pytest.mark.parametrize("nodes", [7, 13, 40, 101])
def test_however_often_a_ring_goes_round_its_turns_do_not_count(nodes):
    # 0.5 rad an edge: up to eight turns, of which the edge that closes the ring knows nothing.
    turns = np.full(nodes, 0.5)
    turns[-1] = np.angle(np.exp(-0.5j * (nodes - 1))) + 0.13
    guess = lago(ring(turns))
    expected = np.arange(nodes) * (0.5 - 0.13 / nodes)
    assert np.allclose(off(guess.poses[:, 2], expected), 0)


def test_measured_angles_count_but_for_whole_turns():
    graph = ring([1.5, 1.6, 1.5, 1.7])
    more = graph.measurements + 2 * np.pi * np.array([[0, 0, 1], [0, 0, -3], [0, 0, 0], [0, 0, 2]])
    unwrapped = PoseGraph.from_arrays(graph.edges, more, graph.information)
    assert np.allclose(lie.local(lago(graph).poses, lago(unwrapped).poses), 0)


def test_between_fixed_headings_the_others_are_spaced_across_the_wrap():
    poses = [(0, 0, np.pi - 0.1), (9, 9, 9), (9, 9, 9), (-3, 0, -np.pi + 0.2)]
    graph = PoseGraph.from_arrays(
        [(0, 1), (1, 2), (2, 3)], [(1, 0, 0)] * 3, poses=poses, fixed=[0, 3]
    )
    guess = lago(graph).poses
    assert np.allclose(off(guess[:, 2], np.pi + np.array([-0.1, 0, 0.1, 0.2])), 0)
    assert np.allclose(guess[[0, 3], :2], [(0, 0), (-3, 0)])


def test_graphs_in_space_are_refused():
    with pytest.raises(InitializationError, match="planar graphs only"):
        lago(sphere(50))


@pytest.mark.parametrize(
    ("name", "optimum"),
    [
        ("input_M3500_g2o.g2o", 137.9129509),
        ("manhattan.g2o", 3549.036796),
        ("city10000.g2o", 511.9851636),
        ("intel.g2o", 45.00469581),
        ("CSAIL.g2o", 40.55512885),
        # Around the cycles of the odometry chain the noise is more than half a turn.
        ("MIT.g2o", 41.16326884),
        ("ais2klinik.g2o", 172.8155793),
    ],
)
def test_gauss_newton_goes_on_to_the_optimum_of_real_graphs(name, optimum, data_dir):
    graph = masat.read(data_dir / "2d" / name)
    guess = lago(graph)
    tree = masat.initialize(graph, "spanning_tree")
    chi2, chi2_of_tree = (masat.optimize(g, max_iterations=0).chi2 for g in (guess, tree))
    assert chi2 < 0.1 * chi2_of_tree
    result = masat.optimize(guess, "gauss_newton")
    assert result.converged
    assert np.isclose(result.chi2, optimum, rtol=1e-6)


@pytest.mark.parametrize("name", ["input_M3500_g2o.g2o", "intel.g2o"])
def test_headings_are_those_of_gtsam(name, data_dir):
    gtsam = pytest.importorskip("gtsam")
    graph = masat.read(data_dir / "2d" / name)
    # It takes diagonal information only.
    precisions = np.einsum("kii->ki", graph.information)
    theirs = gtsam.NonlinearFactorGraph()
    for (a, b), z, w in zip(graph.edges, graph.measurements, precisions, strict=True):
        model = gtsam.noiseModel.Diagonal.Precisions(w)
        theirs.add(gtsam.BetweenFactorPose2(int(a), int(b), gtsam.Pose2(*z), model))
    tight = gtsam.noiseModel.Isotropic.Sigma(3, 1e-4)
    theirs.add(gtsam.PriorFactorPose2(int(graph.ids[0]), gtsam.Pose2(), tight))
    headings = gtsam.lago.initializeOrientations(theirs, True)
    expected = np.array([headings.at(int(k)) for k in graph.ids]).ravel()
    assert np.abs(off(lago(graph).poses[:, 2], expected)).max() < 1e-9
