import numpy as np
import pytest
from random_graphs import random_graph, random_poses
from test_optimizers import BEST
from test_relaxation import isotropic, ring, twisted

import masat
from masat import OptimizationError, PoseGraph, certify, lie
from masat.optimality.bounds import TIGHT, chi2_bound, doubtful_nodes
from masat.worlds import manhattan, perturb, sphere


def test_a_local_minimum_is_refuted_by_a_better_one():
    proof = certify(ring(12).with_poses(twisted(ring(12))))
    assert not proof.certified
    assert proof.message.startswith("not optimal: another minimum has chi2")
    assert np.isclose(proof.chi2, 12 * (np.pi / 6) ** 2)
    assert proof.optimum < 1e-9
    assert np.allclose(proof.better.poses, 0, atol=1e-6)


def test_poses_beside_their_minimum_are_refuted_by_it():
    graph = ring(5).with_poses(np.random.default_rng(0).normal(scale=0.1, size=(5, 3)))
    proof = certify(graph)
    assert not proof.certified
    assert proof.optimum < proof.chi2
    assert certify(proof.better).certified


def test_without_a_search_a_local_minimum_stays_undecided():
    proof = certify(ring(12).with_poses(twisted(ring(12))), search=False)
    assert proof.status == "undecided"
    assert not proof.certified
    assert proof.message.startswith("not decided")
    assert proof.better is None
    assert proof.bound < proof.chi2


@pytest.mark.parametrize(("world", "sigma"), [(manhattan, [0.05] * 3), (sphere, [0.05] * 6)])
@pytest.mark.parametrize("kind", ["isotropic", "uncoupled", "coupled"])
def test_chi2_itself_is_certified_for_any_information(world, sigma, kind):
    rng = np.random.default_rng(1)
    graph = perturb(world(200, seed=0), sigma, seed=0)
    if kind != "isotropic":
        d, count = graph.dimension, len(graph.edges)
        # Standard deviations between half and twice the noise, and correlations up to one half.
        scale = rng.uniform(0.7, 1.4, (count, graph.dof)) / 0.05
        w = scale[:, :, None] * scale[:, None] * np.eye(graph.dof)
        if kind == "coupled":
            near = 0.5 * rng.uniform(-1, 1, count) * scale[:, 0] * scale[:, d]
            w[:, 0, d] = w[:, d, 0] = near
        graph = PoseGraph.from_arrays(graph.edges, graph.measurements, w)
    result = masat.solve(graph, certify=True)
    proof = result.certificate
    assert proof.status == "optimal"
    assert proof.chi2 == pytest.approx(result.chi2, rel=1e-12)
    assert 0 <= proof.gap < 1e-6


FALSE = "false_certificates"


@pytest.mark.parametrize(
    "name",
    ["false_certificate_2d", "false_certificate_3d", "false_101_423_auto_certified",
     "false_202_167_auto_certified"],
)  # fmt: skip
@pytest.mark.parametrize("search", [False, True])
def test_minima_that_were_once_certified_falsely_are_not(name, search, data_dir):
    graph = masat.read(data_dir / FALSE / f"{name}.g2o")
    proof = certify(graph, search=search)
    assert not proof.certified
    assert proof.bound < proof.chi2 * (1 - 1e-6)


def test_a_stiff_ring_at_its_truth_is_certified(data_dir):
    truth = masat.read(data_dir / FALSE / "false_certificate_3d_truth.g2o")
    assert certify(truth).certified


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("seed", range(15))
def test_no_poses_lie_below_a_bound(dimension, seed):
    """Small graphs with strong noise and any information, against many random restarts."""
    rng = np.random.default_rng(seed)
    graph = random_graph(dimension, 8, 14, seed=seed, noise={2: 0.8, 3: 0.4}[dimension])
    half = rng.normal(size=(len(graph.edges), graph.dof, graph.dof))
    w = half @ half.transpose(0, 2, 1) + 0.5 * np.eye(graph.dof)
    graph = PoseGraph.from_arrays(graph.edges, graph.measurements, w, poses=graph.poses)
    proof = certify(masat.solve(graph).graph)
    lowest = min(
        masat.optimize(
            graph.with_poses(lie.retract(graph.poses, rng.normal(size=(8, graph.dof))))
        ).chi2
        for _ in range(20)
    )
    assert proof.bound <= lowest * (1 + 1e-9)
    if proof.certified:
        assert lowest >= proof.chi2 * (1 - 1e-6)


@pytest.mark.parametrize(("make", "sigma", "seed"), [(manhattan, 0.3, 0), (sphere, 0.4, 1)])
def test_a_better_map_keeps_the_fixed_nodes_where_they_are(make, sigma, seed):
    world = make(200, seed=1)
    graph = perturb(world, [sigma] * world.dof, seed=seed).with_fixed([3, 150])
    local = masat.optimize(masat.initialize(graph, "odometry"), "levenberg_marquardt").graph
    found = certify(local)
    assert found.status == "refuted"
    assert np.allclose(found.better.poses[[3, 150]], graph.poses[[3, 150]], rtol=0, atol=1e-12)


@pytest.mark.parametrize("dimension", [2, 3])
def test_with_doubtful_nodes_fixed_a_minimum_is_certified(dimension):
    met = 0
    for seed in range(20):
        graph = isotropic(random_graph(dimension, 12, 4, seed=seed, noise=0.6))
        start = graph.with_poses(random_poses(dimension, 12, np.random.default_rng(seed)))
        local = masat.optimize(start, "levenberg_marquardt", relative_tolerance=1e-14).graph
        doubtful = doubtful_nodes(local)
        if len(doubtful) == 12:
            continue  # nothing touches chi2 at a residual of half a turn
        met += len(doubtful) > 0
        held = local.with_fixed([*local.gauge, *local.ids[doubtful]])
        assert chi2_bound(held, held.chi2) >= held.chi2 * (1 - TIGHT)
    assert met >= 3


@pytest.mark.parametrize("information", [1e-15, 1.0, 1e12])
def test_the_scale_of_the_information_does_not_matter(information):
    poses = np.random.default_rng(0).normal(scale=0.1, size=(5, 3))
    graph = PoseGraph.from_arrays(
        ring(5).edges, np.zeros((5, 3)), information * np.eye(3), poses=poses
    )
    proof = certify(graph)
    assert not proof.certified
    assert certify(proof.better).certified


def test_a_chain_is_certified():
    chain = PoseGraph.from_arrays([(0, 1), (1, 2)], [(1, 0, 0.3)] * 2)
    assert certify(masat.initialize(chain, "masat")).certified


def test_a_single_node_is_certified():
    assert certify(
        masat.initialize(PoseGraph.from_arrays([], np.zeros((0, 3)), ids=[7]), "masat")
    ).certified


def test_a_graph_without_poses_has_nothing_to_certify():
    with pytest.raises(OptimizationError, match="nothing to certify"):
        certify(ring(4))


@pytest.mark.filterwarnings("ignore::masat.MasatWarning")
@pytest.mark.parametrize(("name", "best"), BEST.items())
def test_real_graphs_are_solved_and_certified(name, best, data_dir):
    guess = masat.initialize(masat.read(data_dir / name, indefinite="identity"), "auto")
    result = masat.optimize(guess, "gauss_newton")
    assert result.chi2 <= best * (1 + 1e-6)
    proof = certify(result.graph)
    assert proof.certified
    assert proof.chi2 - proof.bound <= 1e-6 * proof.chi2 + 1e-15


def test_what_cannot_be_optimized_is_undecided():
    """Information of condition 1e14, beyond what a factorization can bear."""
    edges = [(k, k + 1) for k in range(6)] + [(6, 0)]
    w = np.tile(np.diag([1e14, 1.0, 1.0]), (7, 1, 1))
    w[3] = np.diag([1.0, 1e-14, 1.0])
    rng = np.random.default_rng(0)
    graph = PoseGraph.from_arrays(edges, rng.normal(size=(7, 3)), w, poses=rng.normal(size=(7, 3)))
    assert certify(graph).status in ("undecided", "refuted")


def test_a_certificate_shows_itself():
    proof = certify(masat.initialize(ring(4), "masat"))
    assert repr(proof).startswith("Certificate(optimal")
    assert "optimal" in proof._repr_html_()
    assert proof.to_dict()["certified"] is True
