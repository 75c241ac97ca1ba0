"""Position fixes and other priors in maps that grow."""

import numpy as np
import pytest

import masat
from masat import GraphError, OnlineMap, OptimizationError, lie, worlds
from masat.online.stream import replay

MOVED = {2: (1000.0, -500.0, 2.5), 3: (1000.0, -500.0, 30.0, 0.5, -0.5, 0.1, 0.7)}


def measured(dimension, *, every=15, kind="fixes", seed=1):
    """A noisy world with priors in a frame of kilometers away."""
    world = worlds.manhattan(300, seed=seed) if dimension == 2 else worlds.grid(150)
    sigmas = (0.05, 0.05, 0.02) if dimension == 2 else (0.05, 0.02)
    graph = worlds.perturb(world, sigmas, seed=seed)
    moved = np.array(MOVED[dimension])
    moved[3:] /= np.linalg.norm(moved[3:]) if dimension == 3 else 1
    truth = lie.compose(moved, world.poses)[::every]
    nodes, rng = world.ids[::every], np.random.default_rng(seed)
    positions = truth[:, :dimension] + rng.normal(size=(len(nodes), dimension)) * 0.3
    if kind == "fixes":
        priors = masat.gps(nodes, positions, 0.3)
    elif kind == "poses":
        priors = masat.pose_priors(nodes, truth)
    else:
        priors = masat.gps(nodes[:3], positions[:3], 0.3) + masat.headings(nodes, truth[:, 2], 0.1)
    return graph.with_fixed([]).with_priors(priors)


@pytest.mark.parametrize(
    ("dimension", "kind"), [(2, "fixes"), (2, "poses"), (2, "headings"), (3, "fixes"), (3, "poses")]
)
def test_a_stream_ends_at_the_optimum_of_all_measurements(dimension, kind):
    graph = measured(dimension, kind=kind)
    batch = masat.solve(graph)
    run = replay(graph)
    assert len(run.map.waiting_priors) == 0
    assert run.map.chi2 < batch.chi2 * (1 + 1e-3)
    assert run.map.graph().chi2 == pytest.approx(run.map.chi2, rel=1e-9)
    result = run.map.optimize()
    assert result.chi2 == pytest.approx(batch.chi2, rel=1e-9)
    order = result.graph.index(graph.ids)
    assert np.abs(lie.local(result.poses[order], batch.poses)).max() < 1e-5


def test_fixes_wait_until_they_determine_where_the_map_lies():
    world = OnlineMap(2)
    numbers = []
    for k in range(4):
        world.add_pose(k)
        if k > 0:
            world.add_edges((k - 1, k), (1, 0, 0), 1e4 * np.eye(3))
        numbers += world.add_priors(masat.gps([k], [(5, 10 + k)], 0.1)).tolist()
        world.update()
        waiting = world.waiting_priors.tolist()
        if k == 0:
            np.testing.assert_allclose(world.pose(0), (0, 0, 0))
            assert waiting == numbers
    # East of the first pose in its own frame is north in the world.
    assert waiting == []
    np.testing.assert_allclose(world.poses, [(5, 10 + k, np.pi / 2) for k in range(4)], atol=1e-6)
    assert world.chi2 == pytest.approx(0, abs=1e-9)
    assert len(world.graph().priors) == 4


def test_fixes_too_near_each_other_for_a_heading_wait():
    world = OnlineMap(2)
    for k in range(6):
        world.add_pose(k)
        if k > 0:
            world.add_edges((k - 1, k), (0.01, 0, 0))
        world.add_priors(masat.gps([k], [(k * 0.01, 0)], 1.0))
        world.update()
    assert len(world.waiting_priors) == 6
    assert world.graph().priors is None
    assert world.optimize().converged


def test_a_mean_of_two_fixes():
    world = OnlineMap(2)
    world.add_pose(3)
    world.add_priors(masat.pose_priors([3], [(1, 2, 0.5)], np.diag([1.0, 1, 100])))
    world.add_priors(masat.pose_priors([3], [(4, 2, 0.8)], np.diag([2.0, 2, 200])))
    world.update()
    np.testing.assert_allclose(world.pose(3)[[0, 2]], (3, 0.7), atol=1e-6)
    assert world.covariances([3])[0].shape == (3, 3)
    np.testing.assert_allclose(world.covariances([3])[0, 2, 2], 1 / 300, rtol=1e-6)


def test_two_parts_share_the_frame_of_the_world():
    world = OnlineMap(2)
    for first, east in ((0, 0.0), (10, 100.0)):
        for k in range(3):
            world.add_pose(first + k)
            if k:
                world.add_edges((first + k - 1, first + k), (1, 0, 0))
            world.add_priors(masat.gps([first + k], [(east, k)], 0.01))
        world.update()
    np.testing.assert_allclose(world.pose(12), (100, 2, np.pi / 2), atol=1e-6)
    world.add_edges((2, 10), (-2, -100, 0))
    done = world.update()
    assert done.chi2 == pytest.approx(0, abs=1e-6)


def test_removed_fixes_have_no_part_and_the_last_ones_leave_a_map_of_its_own():
    graph = measured(2)
    run = replay(graph)
    world = run.map
    extra = world.add_priors(masat.gps([7, 40], [(0, 0), (50, 50)], 0.1))
    world.update()
    assert world.chi2 > 1e4
    world.remove_edges(extra)
    world.update()
    result = world.optimize()
    assert result.chi2 == pytest.approx(masat.solve(graph).chi2, rel=1e-9)
    every = np.setdiff1d(np.arange(len(graph.edges) + len(graph.priors)), run.numbers)
    world.remove_edges(every)
    world.update()
    assert world.graph().priors is None
    assert world.optimize().chi2 == pytest.approx(
        masat.solve(graph.with_priors(None)).chi2, rel=1e-9
    )


def test_priors_that_wait_can_be_removed():
    world = OnlineMap(2)
    world.add_pose(0)
    number = world.add_priors(masat.gps([0], [(1, 1)], 1.0))
    world.update()
    world.remove_edges(number)
    world.update()
    assert len(world.waiting_priors) == 0
    with pytest.raises(GraphError, match="no edge"):
        world.remove_edges(number)


def test_an_update_that_cannot_be_done_forgets_priors_as_well():
    world = OnlineMap(2)
    for k in range(3):
        world.add_pose(k)
        if k:
            world.add_edges((k - 1, k), (1, 0, 0))
    world.update()
    world.add_pose(3)
    world.add_edges([(2, 3), (3, 0)], [(1e200, 0, 0), (1, 1, 1)])
    world.add_priors(masat.gps([3], [(0, 0)], 1.0))
    with pytest.raises(OptimizationError):
        world.update()
    world.update()
    assert len(world.waiting_priors) == 0


@pytest.mark.parametrize(
    ("priors", "text"),
    [
        (lambda: masat.gps([99], [(0, 0)], 1.0), "node 99, which has not been added"),
        (lambda: masat.gps([0], [(0, 0, 0)], 1.0), "the map is 2D, and the priors are 3D"),
        (lambda: [(0, 0)], "made by masat.gps"),
    ],
)
def test_priors_that_do_not_fit(priors, text):
    world = OnlineMap(2)
    world.add_pose(0)
    world.update()
    with pytest.raises(GraphError, match=text):
        world.add_priors(priors())
    assert len(world.waiting_priors) == 0


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_loaded_map_has_its_priors(dimension, tmp_path):
    graph = measured(dimension)
    world = replay(graph).map
    world.add_pose(100_000)
    first = graph.priors.measurements[:1, :dimension]
    world.add_priors(masat.gps([100_000], first, 1.0))
    world.update()
    world.save(tmp_path / "map.npz")
    other = OnlineMap.load(tmp_path / "map.npz")
    np.testing.assert_allclose(other.poses, world.poses, rtol=1e-14, atol=1e-15)
    assert other.chi2 == pytest.approx(world.chi2, rel=1e-12)
    assert (other.waiting_priors == world.waiting_priors).all()
    for one in (world, other):
        one.add_edges((0, 100_000), lie.identity(dimension))
        one.update()
    assert len(other.waiting_priors) == 0
    np.testing.assert_allclose(other.poses[:-1], world.poses[:-1], atol=1e-2)


def test_a_robust_map_leaves_out_wrong_fixes_in_the_end():
    graph = measured(2, every=5)
    good = masat.solve(graph)
    bad = np.arange(0, len(graph.priors), 4)
    z = graph.priors.measurements.copy()
    z[bad, :2] += 50
    wrong = graph.with_priors(masat.pose_priors(graph.priors.ids, z, graph.priors.information))
    world = replay(wrong, robust=True).map
    result = world.optimize()
    wrong_ids = set(graph.priors.ids[bad].tolist())
    left = world.graph().priors
    assert not wrong_ids & set(left.ids.tolist())
    assert len(left) >= 0.95 * (len(graph.priors) - len(bad))
    assert len(world.rejected_priors) == len(graph.priors) - len(left)
    order = result.graph.index(graph.ids)
    assert np.linalg.norm((result.poses[order] - good.poses)[:, :2], axis=1).max() < 1.0
