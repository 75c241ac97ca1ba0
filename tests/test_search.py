"""Ways from a minimum to lower ones: only the doubtful parts are lifted and shifted."""

import itertools

import numpy as np
import pytest
from random_graphs import random_graph
from test_cycles import ring as polygon
from test_relaxation import ring, twisted

import masat
from masat import InitializationError, OptimizationError, PoseGraph
from masat.optimality import relaxation
from masat.optimality import search as searching
from masat.optimality.relaxation import Relaxation, lift
from masat.optimality.search import lower_minimum
from masat.optimality.subgraphs import connected_parts, neighborhood, subgraph, whole
from masat.optimality.trials import shifted_along
from masat.optimizers.equations import normal_equations
from masat.progress import Progress
from masat.residuals import residuals
from masat.study.names import Case
from masat.study.trial import initial_guess, instance

CHAIN = 30


def two_rings(first_twisted=True, second_twisted=True):
    """Two rings of twelve nodes on one spot, a chain of thirty nodes between them."""
    one = ring(12)
    last = 12 + CHAIN
    chain = [(k, k + 1) for k in range(12, last)]
    edges = [*one.edges, (0, 12), *chain, *(one.edges + last)]
    poses = np.zeros((24 + CHAIN, 3))
    if first_twisted:
        poses[:12] = twisted(one)
    if second_twisted:
        poses[last:] = twisted(one)
    return PoseGraph.from_arrays(edges, np.zeros((len(edges), 3)), poses=poses, fixed=[20])


def mask(count, nodes):
    out = np.zeros(count, np.bool_)
    out[nodes] = True
    return out


def search_of(graph):
    return searching._Search(graph, 0, Progress(), normal_equations(graph))


def test_the_neighborhood_in_a_chain():
    chain = PoseGraph.from_arrays([(k, k + 1) for k in range(9)], np.zeros((9, 3)))
    assert np.flatnonzero(neighborhood(chain, mask(10, [4]))).tolist() == [3, 4, 5]
    assert np.flatnonzero(neighborhood(chain, mask(10, [0, 7]), 2)).tolist() == [
        *(0, 1, 2, 5, 6, 7, 8, 9)
    ]
    part = subgraph(chain, np.arange(30.0).reshape(10, 3), mask(10, [4, 5]))
    assert part.graph.ids.tolist() == part.nodes.tolist() == [3, 4, 5, 6]
    assert part.graph.fixed.tolist() == [3, 6]
    assert part.edges.tolist() == [3, 4, 5]
    assert part.inside.tolist() == [False, True, True, False]
    assert part.graph.poses[:, 0].tolist() == [9, 12, 15, 18]
    everything = whole(chain, np.arange(30.0).reshape(10, 3))
    assert np.flatnonzero(~everything.inside).tolist() == [0]
    assert everything.edges.tolist() == list(range(9))


def test_nodes_without_edges_have_no_neighbors():
    alone = PoseGraph.from_arrays([], np.zeros((0, 3)), ids=[3, 5], poses=np.zeros((2, 3)))
    assert neighborhood(alone, mask(2, [1])).tolist() == [False, True]


def test_the_certificate_fails_at_the_twisted_ring():
    graph = two_rings(second_twisted=False)
    nodes = Relaxation(graph).uncertified_nodes(graph.poses)
    assert len(nodes) > 0
    assert nodes.max() < 12
    straight = two_rings(first_twisted=False, second_twisted=False)
    assert len(Relaxation(straight).uncertified_nodes(straight.poses)) == 0


def test_each_of_two_uncertified_nodes_is_told():
    graph = two_rings()
    nodes = Relaxation(graph).uncertified_nodes(graph.poses)
    assert nodes.min() < 12
    assert nodes.max() >= 12 + CHAIN
    assert np.all((nodes < 12) | (nodes >= 12 + CHAIN))


def test_parts_of_a_chain():
    chain = PoseGraph.from_arrays([(k, k + 1) for k in range(9)], np.zeros((9, 3)))
    parts = [
        np.flatnonzero(part).tolist() for part in connected_parts(chain, mask(10, [0, 4, 5, 7]))
    ]
    assert parts == [[0], [4, 5], [7]]
    assert list(connected_parts(chain, mask(10, []))) == []


def test_each_uncertified_part_is_lifted_by_itself():
    graph = two_rings()
    search = search_of(graph)
    before = search.poses
    assert search.at_uncertified_nodes()
    away = np.arange(12 + 7, 12 + CHAIN - 7)
    assert np.array_equal(search.poses[away], before[away])
    assert np.allclose(np.sin(search.poses[:, 2]), 0, atol=1e-4)
    assert np.allclose(np.cos(search.poses[:, 2]), 1, atol=1e-4)


def test_a_good_map_has_no_uncertified_nodes():
    best = masat.optimize(random_graph(2, 30, 60, seed=1, noise=0.02)).graph
    search = search_of(best)
    converged = search.poses
    assert not search.at_uncertified_nodes()
    assert not search.at_cycles(search.doubtful_nodes())
    assert search.poses is converged


def counting_lifts(search, monkeypatch):
    """Let lifts find nothing, and return the list of the parts that are lifted."""
    lifted = []

    def in_vain(part, above):
        lifted.append(part)
        return masat.optimize(part.graph)

    monkeypatch.setattr(search, "_lift", in_vain)
    return lifted


def test_what_was_lifted_in_vain_is_lifted_again_where_it_has_changed(monkeypatch):
    best = masat.optimize(random_graph(2, 30, 60, seed=1, noise=0.02)).graph
    search = search_of(best)
    lifted = counting_lifts(search, monkeypatch)
    assert not search._lift_if_new(mask(30, [4, 5, 6]))
    assert not search._lift_if_new(mask(30, [4, 5, 6]))
    assert not search._lift_if_new(mask(30, [5]))
    assert len(lifted) == 1
    assert not search._lift_if_new(mask(30, [5, 7]))
    assert len(lifted) == 2
    search.lowest.poses = best.poses.copy()
    search.lowest.poses[5] += 1
    assert search._lift_if_new(mask(30, [5]))
    assert len(lifted) == 3


def test_where_most_nodes_are_to_be_lifted_all_are_but_splices_stay_within_their_part(monkeypatch):
    best = masat.optimize(random_graph(2, 30, 60, seed=1, noise=0.02)).graph
    search = search_of(best)
    lifted = counting_lifts(search, monkeypatch)
    most = mask(30, range(5, 25))
    search._lift_if_new(most)
    assert np.flatnonzero(~lifted[0].inside).tolist() == [0]
    search.lowest.attempt(most, search._lift, widen=False)
    assert lifted[1].nodes[lifted[1].inside].tolist() == list(range(5, 25))


def test_a_map_is_refuted_where_the_certificate_fails_by_much():
    twisted = two_rings(second_twisted=False)
    assert len(Relaxation(twisted).refuted_nodes(twisted.poses)) > 0
    straight = two_rings(first_twisted=False, second_twisted=False)
    assert len(Relaxation(straight).refuted_nodes(straight.poses)) == 0


def test_what_a_lift_makes_worse_stays(monkeypatch):
    """Each connected part for itself: only where chi2 falls do its poses count."""
    graph = two_rings(second_twisted=False)

    def worse_at_the_second(part, *, seed):
        poses = part.poses.copy()
        poses[part.ids < 12, 2] = 0
        poses[part.ids >= 12 + CHAIN] = twisted_again[part.ids[part.ids >= 12 + CHAIN]]
        return poses

    twisted_again = two_rings().poses
    monkeypatch.setattr("masat.optimality.trials.lift", worse_at_the_second)
    monkeypatch.setattr(
        Relaxation, "uncertified_nodes", lambda *_: np.array([3, 12 + CHAIN + 3], np.int32)
    )
    search = search_of(graph)
    assert search.at_uncertified_nodes()
    assert np.allclose(search.poses[:, 2], 0, atol=1e-6)


def test_a_trial_that_ends_where_it_began_is_none():
    graph = masat.optimize(random_graph(2, 30, 60, seed=1, noise=0.02)).graph
    search = search_of(graph)
    begun = search.poses
    everything = np.ones(len(graph.ids), np.bool_)
    assert not search.lowest.attempt(everything, search._lift)
    assert search.poses is begun


@pytest.mark.parametrize(
    ("dimension", "axis"), [(2, None), (3, (0, 0, 1)), (3, (1, 0, 0)), (3, (0.6, 0.0, 0.8))]
)
def test_a_lift_takes_all_turns_back(dimension, axis):
    local = masat.optimize(polygon(24, dimension, axis, turns=1))
    assert local.chi2 > 40
    poses = lift(local.graph)
    assert masat.optimize(local.graph.with_poses(poses)).chi2 < 1e-6


def test_without_memory_for_a_lift_the_poses_stay(monkeypatch):
    monkeypatch.setattr(relaxation, "_MAX_FACTOR_BYTES", 0)
    graph = random_graph(2, 20, 40, seed=2, noise=0.1)
    assert lift(graph) is graph.poses


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("dimension", [2, 3])
def test_a_search_never_ends_higher_and_fixed_nodes_keep_their_poses(dimension, seed):
    graph = random_graph(dimension, 40, 50, seed=seed, noise=0.4)
    start = masat.optimize(masat.initialize(graph, "spanning_tree")).graph
    poses = start.poses.copy()
    # Another name of the same pose: it must not be changed for the usual one.
    poses[7] = poses[7] + [0, 0, 2 * np.pi] if dimension == 2 else poses[7] * ([1] * 3 + [-1] * 4)
    fixed = PoseGraph.from_arrays(
        graph.edges, graph.measurements, graph.information, poses=poses, fixed=[3, 7, 11]
    )
    before = masat.optimize(fixed)
    found = lower_minimum(before.graph)
    assert found.chi2 <= before.chi2 * (1 + 1e-9)
    assert np.array_equal(found.graph.poses[[3, 7, 11]], poses[[3, 7, 11]])
    again = lower_minimum(before.graph)
    assert np.array_equal(again.graph.poses, found.graph.poses)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("dimension", [2, 3])
def test_the_search_knows_the_chi2_of_its_poses(dimension, seed):
    graph = random_graph(dimension, 40, 50, seed=seed, noise=0.4)
    start = masat.optimize(masat.initialize(graph, "spanning_tree")).graph
    search = search_of(start)
    search.at_uncertified_nodes()
    search.at_cycles(search.doubtful_nodes())
    true = masat.optimize(graph.with_poses(search.poses), max_iterations=0).chi2
    assert np.isclose(search.chi2, true, rtol=1e-9)


def test_a_unit_of_chi2_is_one_or_what_the_graph_shows():
    for noise in (0.001, 0.4):
        graph = masat.optimize(random_graph(2, 30, 60, seed=1, noise=noise)).graph
        reduced = masat.optimize(graph).reduced_chi2
        search = search_of(graph)
        assert np.isclose(search.lowest.unit, min(1.0, reduced))
    tree = PoseGraph.from_arrays([(0, 1)], np.zeros((1, 3)), poses=np.zeros((2, 3)))
    assert search_of(tree).lowest.unit == 1.0


def test_a_part_that_cannot_be_lifted_stays(monkeypatch):
    def impossible(*_, **__):
        raise InitializationError("the edges around node 1 do not determine it")

    graph = two_rings()
    monkeypatch.setattr("masat.optimality.trials.lift", impossible)
    search = search_of(graph)
    before = search.poses
    assert not search.at_uncertified_nodes()
    assert search.poses is before


def test_without_poses_there_is_no_minimum():
    with pytest.raises(OptimizationError, match="no poses"):
        lower_minimum(PoseGraph.from_arrays([(0, 1)], np.zeros((1, 3))))


def test_no_place_is_lost_where_a_pivot_is_hardly_one():
    """Just beyond the shift at which another node breaks first, a first hold is not enough."""
    both = two_rings()
    information = both.information.copy()
    information[:12] /= 2
    graph = PoseGraph.from_arrays(
        both.edges, both.measurements, information, poses=both.poses, fixed=[20]
    )
    relaxed = Relaxation(graph)

    def tell(share):
        return relaxed._free[relaxed._failing(graph.poses, share)]

    low, high = 0.01, 0.05
    first = tell(low)[0]
    assert tell(high)[0] != first
    while high - low > 1e-14:
        middle = (low + high) / 2
        low, high = (middle, high) if tell(middle)[0] == first else (low, middle)
    for share in high * (1 + np.geomspace(1e-12, 1e-3, 40)):
        nodes = tell(share)
        assert nodes.min() < 12
        assert nodes.max() >= 12 + CHAIN


@pytest.mark.parametrize(
    "name",
    [
        "City10k/.35,.35,.35/8",
        "City10k/.35,.35,.35/15",
        "City10k/.35,.35,.35/42",
        "Manhattan10000/.2,.2,.2/40",
        "Manhattan10000/.35,.35,.35/17",
        "Manhattan3500/.35,.35,.35/28",
        "Manhattan3500/.15,.15,.3/34",
    ],
)
def test_search_of_the_study_are_left(name, data_dir, monkeypatch):
    monkeypatch.setenv("MASAT_DATASETS", str(data_dir))
    world, sigma, number = name.split("/")
    graph = instance(Case(world, tuple(map(float, sigma.split(","))), int(number)))
    control = masat.optimize(graph)
    local = masat.optimize(initial_guess(graph, "chordal"))
    assert local.chi2 > control.chi2 * (1 + 5e-6)
    assert lower_minimum(local.graph).chi2 <= control.chi2 * (1 + 1e-6)


@pytest.mark.parametrize(
    "name",
    [
        "M3500_0.35_0.35_0.35_9002",
        "blobs225_200_3_0.1_0.2_23",
        "blobs225_400_3_0.1_0.1_31",
        "blobs400_100_3_0.1_0.2_12",
        "loop_corridor3000_0.1_0.1_26",
        "sphere500_iso_0.5_0.5_1",
        "star10x100_0.1_0.2_1",
    ],
)
def test_the_best_known_minima_of_hard_graphs_are_found(name, data_dir):
    path = data_dir / "hard_minima" / f"{name}.g2o.gz"
    if not path.exists():
        pytest.skip("needs the graphs in hard_minima")
    graph = masat.read(path)
    best = 30.486929
    if not name.startswith("star"):
        best = masat.read(path.with_name(f"{name}_best.g2o.gz")).chi2
    assert masat.solve(graph).chi2 <= best * (1 + 1e-6)


@pytest.mark.filterwarnings("ignore::masat.MasatWarning")
@pytest.mark.parametrize("seed", [89, 953, 1547])
def test_shifted_edges_between_fixed_nodes_are_left_out(seed):
    # Weights of many decades: nodes at both ends of a shifted edge may be fixed in its part.
    rng = np.random.default_rng(seed)
    nodes, extra = int(rng.integers(3, 12)), int(rng.integers(1, 14))
    noise = float(rng.uniform(0.2, 1.5)) if seed % 3 else None
    graph = random_graph(2, nodes, extra, seed, noise=noise)
    m, span = len(graph.edges), rng.uniform(0, 6)
    information = np.zeros((m, 3, 3))
    information[:, 0, 0] = information[:, 1, 1] = 10 ** rng.uniform(-span, span, m)
    information[:, 2, 2] = 10 ** rng.uniform(-span, span, m)
    measurements, poses = graph.measurements.copy(), graph.poses.copy()
    measurements[:, :2] *= 1000
    poses[:, :2] *= 1000
    graph = PoseGraph.from_arrays(
        graph.edges, measurements, information, ids=graph.ids, poses=poses
    )
    near = masat.optimize(graph, relative_tolerance=1e-9).graph
    assert lower_minimum(near).chi2 <= near.chi2 * (1 + 1e-9)


@pytest.mark.parametrize("cheap", [False, True])
def test_ever_more_is_lifted_around_a_refuted_node(monkeypatch, cheap):
    chain = PoseGraph.from_arrays(
        [(k, k + 1) for k in range(299)], np.zeros((299, 3)), poses=np.zeros((300, 3)), fixed=[0]
    )
    search = search_of(chain)
    lifted = counting_lifts(search, monkeypatch)
    limit = np.inf if cheap else 0.0
    monkeypatch.setattr(searching, "_MAX_LIFTED_OPERATIONS", limit)
    monkeypatch.setattr(Relaxation, "uncertified_nodes", lambda *_: np.array([50, 150], np.int32))
    monkeypatch.setattr(Relaxation, "refuted_nodes", lambda *_: np.array([150], np.int32))
    assert not search.at_wider_parts()
    sizes = [np.count_nonzero(part.inside) for part in lifted]
    # The first around both nodes; that of 12 edges around the refuted one has been lifted already.
    assert sizes == [25, 25, 49, 97, *([299] if cheap else [])]


def test_no_large_part_is_lifted_around_a_node_that_is_only_uncertified(monkeypatch):
    chain = PoseGraph.from_arrays(
        [(k, k + 1) for k in range(99)], np.zeros((99, 3)), poses=np.zeros((100, 3)), fixed=[0]
    )
    search = search_of(chain)
    lifted = counting_lifts(search, monkeypatch)
    monkeypatch.setattr(Relaxation, "uncertified_nodes", lambda *_: np.array([50], np.int32))
    monkeypatch.setattr(Relaxation, "refuted_nodes", lambda *_: np.zeros(0, np.int32))
    assert not search.at_wider_parts()
    assert lifted == []


def test_a_shift_unwinds_a_chain_that_begins_and_ends_at_a_block():
    side, length = 22, 40
    y, x = np.divmod(np.arange(side * side), side)
    block = np.column_stack([x, y, np.zeros(side * side)])
    index = np.arange(side * side).reshape(side, side)
    edges = [*zip(index[:, :-1].ravel(), index[:, 1:].ravel(), strict=True)]
    edges += zip(index[:-1].ravel(), index[1:].ravel(), strict=True)
    new = side * side + np.arange(length)
    chain = np.column_stack(
        [np.linspace(0, side - 1, length + 2)[1:-1], np.full((2, length), 0.0).T]
    )
    chain[:, 1] = -2.0
    poses = np.concatenate([block, chain])
    walk = [0, *new, side - 1]
    edges += itertools.pairwise(walk)
    ends = np.array(edges)
    z = masat.lie.between(poses[ends[:, 0]], poses[ends[:, 1]])
    graph = PoseGraph.from_arrays(ends, z, poses=poses, fixed=[0])
    wound = poses.copy()
    wound[new, 2] += 2 * np.pi * np.arange(1, length + 1) / (length + 1)
    local = masat.optimize(graph.with_poses(wound), "dogleg").graph
    assert local.chi2 > 0.5
    last, residual = len(ends) - 1, residuals(local)[-1, 2]
    by = np.array([[-2 * np.pi * np.sign(residual)]])
    part = whole(local, local.poses)
    found = shifted_along(part, 0.0, np.array([last]), by, None, 1.0)
    assert found.chi2 < 1e-2
