import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plain_masat import plain_masat, plain_most_informed_first
from random_graphs import random_graph

import masat
from masat import GraphError, InitializationError, MasatWarning, PoseGraph, lie
from masat.initializers import INITIALIZERS
from masat.worlds import manhattan

WALKS = [name for name in INITIALIZERS if name != "given"]
PLANAR = ["lago"]


def same_poses(a, b, tolerance=1e-9):
    return np.allclose(lie.local(a, b), 0, atol=tolerance)


@pytest.mark.parametrize(
    ("method", "plain"),
    [("masat", plain_masat), ("most_informed_first", plain_most_informed_first)],
)
@given(
    dimension=st.sampled_from([2, 3]),
    nodes=st.integers(2, 40),
    extra=st.integers(0, 80),
    seed=st.integers(0, 2**32),
    data=st.data(),
)
def test_a_walk_agrees_with_its_specification(method, plain, dimension, nodes, extra, seed, data):
    graph = random_graph(dimension, nodes, extra, seed)
    root = data.draw(st.integers(0, nodes - 1))
    guess = masat.initialize(graph, method, root=root)
    assert same_poses(guess.poses, plain(graph, root), 1e-6)


AUTHORS_2D = [
    ("M3500", "input_M3500_g2o.g2o"),
    ("city10000", "city10000.g2o"),
    ("10kHog-man", "10kHog-man.txt.gz"),
    ("INTEL_P_g2o", "INTEL_P_g2o.g2o"),
    ("FR079_P_g2o", "FR079_P_g2o.g2o"),
    ("MIT", "MIT.g2o"),
    ("CSAIL", "CSAIL.g2o"),
]


def half_a_printed_unit(printed):
    """Half a unit of the sixth significant digit."""
    magnitude = np.floor(np.log10(np.maximum(np.abs(printed), 1e-300)))
    return 0.5 * 10.0 ** (magnitude - 5) * (1 + 1e-6)


@pytest.mark.parametrize(("output", "source"), AUTHORS_2D)
def test_masat_equals_the_authors_program_in_2d(output, source, data_dir, reference_dir):
    theirs = masat.read(reference_dir / f"masat_{output}.g2o.gz")
    ours = masat.initialize(masat.read(data_dir / "2d" / source), "masat")
    assert (ours.ids == theirs.ids).all()
    assert (np.abs(ours.poses - theirs.poses) <= half_a_printed_unit(theirs.poses)).all()


@pytest.mark.parametrize("name", ["parking-garage.g2o", "sphere2500.g2o", "torus3D.g2o.gz"])
def test_masat_equals_the_authors_program_in_3d_where_two_proposals_meet(
    name, data_dir, reference_dir
):
    theirs = masat.read(
        reference_dir / f"masat_{name.removesuffix('.gz').removesuffix('.g2o')}.g2o.gz"
    )
    graph = masat.read(data_dir / "3d" / name)
    ours = masat.initialize(graph, "masat")
    untouched = places_without_three_proposals(graph)
    assert untouched.sum() >= 4
    sign = np.sign(np.einsum("ij,ij->i", ours.poses[:, 3:], theirs.poses[:, 3:]))[:, None]
    poses = np.hstack([ours.poses[:, :3], sign * ours.poses[:, 3:]])[untouched]
    expected = theirs.poses[untouched]
    # Their file's quaternions are normalized on reading, which moves the last printed digit.
    assert np.allclose(poses, expected, rtol=1e-5, atol=2e-6)


def places_without_three_proposals(graph):
    """Tell which nodes neither had three proposals nor inherit from one that had."""
    neighbors = [[] for _ in graph.ids]
    for a, b in graph.edge_indices:
        neighbors[a].append(b)
        neighbors[b].append(a)
    clean = np.zeros(len(graph.ids), bool)
    placed, seen, queue = set(), {0}, [0]
    for node in queue:
        ancestors = [v for v in neighbors[node] if v in placed]
        for v in neighbors[node]:
            if v not in seen:
                seen.add(v)
                queue.append(v)
        clean[node] = len(ancestors) <= 2 and all(clean[v] for v in ancestors)
        placed.add(node)
    return clean


def test_masat_places_a_node_at_the_mean_of_two_opinions():
    # 0 -> 1 -> 3 says (2, 0), 0 -> 2 -> 3 says (0, 2) turned by a quarter.
    graph = PoseGraph.from_arrays(
        [(0, 1), (0, 2), (1, 3), (2, 3)],
        [(1, 0, 0), (0, 1, 0), (1, 0, 0), (0, 1, np.pi / 2)],
    )
    guess = masat.initialize(graph, "masat")
    assert np.allclose(guess.poses, [(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, np.pi / 4)])


def test_headings_are_averaged_across_the_wrap():
    graph = PoseGraph.from_arrays([(0, 1), (0, 1)], [(0, 0, np.pi - 0.1), (0, 0, -np.pi + 0.3)])
    heading = masat.initialize(graph, "masat").poses[1, 2]
    assert np.isclose(heading, -np.pi + 0.1)


@pytest.mark.parametrize("q", [1.0, -1.0])
def test_quaternions_of_either_sign_mean_the_same_rotation(q):
    half = np.sqrt(0.5)
    turn = np.array([0, 0, 0, half, 0, 0, half])
    other = turn * np.array([1, 1, 1, q, q, q, q])
    graph = PoseGraph.from_arrays([(0, 1), (0, 1)], [turn, other])
    assert same_poses(masat.initialize(graph, "masat").poses[1], turn)


@pytest.mark.parametrize(
    ("method", "dimension"),
    [(name, d) for name in WALKS for d in (2, 3) if d == 2 or name not in PLANAR],
)
@pytest.mark.parametrize("root", [0, 7])
def test_without_noise_every_start_returns_the_truth(method, dimension, root):
    graph = random_graph(dimension, 30, 40, seed=5, noise=0.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MasatWarning)
        guess = masat.initialize(graph, method, root=root)
    assert same_poses(guess.poses, lie.between(graph.poses[root], graph.poses), 1e-10)


@pytest.mark.parametrize("method", WALKS)
def test_the_truth_of_a_manhattan_is_found_exactly(method):
    truth = manhattan(500, 800, extent=15, seed=3)
    assert same_poses(masat.initialize(truth, method).poses, truth.poses, 1e-9)


@pytest.mark.parametrize("method", WALKS)
def test_the_root_lies_at_the_identity(method):
    graph = random_graph(2, 10, 5, seed=1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MasatWarning)
        assert (masat.initialize(graph, method, root=4).poses[4] == 0).all()


@pytest.mark.parametrize("method", WALKS)
def test_each_component_gets_a_root_and_a_note(method):
    graph = PoseGraph.from_arrays([(1, 2), (8, 9)], [(1, 0, 0), (0, 3, 0)])
    with pytest.warns(MasatWarning, match=r"2 components.*roots 1, 8"):
        guess = masat.initialize(graph, method)
    assert np.allclose(guess.poses, [(0, 0, 0), (1, 0, 0), (0, 0, 0), (0, 3, 0)])
    assert any("2 components" in note for note in guess.notes)


@pytest.mark.parametrize("priors", [None, masat.gps([20, 21], [(5, 5), (5, 6)], 0.1)])
@pytest.mark.parametrize("method", WALKS)
def test_the_note_of_components_tells_which_have_a_frame_of_their_own(method, priors):
    graph = PoseGraph.from_arrays(
        [(1, 2), (8, 9), (20, 21)],
        [(1, 0, 0)] * 3,
        poses=[(k, 0, 0) for k in range(6)],
        fixed=[1, 8, 20],
        priors=priors,
    )
    with pytest.warns(MasatWarning, match="3 components, each placed by its fixed"):
        assert len(masat.initialize(graph, method).notes) == 1
    fewer = graph.with_fixed([] if priors else 20)
    message = r"3 components, 1 placed by fixed nodes or priors, .* from the roots 1, 8:"
    with pytest.warns(MasatWarning, match=message):
        masat.initialize(fewer, method)


@pytest.mark.parametrize("method", WALKS)
def test_a_root_serves_its_own_component(method):
    graph = PoseGraph.from_arrays([(1, 2), (8, 9)], [(1, 0, 0), (0, 3, 0)])
    with pytest.warns(MasatWarning):
        guess = masat.initialize(graph, method, root=9)
    assert np.allclose(guess.poses, [(0, 0, 0), (1, 0, 0), (0, -3, 0), (0, 0, 0)])


@pytest.mark.parametrize("method", WALKS)
def test_fixed_nodes_keep_their_poses_and_are_the_roots(method):
    graph = PoseGraph.from_arrays(
        [(0, 1), (1, 2), (2, 3)],
        [(1, 0, 0)] * 3,
        poses=[(9, 9, 9), (5, 5, np.pi / 2), (7, 7, 7), (5, 9, 0)],
        fixed=[1, 3],
    )
    poses = masat.initialize(graph, method).poses
    assert np.allclose(poses[[0, 1, 3]], [(5, 4, np.pi / 2), (5, 5, np.pi / 2), (5, 9, 0)])


def test_a_root_beside_fixed_nodes_is_refused():
    graph = PoseGraph.from_arrays([(0, 1)], [(1, 0, 0)], fixed=[0])
    with pytest.raises(GraphError, match="root 1 is not fixed"):
        masat.initialize(graph, "masat", root=1)
    assert (masat.initialize(graph, "masat", root=0).poses[0] == 0).all()


def test_odometry_follows_the_chain_and_not_a_shorter_way():
    graph = PoseGraph.from_arrays([(0, 1), (1, 2), (0, 2)], [(1, 0, 0), (1, 0, 0), (5, 0, 0)])
    assert masat.initialize(graph, "odometry").poses[2, 0] == 2
    assert masat.initialize(graph, "spanning_tree").poses[2, 0] == 5


def test_odometry_counts_neighbors_in_a_list_with_gaps_as_consecutive():
    graph = PoseGraph.from_arrays([(10, 20), (20, 40), (10, 40)], [(1, 0, 0), (1, 0, 0), (5, 0, 0)])
    assert masat.initialize(graph, "odometry").poses[2, 0] == 2


def test_a_broken_odometry_chain_is_bridged_and_reported():
    # Pieces 0-1 and 2-3, joined by 0 -> 3.
    graph = PoseGraph.from_arrays([(0, 1), (2, 3), (0, 3)], [(1, 0, 0), (1, 0, 0), (0, 4, 0)])
    with pytest.warns(MasatWarning, match="chain is broken: 1 other edges.*0 -> 3"):
        guess = masat.initialize(graph, "odometry")
    assert np.allclose(guess.poses, [(0, 0, 0), (1, 0, 0), (-1, 4, 0), (0, 4, 0)])


@pytest.mark.parametrize(
    ("name", "bridges"), [("2d/ais2klinik.g2o", 1), ("3d/stonewall.g2o", 2), ("3d/cubicle.g2o", 1)]
)
def test_real_broken_chains_are_bridged(name, bridges, data_dir):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MasatWarning)
        graph = masat.read(data_dir / name, indefinite="identity")
        guess = masat.initialize(graph, "odometry")
    (note,) = [n for n in guess.notes if "chain is broken" in n]
    assert int(note.split(":")[1].split()[0]) >= bridges
    assert np.isfinite(guess.poses).all()


def test_given_keeps_the_poses_and_refuses_where_there_are_none():
    graph = random_graph(2, 4, 2, seed=0)
    assert (masat.initialize(graph, "given").poses == graph.poses).all()
    bare = PoseGraph.from_arrays(graph.edges, graph.measurements)
    with pytest.raises(InitializationError, match="no poses of its own"):
        masat.initialize(bare, "given")
    rooted = masat.initialize(graph, "given", root=1)
    assert (rooted.poses == graph.poses).all()
    assert rooted.gauge.tolist() == [1]


def test_unknown_methods_and_roots_are_refused():
    graph = random_graph(2, 4, 2, seed=0)
    with pytest.raises(InitializationError, match=r"unknown initial guess 'magic'.*masat"):
        masat.initialize(graph, "magic")
    with pytest.raises(GraphError, match="no node 99"):
        masat.initialize(graph, "masat", root=99)


@pytest.mark.parametrize("method", WALKS)
def test_a_guess_is_the_same_each_time_and_leaves_the_graph_alone(method):
    graph = manhattan(200, 300, extent=10, seed=1)
    before = graph.poses.copy()
    one, two = (masat.initialize(graph, method) for _ in range(2))
    assert (one.poses == two.poses).all()
    assert (graph.poses == before).all()
