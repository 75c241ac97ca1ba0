import numpy as np
import pytest
from random_graphs import random_graph, random_poses

import masat
from masat import FormatError, OptimizationError, PoseGraph, Result, StopReason, lie
from masat._core import NormalEquations
from masat.optimizers import OPTIMIZERS
from masat.residuals import chi2_per_edge
from masat.structure import eliminate
from masat.worlds import manhattan, perturb

METHODS = list(OPTIMIZERS)

HALF_TURN = [0, 0, 0, 1, 0, 0, 0]
STILL = [0, 0, 0, 0, 0, 0, 1]


def line(*gaps, **more):
    """Nodes on a line, each a meter from the last, and a measurement of the whole way."""
    edges = [(k, k + 1) for k in range(len(gaps) - 1)] + [(0, len(gaps) - 1)]
    return PoseGraph.from_arrays(edges, [(g, 0, 0) for g in gaps], **more)


def equations_of(graph, fixed=(0,)):
    held = np.zeros(len(graph.ids), bool)
    held[list(fixed)] = True
    order = eliminate(graph.topology, held, graph.dof)
    return NormalEquations(graph.topology, order, graph.measurements, graph.information)


def chi2_by_hand(graph, poses):
    predicted = lie.between(*(poses[graph.edge_indices[:, end]] for end in (0, 1)))
    e = lie.local(graph.measurements, predicted)
    return np.einsum("ki,kij,kj->k", e, graph.information, e)


@pytest.mark.parametrize("dimension", [2, 3])
def test_chi2_is_that_of_the_definition(dimension):
    graph = random_graph(dimension, 12, 20, seed=2)
    by_hand = chi2_by_hand(graph, graph.poses)
    assert np.allclose(chi2_per_edge(graph), by_hand)
    assert np.isclose(equations_of(graph).chi2(graph.poses), by_hand.sum())


CHI2_IN_THE_FILES = {
    "2d/input_M3500_g2o.g2o": 2566667.7,
    "2d/10kHog-man.txt.gz": 6880893.6,
    "2d/w10000.graph.gz": 49440240,
    "2d/MIT.g2o": 4.4141817e9,
    "2d/intel_vertigo.g2o": 1331.4989,
    "2d/killian-court.txt": 2.0467303e-07,
    "3d/sphere2500.g2o": 2547810.9,
    "3d/sphere_bignoise_vertex3.g2o": 1.7663122e8,
    "3d/torus3D.g2o.gz": 2946826.5,
    "3d/parking-garage.g2o": 16720.018,
    "3d/sphere3D.g2o.gz": 1.3474545e11,
    "3d/burghers.g2o": 591.05865,
}


@pytest.mark.filterwarnings("ignore::masat.MasatWarning")
@pytest.mark.parametrize(("name", "chi2"), CHI2_IN_THE_FILES.items())
def test_chi2_of_the_files_own_poses_is_g2os(name, chi2, data_dir):
    assert np.isclose(chi2_per_edge(masat.read(data_dir / name)).sum(), chi2, rtol=1e-7)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("seed", range(5))
def test_gradient_and_system_agree_with_finite_differences(dimension, seed):
    graph = random_graph(dimension, 6, 8, seed, noise=0.2)
    equations = equations_of(graph, fixed=(2,))
    free, dof = np.delete(np.arange(6), 2), lie.DOF[dimension]
    unknowns = len(free) * dof
    edges = graph.edge_indices

    def errors(step):
        poses = equations.retract(graph.poses, step)
        predicted = lie.between(poses[edges[:, 0]], poses[edges[:, 1]])
        # g2o's order, z^-1 (a^-1 b): the weights are those of the measurement's frame.
        return lie.local(graph.measurements, predicted)

    h = 1e-6
    columns = np.eye(unknowns) * h
    jacobian = np.stack([(errors(c) - errors(-c)) / (2 * h) for c in columns], axis=-1)
    e, w = errors(np.zeros(unknowns)), graph.information
    dense = np.einsum("kia,kij,kjb->ab", jacobian, w, jacobian)
    rhs = -np.einsum("kia,kij,kj->a", jacobian, w, e)

    chi2 = equations.linearize(graph.poses)
    assert np.isclose(chi2, np.einsum("ki,kij,kj->", e, w, e))
    assert np.allclose(equations.rhs(), rhs, rtol=1e-6, atol=1e-6 * np.abs(rhs).max())
    assert np.allclose(equations.diagonal(), np.diag(dense), rtol=1e-6)
    assert np.allclose(equations.multiply(rhs), dense @ rhs, rtol=1e-6)
    damping = np.linspace(0, 3, unknowns)
    assert equations.factorize(damping) == -1
    expected = np.linalg.solve(dense + np.diag(damping), rhs)
    assert np.allclose(equations.solve(), expected, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_kept_analysis_serves_every_linearization(dimension):
    # At the exact truth many entries are zero: they must keep their places.
    graph = random_graph(dimension, 20, 30, seed=4, noise=0.0)
    kept = equations_of(graph)
    kept.linearize(graph.poses)
    kept.factorize(np.zeros(19 * lie.DOF[dimension]))
    moved = random_poses(dimension, 20, np.random.default_rng(1))
    fresh = equations_of(graph)
    steps = []
    for equations in (kept, fresh):
        equations.linearize(moved)
        assert equations.factorize(np.zeros(19 * lie.DOF[dimension])) == -1
        steps.append(equations.solve())
    assert (steps[0] == steps[1]).all()


@pytest.mark.parametrize("method", METHODS)
def test_a_contradiction_is_shared_out_evenly(method):
    # 1 + 1 measured against 2.3: each of the three edges takes 0.1.
    result = masat.optimize(masat.initialize(line(1, 1, 2.3), "masat"), method)
    assert result.converged
    assert np.allclose(result.poses[:, 0], [0, 1.1, 2.2], atol=1e-9)
    assert np.isclose(result.chi2, 0.03)
    assert result.degrees_of_freedom == 3
    assert np.isclose(result.reduced_chi2, 0.01)


@pytest.mark.parametrize("method", METHODS)
def test_information_decides_who_yields(method):
    weights = [np.diag([w, 1, 1]) for w in (1, 1, 4)]
    graph = line(1, 1, 2.9, information=weights)
    result = masat.optimize(masat.initialize(graph, "masat"), method)
    # 0.9 is shared out as 1/w: 0.4, 0.4, 0.1.
    assert np.allclose(result.poses[:, 0], [0, 1.4, 2.8], atol=1e-9)


BEST = {
    "2d/input_M3500_g2o.g2o": 137.9129509,
    "2d/manhattanOlson3500.g2o": 146.0766129,
    "2d/manhattanOlson3500_olson.g2o": 146.076745,
    "2d/manhattan.g2o": 3549.036796,
    "2d/manhattanOlson3500_isam.txt": 6532.744728,
    "2d/city10000.g2o": 511.9851636,
    "2d/city10k.txt": 31931.41199,
    "2d/city10000_isam.txt": 31931.41199,
    "2d/10kHog-man.txt.gz": 171545.4474,
    "2d/w10000.graph.gz": 289.7258912,
    "2d/intel.g2o": 45.00469581,
    "2d/INTEL_P_g2o.g2o": 212.6969122,
    "2d/intel_vertigo.g2o": 546.4611116,
    "2d/input_INTEL_g2o.g2o": 215.8302349,
    "2d/MIT.g2o": 41.16326884,
    "2d/CSAIL.g2o": 40.55512885,
    "2d/FR079_P_g2o.g2o": 37.59911592,
    "2d/killian-court.txt": 5.76041685e-08,
    "2d/ais2klinik.g2o": 172.8155793,
    "2d/kitti_00.g2o": 98.32201174,
    "2d/kitti_06.g2o": 25.94708512,
    "2d/kitti_07.g2o": 12.66103626,
    "2d/kitti_09.g2o": 34.38282797,
    "2d/ring.g2o": 11.16310083,
    "2d/ring_groundtruth.g2o": 5.680077295e-13,
    "3d/sphere2500.g2o": 727.1496672,
    "3d/sphere_bignoise_vertex3.g2o": 743862.7209,
    "3d/torus3D.g2o.gz": 14574.74644,
    "3d/parking-garage.g2o": 1.23869058,
    "3d/tinyGrid3D.g2o": 6.727881617,
    "3d/sphere3D.g2o.gz": 86906.82288,
    "3d/burghers.g2o": 0.178055098,
    "3d/car.g2o": 0.9699159468,
    "3d/stonewall.g2o": 0.04111240779,
    "3d/cubicle.g2o": 8.750614187,
}


@pytest.mark.filterwarnings("ignore::masat.MasatWarning")
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("name", "best"), BEST.items())
def test_masat_leads_to_the_best_known_minimum(name, best, method, data_dir):
    graph = masat.read(data_dir / name, indefinite="identity")
    result = masat.optimize(masat.initialize(graph, "masat"), method)
    assert result.converged
    assert result.chi2 <= best * (1 + 1e-6)


@pytest.mark.parametrize("method", METHODS)
def test_a_tree_fits_exactly_and_has_no_reduced_chi2(method, data_dir):
    result = masat.optimize(
        masat.initialize(masat.read(data_dir / "2d/kitti_08.g2o"), "masat"), method
    )
    assert result.converged
    assert result.chi2 < 1e-20
    assert result.degrees_of_freedom == 0
    assert result.reduced_chi2 is None


@pytest.mark.parametrize("start", ["given", "odometry"])
def test_mit_has_a_local_minimum(start, data_dir):
    graph = masat.initialize(masat.read(data_dir / "2d/MIT.g2o"), start)
    result = masat.optimize(graph)
    assert result.converged
    assert np.isclose(result.chi2, 770.6635, rtol=1e-6)


@pytest.mark.parametrize("method", METHODS)
def test_a_noisy_world_is_explained_as_well_as_its_noise_allows(method):
    truth = manhattan(400, 900, extent=12, seed=1)
    noisy = perturb(truth, (0.05, 0.05, 0.02), seed=2)
    result = masat.optimize(masat.initialize(noisy, "masat"), method)
    # The reduced chi2 of n degrees of freedom has a standard deviation of sqrt(2 / n).
    assert abs(result.reduced_chi2 - 1) < 4 * np.sqrt(2 / result.degrees_of_freedom)
    assert np.isclose(result.chi2, chi2_by_hand(noisy, result.poses).sum())


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("fixed", [[], [4], [2, 5]])
def test_anchors_hold_still_and_are_named(method, fixed):
    graph = random_graph(2, 8, 10, seed=3, noise=0.05)
    graph = PoseGraph.from_arrays(
        graph.edges, graph.measurements, poses=graph.poses, ids=graph.ids, fixed=fixed
    )
    result = masat.optimize(graph, method)
    assert result.gauge.tolist() == (fixed or [0])
    assert np.allclose(result.poses[result.gauge], graph.poses[result.gauge], atol=1e-12)


def test_each_component_has_an_anchor():
    graph = PoseGraph.from_arrays(
        [(1, 2), (8, 9)],
        [(1, 0, 0), (0, 3, 0)],
        ids=[1, 2, 5, 8, 9],
        poses=np.zeros((5, 3)),
        fixed=[9],
    )
    result = masat.optimize(graph)
    assert result.gauge.tolist() == [1, 5, 9]
    assert np.allclose(result.poses, [(0, 0, 0), (1, 0, 0), (0, 0, 0), (0, -3, 0), (0, 0, 0)])


def test_where_all_is_fixed_nothing_is_done():
    graph = line(1, 1, 2.3, poses=np.zeros((3, 3)), fixed=[0, 1, 2])
    result = masat.optimize(graph)
    assert result.reason is StopReason.NOTHING_TO_DO
    assert result.iterations == 0
    assert np.isclose(result.chi2, 1 + 1 + 2.3**2)


def test_half_a_turn_is_turned_back():
    graph = PoseGraph.from_arrays([(3, 7)], [HALF_TURN], poses=[STILL, STILL])
    result = masat.optimize(graph, "gauss_newton")
    assert result.converged
    assert result.chi2 < 1e-12


def test_a_singular_system_is_reported_with_the_node():
    # Against its other edge, the edge to node 7 is zero to rounding.
    information = [1e-20 * np.eye(3), np.eye(3)]
    graph = PoseGraph.from_arrays(
        [(3, 7), (7, 9)], [(1, 0, 0), (1, 0, 0)], information, poses=np.zeros((3, 3))
    )
    result = masat.optimize(graph, "gauss_newton")
    assert result.reason is StopReason.SINGULAR
    assert not result.converged
    assert "node 7" in result.message or "node 9" in result.message
    assert "do not determine its pose" in result.message
    assert np.isfinite(result.poses).all()


def test_gauss_newton_that_ends_above_its_start_has_diverged():
    graph = masat.initialize(perturb(manhattan(), (0.35, 0.35, 0.35), seed=0), "given")
    result = masat.optimize(graph, "gauss_newton", max_iterations=1)
    climbed = result.history[-1].chi2 > result.initial_chi2
    assert result.reason is (StopReason.DIVERGED if climbed else StopReason.MAX_ITERATIONS)
    assert result.chi2 <= result.initial_chi2


def test_the_best_poses_are_returned_when_it_does_not_converge(data_dir):
    graph = masat.initialize(masat.read(data_dir / "2d/10kHog-man.txt.gz"), "odometry")
    result = masat.optimize(graph, "gauss_newton", max_iterations=2)
    assert not result.converged
    assert np.isclose(result.chi2, min([result.initial_chi2, *(h.chi2 for h in result.history)]))
    assert np.isclose(result.chi2, chi2_by_hand(graph, result.poses).sum())


def test_tolerances_stop_as_they_say():
    graph = masat.initialize(perturb(manhattan(500, 900, extent=14), (0.1, 0.1, 0.1)), "masat")
    loose = masat.optimize(graph, "gauss_newton", relative_tolerance=1e-2)
    tight = masat.optimize(graph, "gauss_newton", relative_tolerance=1e-12)
    assert loose.reason is StopReason.RELATIVE_CHANGE
    assert loose.iterations < tight.iterations
    before, after = loose.history[-2].chi2, loose.history[-1].chi2
    assert 0 <= (before - after) / after < 1e-2
    absolute = masat.optimize(graph, "gauss_newton", absolute_tolerance=1e3)
    assert absolute.reason is StopReason.ABSOLUTE_CHANGE
    gradient = masat.optimize(graph, "gauss_newton", gradient_tolerance=1e-3, relative_tolerance=0)
    assert gradient.reason is StopReason.GRADIENT


@pytest.mark.parametrize("method", ["levenberg_marquardt", "dogleg"])
def test_a_damped_method_never_climbs(method):
    graph = masat.initialize(perturb(manhattan(), (0.3, 0.3, 0.3), seed=1), "odometry")
    result = masat.optimize(graph, method, max_iterations=30)
    costs = [result.initial_chi2, *(h.chi2 for h in result.history)]
    assert (np.diff(costs) < 0).all()


@pytest.mark.parametrize("method", METHODS)
def test_history_tells_each_iteration_and_the_caller_can_stop(method):
    graph = masat.initialize(perturb(manhattan(500, 900, extent=14), (0.1, 0.1, 0.1)), "masat")
    seen = []
    result = masat.optimize(graph, method, report=seen.append)
    assert tuple(seen) == result.history
    assert all(h.step > 0 for h in result.history)
    assert (np.diff([h.seconds for h in result.history]) > 0).all()
    stopped = masat.optimize(graph, method, report=lambda h: True)
    assert stopped.reason is StopReason.INTERRUPTED
    assert stopped.iterations == 1


@pytest.mark.parametrize("method", METHODS)
def test_the_same_input_gives_the_same_numbers(method):
    graph = masat.initialize(perturb(manhattan(500, 900, extent=14), (0.1, 0.1, 0.1)), "masat")
    one, two = (masat.optimize(graph, method) for _ in range(2))
    assert (one.poses == two.poses).all()


def test_what_cannot_start_is_refused():
    graph = line(1, 1, 2)
    with pytest.raises(OptimizationError, match=r"no poses.*masat\.initialize"):
        masat.optimize(graph)
    guess = masat.initialize(graph, "masat")
    with pytest.raises(OptimizationError, match=r"'simplex'.*gauss_newton"):
        masat.optimize(guess, "simplex")
    with pytest.raises(OptimizationError, match="negative"):
        masat.optimize(guess, max_iterations=-1)
    far = graph.with_poses(np.array([(0, 0, 0), (1e200, 0, 0), (0, 0, 0)]))
    with pytest.raises(OptimizationError, match="not finite"):
        masat.optimize(far)


def test_a_saved_result_comes_back_whole(tmp_path):
    graph = random_graph(3, 10, 12, seed=6, noise=0.05)
    result = masat.optimize(graph)
    result.save(tmp_path / "r.npz")
    loaded = Result.load(tmp_path / "r.npz")
    for name in ("ids", "poses", "edges", "measurements", "information", "fixed"):
        assert (getattr(loaded.graph, name) == getattr(result.graph, name)).all()
    assert loaded.history == result.history
    assert loaded.reason is result.reason
    assert (loaded.chi2, loaded.method, loaded.message) == (
        result.chi2,
        result.method,
        result.message,
    )
    assert loaded.gauge.tolist() == result.gauge.tolist()


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 broken", b"VERTEX_SE2 0 0 0 0\n"])
def test_what_is_no_saved_result_is_refused(content, tmp_path):
    path = tmp_path / "r.npz"
    path.write_bytes(content)
    with pytest.raises(FormatError, match=r"r\.npz.*not a saved result"):
        Result.load(path)
