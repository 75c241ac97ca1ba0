import threading

import numpy as np
import pytest
from random_graphs import random_graph, random_poses

import masat
from masat import GraphError, InformationError, OnlineMap, OptimizationError, lie, worlds

SQUARE = [((k, (k + 1) % 4), (1, 0, 1.6)) for k in range(4)]


def batch(graph):
    """The batch solver's optimum from the poses of a graph."""
    return masat.optimize(graph, relative_tolerance=1e-14, max_iterations=200)


def at_linearization(world):
    """The graph of a map at the poses at which its edges are linearized."""
    own = world.graph()
    return own.with_poses(world._core.linearized(world._core.find_all(own.ids)))


def state(world):
    """What a failure must not change."""
    graph = world.graph() if len(world) else None
    edges = 0 if graph is None else len(graph.edges)
    return world.ids.tolist(), world.poses.tolist(), world.chi2, edges


def square(**options):
    world = OnlineMap(2, **options)
    for k in range(4):
        world.add_pose(k)
    for pair, z in SQUARE:
        world.add_edges(pair, z)
    world.update()
    return world


def feed(world, graph, *, at_once=1):
    """Add the nodes of a graph in order of their ids, each with its edges to earlier ones."""
    newer = graph.edges.max(axis=1)
    for k, node in enumerate(graph.ids):
        world.add_pose(int(node))
        rows = np.flatnonzero(newer == node)
        if len(rows):
            world.add_edges(graph.edges[rows], graph.measurements[rows], graph.information[rows])
        if k % at_once == at_once - 1:
            world.update()
    world.update()


def test_dead_reckoning_is_exact():
    world = OnlineMap(2)
    world.add_pose(7, (1, 2, np.pi / 2))
    world.add_pose(8)
    world.add_pose(9)
    numbers = [world.add_edges((7, 8), (1, 0, 0)), world.add_edges((9, 8), (-1, 0, 0))]
    done = world.update()
    assert [n.tolist() for n in numbers] == [[0], [1]]
    assert done.complete
    assert done.chi2 < 1e-20
    assert world.ids.tolist() == [7, 8, 9]
    assert np.allclose(world.poses, [(1, 2, np.pi / 2), (1, 3, np.pi / 2), (1, 4, np.pi / 2)])
    assert np.allclose(world.pose(9), (1, 4, np.pi / 2))


def test_two_measurements_meet_at_their_weighted_mean():
    world = OnlineMap(2, tolerance=0)
    world.add_pose(0)
    world.add_pose(1)
    world.add_edges([(0, 1), (0, 1)], [(1, 0, 0), (4, 0, 0)], [2 * np.eye(3), np.eye(3)])
    assert world.update().chi2 == pytest.approx(2 * 1 + 1 * 4)
    assert np.allclose(world.pose(1), (2, 0, 0))
    assert np.allclose(world.covariances([1]), np.eye(3) / 3)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("seed", range(4))
def test_same_optimum_as_the_batch_solver(dimension, seed):
    graph = random_graph(dimension, 60, 50, seed, noise=0.02)
    world = OnlineMap(dimension, tolerance=0)
    feed(world, graph, at_once=1 + seed)
    own = world.graph()
    expected = batch(own)
    assert own.chi2 == pytest.approx(expected.chi2, rel=1e-9)
    assert np.abs(lie.local(expected.poses, own.poses)).max() < 1e-5


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("seed", range(5))
def test_any_order_of_additions_and_removals(dimension, seed):
    """Edges in random order and direction; components join and fall apart."""
    random = np.random.default_rng(100 + seed)
    graph = random_graph(dimension, 40, 40, 100 + seed, noise=0.02)
    world = OnlineMap(dimension, tolerance=0)
    for node in random.permutation(graph.ids):
        world.add_pose(int(node))
    inside, outside = {}, list(random.permutation(len(graph.edges)))
    for _ in range(120):
        if outside and (not inside or random.random() < 0.65):
            row = int(outside.pop())
            added = world.add_edges(
                graph.edges[row], graph.measurements[row], graph.information[row]
            )
            inside[int(added[0])] = row
        else:
            number = int(random.choice(list(inside)))
            outside.insert(0, inside.pop(number))
            world.remove_edges(number)
        if random.random() < 0.5:
            world.update()
    world.update()
    own = world.graph()
    rows = [inside[k] for k in sorted(inside)]
    assert np.array_equal(own.edges, graph.edges[rows])
    assert own.chi2 == pytest.approx(batch(own).chi2, rel=1e-8, abs=1e-12)
    # One node of each component is fixed.
    assert len(own.gauge) == own.components.max() + 1
    assert np.abs(world.covariances(own.gauge)).max() == 0
    assert np.allclose(world.covariances(own.ids), masat.covariances(at_linearization(world)))


@pytest.mark.parametrize("dimension", [2, 3])
def test_default_tolerance_is_kept(dimension):
    graph = random_graph(dimension, 150, 120, 5, noise=0.02)
    world = OnlineMap(dimension)
    feed(world, graph)
    excess = world.chi2 / batch(world.graph()).chi2 - 1
    assert 0 <= excess + 1e-12 < 1e-3


@pytest.mark.parametrize("dimension", [2, 3])
def test_covariances_are_those_of_the_same_linearization(dimension):
    graph = random_graph(dimension, 80, 60, 8, noise=0.02)
    world = OnlineMap(dimension)
    feed(world, graph)
    where = at_linearization(world)
    assert np.allclose(world.covariances(), masat.covariances(where), rtol=1e-9, atol=1e-14)
    pairs = np.random.default_rng(0).integers(80, size=(30, 2))
    expected = masat.relative_covariances(where, pairs)
    assert np.allclose(world.relative_covariances(pairs), expected, rtol=1e-8, atol=1e-12)


def test_optimize_reaches_the_batch_optimum():
    graph = random_graph(2, 100, 80, 9, noise=0.05)
    world = OnlineMap(2, tolerance=0.1)
    feed(world, graph)
    result = world.optimize()
    assert np.array_equal(world.poses, result.poses[result.graph.index(world.ids)])
    assert world.chi2 == pytest.approx(batch(world.graph()).chi2, rel=1e-9)
    # It goes on from there.
    world.add_pose(1000)
    world.add_edges((3, 1000), (1, 0, 0))
    assert world.update().chi2 == pytest.approx(result.chi2, rel=1e-6)


def test_the_part_that_joins_later_moves_as_a_whole():
    world = OnlineMap(2)
    for k in (0, 1, 10, 11):
        world.add_pose(k)
    world.add_edges([(0, 1), (10, 11)], [(1, 0, 0), (2, 0, np.pi / 2)])
    world.update()
    assert np.allclose(world.pose(11), (2, 0, np.pi / 2))
    world.add_edges((11, 1), (0, -1, 0))
    done = world.update()
    # Node 11 is one meter to the left of where node 1 is, and 10 two meters behind it.
    assert done.chi2 < 1e-20
    assert np.allclose(world.pose(1), (1, 0, 0))
    assert np.allclose(world.pose(11), (1, 1, 0))
    assert np.allclose(world.pose(10), (1, 3, -np.pi / 2))


def test_the_part_that_is_cut_off_stays():
    world = square()
    before = world.poses
    bridges = world.add_edges([(2, 3), (1, 2)], [(1, 0, 1.6)] * 2)
    world.remove_edges([1, 3])
    world.remove_edges(bridges)
    world.update()
    own = world.graph()
    assert own.components.tolist() == [0, 0, 1, 1]
    assert own.gauge.tolist() == [0, 2]
    assert np.array_equal(world.pose(2), before[2])


def test_removal_and_return_give_the_same_map():
    graph = random_graph(3, 50, 60, 2, noise=0.02)
    world = OnlineMap(3)
    feed(world, graph)
    world.optimize()
    before = world.poses
    contents = world.graph()
    for number in np.random.default_rng(0).permutation(len(contents.edges))[:40]:
        world.remove_edges(int(number))
        world.update()
        world.add_edges(
            contents.edges[number], contents.measurements[number], contents.information[number]
        )
        world.update()
    world.optimize()
    assert np.abs(lie.local(before, world.poses)).max() < 1e-7


def test_a_guess_is_kept_until_the_edges_say_otherwise():
    world = OnlineMap(2)
    world.add_pose(0, (5, 5, 0))
    world.add_pose(1, (6.5, 5, 0))
    world.update()
    assert np.allclose(world.poses, [(5, 5, 0), (6.5, 5, 0)])
    world.add_edges((0, 1), (1, 0, 0))
    world.update()
    assert np.allclose(world.poses, [(5, 5, 0), (6, 5, 0)])


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_factor_stays_about_as_small_as_that_of_a_fresh_order(dimension):
    graph = random_graph(dimension, 400, 40, 12, noise=0.02)
    world = OnlineMap(dimension)
    feed(world, graph)
    fresh = graph.elimination.fill(graph.dof)
    assert world._core.fill_of_factor() < 2 * fresh
    assert world._core.bytes_of_factor() < 8 * 8 * fresh


def test_a_large_closure_is_solved_to_the_end():
    """A loop that dead reckoning leaves open by more than its own size."""
    world = OnlineMap(2)
    count = 60
    for k in range(count):
        world.add_pose(k)
        if k > 0:
            world.add_edges((k - 1, k), (1, 0, 2 * np.pi / count + 0.03))
        world.update()
    world.add_edges((count - 1, 0), (1, 0, 2 * np.pi / count + 0.03))
    done = world.update()
    assert done.complete
    assert world.chi2 == pytest.approx(batch(world.graph()).chi2, rel=1e-3)
    # All edges turn by as much too far.
    assert world.chi2 < count * 0.03**2 * 1.01


def test_huge_ids():
    world = OnlineMap(2)
    ids = [2**63 - 1, -(2**63), 0, 10**15]
    for k in ids:
        world.add_pose(k)
    world.add_edges([ids[k : k + 2] for k in range(3)], [(1, 0, 0)] * 3)
    world.update()
    assert world.ids.tolist() == ids
    assert np.allclose(world.poses[:, 0], range(4))
    own = world.graph()
    assert own.gauge.tolist() == [ids[0]]
    assert np.allclose(own.poses[own.index(ids)], world.poses)


@pytest.mark.parametrize("dimension", [2, 3])
def test_noise_free_measurements(dimension):
    graph = random_graph(dimension, 60, 60, 3, noise=0.0)
    world = OnlineMap(dimension)
    feed(world, graph)
    assert world.chi2 < 1e-12


def test_a_budget_leaves_a_complete_estimate_and_is_made_up_for():
    graph = random_graph(2, 120, 100, 6, noise=0.1)
    world, limited = OnlineMap(2), OnlineMap(2)
    feed(world, graph)
    newer = graph.edges.max(axis=1)
    for node in graph.ids:
        limited.add_pose(int(node))
        rows = newer == node
        limited.add_edges(graph.edges[rows], graph.measurements[rows], graph.information[rows])
        limited.update(budget=0.0)
        assert np.isfinite(limited.poses).all()
    for _ in range(200):
        if limited.update(budget=1.0).complete:
            break
    assert limited.update(budget=1.0).complete
    assert limited.chi2 == pytest.approx(world.chi2, rel=2e-3)


def test_readers_see_nothing_before_the_update():
    world = square()
    poses, chi2 = world.poses, world.chi2
    world.add_pose(4)
    world.add_edges((3, 4), (1, 0, 0))
    world.add_edges((4, 0), (1, 1, 1))
    assert len(world) == 4
    assert world.chi2 == chi2
    assert np.array_equal(world.poses, poses)
    with pytest.raises(GraphError, match="no node 4"):
        world.pose(4)
    world.update()
    assert len(world) == 5


def test_poses_are_copies():
    world = square()
    world.poses[:] = 0
    assert world.poses[2].any()


EYE = np.eye(3)


@pytest.mark.parametrize(
    ("call", "error", "text"),
    [
        (lambda w: w.add_pose(2), GraphError, "node 2 already"),
        (lambda w: w.add_pose(2.5), GraphError, "must be an integer"),
        (lambda w: w.add_pose(2**63), GraphError, "64 bits"),
        (lambda w: w.add_pose(9, (0, np.nan, 0)), GraphError, "guess of node 9 is not finite"),
        (lambda w: w.add_pose(9, (0, 0)), GraphError, "guess of node 9 must have 3 numbers"),
        (lambda w: w.add_edges((0, 9), (0, 0, 0)), GraphError, r"0 -> 9.* names node 9"),
        (lambda w: w.add_edges((0, 0), (0, 0, 0)), GraphError, "joins node 0 to itself"),
        (
            lambda w: w.add_edges([(0, 1), (1, 2)], [(0, 0, 0), (0, np.inf, 0)]),
            GraphError,
            "edge 1",
        ),
        (lambda w: w.add_edges((0, 1), (0, 0)), GraphError, r"shape \(1, 3\)"),
        (lambda w: w.add_edges((0, 1), (0, 0, 0), np.eye(6)), GraphError, "information must have"),
        (lambda w: w.add_edges((0, 1), (0, 0, 0), -EYE), InformationError, "0 -> 1"),
        (
            lambda w: w.add_edges((0, 1), (0, 0, 0), np.diag([1, 1, 0])),
            InformationError,
            "undetermined",
        ),
        (lambda w: w.add_edges((0, 1), (0, 0, 0), EYE * np.nan), GraphError, "not finite"),
        (lambda w: w.remove_edges(4), GraphError, "no edge 4"),
        (lambda w: w.remove_edges(-1), GraphError, "no edge -1"),
        (lambda w: w.remove_edges([1, 1]), GraphError, "twice"),
        (lambda w: w.covariances([9]), GraphError, "no node 9"),
        (lambda w: w.relative_covariances([(0, 9)]), GraphError, "no node 9"),
        (lambda w: w.relative_covariances([0, 1, 2]), GraphError, r"\(k, 2\)"),
    ],
)
def test_errors_leave_the_map_as_it_is(call, error, text):
    world = square()
    before = state(world)
    with pytest.raises(error, match=text):
        call(world)
    world.update()
    assert state(world) == before
    assert world.add_edges((0, 2), (0, 0, 0)).tolist() == [4]


def test_an_update_that_cannot_be_done_changes_nothing():
    world = square()
    before = state(world)
    world.add_pose(4)
    world.add_edges([(3, 4), (4, 0)], [(1e200, 0, 0), (1, 1, 1)])
    world.remove_edges(0)
    with pytest.raises(OptimizationError, match="do not determine its pose"):
        world.update()
    assert state(world) == (*before[:2], pytest.approx(before[2], rel=1e-12), before[3])
    assert world.update().complete
    world.add_pose(4)
    numbers = world.add_edges([(3, 4), (4, 0)], [(1, 0, 0), (1, 1, 1)])
    assert world.update().complete
    assert len(world) == 5
    world.remove_edges(numbers)
    world.update()
    assert world.chi2 == pytest.approx(before[2], rel=1e-4)


def test_removed_edges_are_forgotten():
    world = square()
    world.remove_edges(2)
    with pytest.raises(GraphError, match="no edge 2, or it is removed"):
        world.remove_edges(2)
    world.update()
    with pytest.raises(GraphError, match="no edge 2"):
        world.remove_edges(2)
    assert len(world.graph().edges) == 3


def test_constructor_and_empty_map():
    with pytest.raises(GraphError, match="2 or 3"):
        OnlineMap(4)
    with pytest.raises(OptimizationError, match=r"\[0, 1\)"):
        OnlineMap(2, tolerance=-1)
    world = OnlineMap(3)
    assert len(world) == 0
    assert world.poses.shape == (0, 7)
    assert world.chi2 == 0
    assert world.update().complete
    assert world.covariances().shape == (0, 6, 6)
    with pytest.raises(GraphError, match="empty"):
        world.graph()
    assert world.add_edges([], []).tolist() == []
    assert repr(world) == "OnlineMap(3D, 0 nodes, 0 edges)"


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_loaded_map_goes_on_where_the_other_was(dimension, tmp_path):
    graph = random_graph(dimension, 60, 50, 4, noise=0.02)
    world = OnlineMap(dimension, tolerance=1e-3)
    feed(world, graph)
    world.remove_edges([3, 5])
    world.update()
    world.save(tmp_path / "map.npz")
    other = OnlineMap.load(tmp_path / "map.npz")
    assert other.tolerance == 1e-3
    assert np.array_equal(other.ids, world.ids)
    assert np.allclose(other.poses, world.poses, rtol=0, atol=1e-14)
    assert other.chi2 == pytest.approx(world.chi2, rel=1e-10)
    assert np.allclose(other.covariances(), world.covariances(), rtol=1e-9, atol=1e-14)
    z = random_poses(dimension, 1, np.random.default_rng(0))[0]
    for each in (world, other):
        each.add_pose(99)
        assert each.add_edges((0, 99), z).tolist() == [len(graph.edges)]
        each.update()
    assert np.allclose(other.poses, world.poses, atol=1e-6)


def test_files_that_are_no_maps(tmp_path):
    world = square()
    world.save(tmp_path / "map.npz")
    whole = (tmp_path / "map.npz").read_bytes()
    (tmp_path / "cut.npz").write_bytes(whole[:-30])
    (tmp_path / "text.npz").write_text("no map")
    np.savez(tmp_path / "other.npz", a=1)
    for name in ("cut", "text", "other"):
        with pytest.raises(masat.FormatError, match="map"):
            OnlineMap.load(tmp_path / f"{name}.npz")
    arrays = dict(np.load(tmp_path / "map.npz"))
    for name, bad in (
        ("roots", [1] * 4),
        ("edges", [(0, 9)] * 4),
        ("poses", np.full((4, 3), np.nan)),
    ):
        np.savez(tmp_path / "bad.npz", **{**arrays, name: np.array(bad)})
        with pytest.raises(masat.FormatError, match="map"):
            OnlineMap.load(tmp_path / "bad.npz")


def test_public_graph_as_a_stream(data_dir):
    graph = masat.read(data_dir / "2d/intel.g2o")
    world = OnlineMap(2)
    feed(world, graph)
    assert world.chi2 == pytest.approx(45.00469581, rel=1e-3)
    assert world.optimize().chi2 == pytest.approx(45.00469581, rel=1e-8)


def test_readers_on_the_threads_beside_see_complete_states():
    world, done, seen = OnlineMap(2), threading.Event(), []

    def read():
        counts = []
        while not done.is_set():
            poses = world.poses
            assert np.isfinite(poses).all()
            # An exact chain has these poses whenever it is read.
            assert np.allclose(poses[:, 0], np.arange(len(poses)), atol=1e-9)
            counts.append(len(poses))
            if len(poses):
                assert np.allclose(world.pose(0), 0)
        seen.append(counts)

    readers = [threading.Thread(target=read) for _ in range(3)]
    for reader in readers:
        reader.start()
    try:
        for k in range(150):
            world.add_pose(k)
            if k > 0:
                world.add_edges((k - 1, k), (1, 0, 0))
            world.update()
    finally:
        done.set()
        for reader in readers:
            reader.join()
    assert len(seen) == 3
    assert all(counts == sorted(counts) for counts in seen)


def test_covariances_after_an_update_that_failed():
    world = square()
    expected = masat.covariances(world.graph())
    world.add_pose(4)
    world.add_edges([(3, 4), (4, 0)], [(1e200, 0, 0), (1, 1, 1)])
    with pytest.raises(OptimizationError):
        world.update()
    # The edges are linearized at the poses then.
    assert np.allclose(world.covariances(), expected, rtol=1e-9)


@pytest.mark.parametrize("budget", [-1.0, np.nan])
def test_a_budget_is_no_less_than_zero(budget):
    world = square()
    world.add_pose(4)
    with pytest.raises(OptimizationError, match="must not be negative"):
        world.update(budget)
    assert len(world) == 4


def test_quaternions_of_files_that_are_rounded_or_wrong(tmp_path):
    world = OnlineMap(3)
    feed(world, random_graph(3, 20, 10, 3, noise=0.02))
    world.save(tmp_path / "map.npz")
    arrays = dict(np.load(tmp_path / "map.npz"))
    for name in ("linearized", "poses", "measurements"):
        rounded = {**arrays, name: np.round(arrays[name], 6)}
        np.savez(tmp_path / "rounded.npz", **rounded)
        loaded = OnlineMap.load(tmp_path / "rounded.npz")
        assert np.allclose(loaded.poses, world.poses, atol=1e-5)
        assert loaded.update().complete
        doubled = {**arrays, name: arrays[name] * 2}
        np.savez(tmp_path / "doubled.npz", **doubled)
        with pytest.raises(masat.FormatError, match="quaternion"):
            OnlineMap.load(tmp_path / "doubled.npz")


@pytest.mark.parametrize("name", ["ids", "roots", "edge_numbers", "edges", "measurements"])
def test_arrays_of_another_shape_in_a_file(name, tmp_path):
    world = square()
    world.save(tmp_path / "map.npz")
    arrays = dict(np.load(tmp_path / "map.npz"))
    for other in (arrays[name][:-1], arrays[name][..., None], arrays[name].ravel(), 0):
        if np.shape(other) == arrays[name].shape:
            continue
        np.savez(tmp_path / "bad.npz", **{**arrays, name: np.array(other)})
        with pytest.raises(masat.FormatError):
            OnlineMap.load(tmp_path / "bad.npz")


@pytest.mark.parametrize("size", [1e100, 1e160, 1e200, 1e300])
@pytest.mark.parametrize("scale", [1e-300, 1.0, 1e150, 1e300])
def test_huge_numbers_leave_a_finite_map(size, scale):
    world = square()
    before = state(world)
    world.add_edges((0, 2), (size, 0, 0), EYE * scale)
    try:
        done = world.update()
    except OptimizationError:
        assert state(world) == (*before[:2], pytest.approx(before[2]), before[3])
        assert world.update().complete
    else:
        assert np.isfinite(world.poses).all()
        assert np.isfinite(done.chi2)
        assert np.isfinite(world.chi2)


@pytest.mark.parametrize(("dimension", "when"), [(2, 100), (3, 60)])
def test_what_was_negligible_beside_a_large_chi2_is_solved_when_it_has_fallen(dimension, when):
    world = worlds.manhattan(200, seed=1) if dimension == 2 else worlds.grid(125)
    graph = worlds.perturb(world, (0.05, 0.05, 0.02) if dimension == 2 else (0.05, 0.02), seed=1)
    far = (40.0, 0, 0) if dimension == 2 else (300.0, 0, 0, 0, 0, 0, 1)
    growing, numbers = OnlineMap(dimension), None
    newer = graph.edges.max(axis=1)
    for node in graph.ids.tolist():
        growing.add_pose(node)
        rows = np.flatnonzero(newer == node)
        if len(rows):
            growing.add_edges(graph.edges[rows], graph.measurements[rows], graph.information[rows])
        growing.update(None if numbers is None else 0.0)
        if node == when:
            numbers = growing.add_edges((0, 9), far, 1e4 * np.eye(graph.dof))
            growing.update(0.0)
    growing.remove_edges(numbers)
    growing.update(0.0)
    done = growing.update()
    assert done.complete
    assert growing.chi2 == pytest.approx(batch(growing.graph()).chi2, rel=2e-4)
    # Nothing is left of thresholds that referred to a chi2 of millions.
    assert done.chi2 == pytest.approx(growing.chi2, rel=1e-6)
