import numpy as np
import pytest
from test_optimizers import BEST
from test_relaxation import isotropic, ring, twisted

import masat
from masat import OptimizationError, PoseGraph, certify
from masat.worlds import perturb, sphere


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


def test_without_lifting_a_local_minimum_stays_undecided():
    proof = certify(ring(12).with_poses(twisted(ring(12))), lift=False)
    assert not proof.certified
    assert proof.message.startswith("not decided")
    assert proof.better is None


def test_in_3d_with_isotropic_information_the_proof_is_of_chi2_itself():
    graph = isotropic(perturb(sphere(200, seed=0), [0.05] * 6, seed=0))
    result = masat.optimize(masat.initialize(graph, "masat"))
    proof = certify(result.graph)
    assert proof.certified
    assert proof.exact
    assert np.isclose(proof.cost, result.chi2, rtol=1e-6)
    assert proof.gap < 1e-6


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
    assert certify(masat.initialize(PoseGraph.from_arrays([], np.zeros((0, 3)), ids=[7]), "masat")).certified


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
    assert proof.cost - proof.bound <= 1e-6 * proof.cost + 1e-9
