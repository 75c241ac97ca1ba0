import numpy as np
import pytest
from plain_rotations import connection_laplacian, rotations_of, rows
from random_graphs import random_graph

import masat
from masat import PoseGraph, _core, lie
from masat.initializers.chordal import chordal
from masat.optimizers.equations import normal_equations

BOTH = pytest.mark.parametrize("dimension", [2, 3])


def spatial(x, y, theta):
    """A planar pose, turned about the z axis of space."""
    return [x, y, 0, 0, 0, np.sin(theta / 2), np.cos(theta / 2)]


@pytest.mark.parametrize("angle", [0.3, 1.5, -3.0])
def test_a_triangle_in_the_complex_plane(angle):
    # |z1 - w|^2 + |z2 - z1|^2 + |1 - z2|^2, w of length 1: z1 = (2w + 1) / 3, z2 = (w + 2) / 3.
    edges, headings = [(0, 1), (1, 2), (2, 0)], [angle, 0, 0]
    planar = PoseGraph.from_arrays(edges, [(0, 0, t) for t in headings])
    w = np.exp(1j * angle)
    expected = [0, np.angle(2 * w + 1), np.angle(w + 2)]
    assert np.allclose(chordal(planar).poses[:, 2], expected)
    solid = PoseGraph.from_arrays(edges, [spatial(0, 0, t) for t in headings])
    assert np.allclose(
        lie.local([spatial(0, 0, t) for t in expected], chordal(solid).poses), 0, atol=1e-12
    )


def test_small_errors_spread_evenly():
    quarter, error = np.pi / 2, 1e-4
    turns = [quarter, quarter, quarter, quarter + error]
    graph = PoseGraph.from_arrays([(0, 1), (1, 2), (2, 3), (3, 0)], [(1, 0, t) for t in turns])
    expected = [0, quarter - error / 4, np.pi - error / 2, -quarter - 3 * error / 4]
    assert np.allclose(chordal(graph).poses[:, 2], expected, atol=error**2)


@BOTH
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("fixed", [[], [2, 5, 6]])
def test_rotations_are_those_of_the_dense_solution(dimension, seed, fixed):
    graph = random_graph(dimension, 12, 15, seed, noise=0.4)
    graph = PoseGraph.from_arrays(
        graph.edges, graph.measurements, graph.information, poses=graph.poses, fixed=fixed
    )
    guess = chordal(graph).poses
    held = graph.index(graph.gauge)
    start = _core.rotation_matrices(guess[held])
    laplacian = connection_laplacian(graph)
    known, free = (rows(k, dimension) for k in (held, np.setdiff1d(np.arange(12), held)))
    unknowns = np.empty((12 * dimension, dimension))
    unknowns[known] = start.transpose(0, 2, 1).reshape(-1, dimension)
    unknowns[free] = np.linalg.solve(
        laplacian[np.ix_(free, free)], -laplacian[np.ix_(free, known)] @ unknowns[known]
    )
    expected = rotations_of(unknowns, dimension)
    assert np.allclose(_core.rotation_matrices(guess), expected, atol=1e-9)


@BOTH
@pytest.mark.parametrize("method", ["chordal", "lago", "spectral"])
@pytest.mark.parametrize("fixed", [[], [2, 5, 6]])
def test_positions_are_the_best_at_the_rotations(dimension, method, fixed):
    if (method, dimension) == ("lago", 3):
        return
    graph = random_graph(dimension, 30, 40, seed=1, noise=0.4)
    graph = PoseGraph.from_arrays(
        graph.edges, graph.measurements, graph.information, poses=graph.poses, fixed=fixed
    )
    guess = masat.initialize(graph, method)
    equations = normal_equations(guess)
    scale = equations.linearize(guess.poses)
    gradient = equations.rhs().reshape(-1, graph.dof)[:, :dimension]
    assert np.abs(gradient).max() < 1e-9 * scale
    assert (guess.poses[graph.index(fixed)] == graph.poses[graph.index(fixed)]).all()


@BOTH
def test_each_component_is_as_if_it_were_alone(dimension):
    parts = [random_graph(dimension, 10, 8, seed, noise=0.3) for seed in (1, 2)]
    edges = [parts[0].edges, parts[1].edges + 100]
    stacked = (
        np.concatenate([getattr(p, name) for p in parts])
        for name in ("measurements", "information")
    )
    both = PoseGraph.from_arrays(np.concatenate(edges), *stacked)
    alone = [masat.initialize(part, "chordal").poses for part in parts]
    assert np.allclose(lie.local(np.concatenate(alone), chordal(both).poses), 0, atol=1e-9)


@pytest.mark.parametrize("size", [3, 7])
@pytest.mark.parametrize("method", ["chordal", "lago", "spectral"])
def test_a_single_node_lies_at_the_identity(size, method):
    if (method, size) == ("lago", 7):
        return
    graph = PoseGraph.from_arrays(np.empty((0, 2), int), [], ids=[4], poses=np.eye(size)[-1:])
    assert (masat.initialize(graph, method).poses == lie.identity(2 if size == 3 else 3)).all()


@pytest.mark.parametrize(
    ("name", "optimum"),
    [
        ("2d/input_M3500_g2o.g2o", 137.9129509),
        ("2d/10kHog-man.txt.gz", 171545.4474),
        ("2d/MIT.g2o", 41.1632688),
        ("3d/sphere2500.g2o", 727.1496672),
        ("3d/sphere_bignoise_vertex3.g2o", 743862.7209),
        ("3d/torus3D.g2o.gz", 14574.74644),
        ("3d/parking-garage.g2o", 1.23869058),
    ],
)
@pytest.mark.parametrize("method", ["chordal", "spectral"])
def test_gauss_newton_goes_on_to_the_optimum_of_real_graphs(name, optimum, method, data_dir):
    result = masat.optimize(
        masat.initialize(masat.read(data_dir / name), method), "gauss_newton", max_iterations=10
    )
    assert result.converged
    assert np.isclose(result.chi2, optimum, rtol=1e-6)


def test_rotations_are_those_of_gtsam(data_dir):
    gtsam = pytest.importorskip("gtsam")
    graph = masat.read(data_dir / "3d" / "sphere2500.g2o")
    theirs = gtsam.NonlinearFactorGraph()
    unit = gtsam.noiseModel.Unit.Create(6)
    for (a, b), z in zip(graph.edges, graph.measurements, strict=True):
        pose = gtsam.Pose3(gtsam.Rot3(z[6], *z[3:6]), z[:3])
        theirs.add(gtsam.BetweenFactorPose3(int(a), int(b), pose, unit))
    theirs.add(gtsam.PriorFactorPose3(0, gtsam.Pose3(), unit))
    rotations = gtsam.InitializePose3.initializeOrientations(theirs)
    expected = np.array([rotations.atRot3(int(k)).matrix() for k in graph.ids])
    # The prior is an edge to an anchor, itself held by no more than the weight of an edge.
    still = lie.identity(3)
    ours = PoseGraph.from_arrays(
        np.vstack([[(-2, -1), (-1, 0)], graph.edges]), np.vstack([still, still, graph.measurements])
    )
    assert np.abs(_core.rotation_matrices(chordal(ours).poses[2:]) - expected).max() < 1e-9
