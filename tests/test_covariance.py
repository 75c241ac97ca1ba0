import numpy as np
import pytest
from random_graphs import random_graph

import masat
from masat import GraphError, OptimizationError, PoseGraph, lie
from masat.optimizers.equations import normal_equations


def joined(dimension, sizes, seed=0, fixed=()):
    """Random components, ids in steps of 10; the last node of all stands alone."""
    parts = [random_graph(dimension, n, n // 6, seed + k, noise=0.05) for k, n in enumerate(sizes)]
    first = np.cumsum([0, *sizes])
    poses = np.concatenate([*(p.poses for p in parts), lie.identity(dimension)[None]])
    return PoseGraph.from_arrays(
        np.concatenate([10 * (p.edges + k) for p, k in zip(parts, first[:-1], strict=True)]),
        np.concatenate([p.measurements for p in parts]),
        np.concatenate([p.information for p in parts]),
        ids=10 * np.arange(first[-1] + 1),
        poses=poses,
        fixed=fixed,
    )


def derivative(function, poses, dof, h=1e-6):
    """Of a function of the steps from poses (k, .), by each step: (..., k * dof)."""
    columns = np.eye(len(poses) * dof).reshape(-1, len(poses), dof) * h
    ends = [[function(lie.retract(poses, s * c)) for c in columns] for s in (1, -1)]
    return np.stack([(a - b) / (2 * h) for a, b in zip(*ends, strict=True)], axis=-1)


def dense_covariance(graph):
    """The joint covariance of all nodes, (n, n, d, d), zero where the anchors are."""
    n, d = len(graph.ids), graph.dof

    def errors(poses):
        predicted = lie.between(*(poses[graph.edge_indices[:, end]] for end in (0, 1)))
        return lie.local(graph.measurements, predicted)

    jacobian = derivative(errors, graph.poses, d)
    h = np.einsum("kia,kij,kjb->ab", jacobian, graph.information, jacobian)
    free = np.repeat(~np.isin(graph.ids, graph.gauge), d)
    out = np.zeros_like(h)
    out[np.ix_(free, free)] = np.linalg.inv(h[np.ix_(free, free)])
    return out.reshape(n, d, n, d).transpose(0, 2, 1, 3)


def assert_close(a, b, tolerance=1e-5):
    scale = np.abs(b).max(axis=(-2, -1), keepdims=True)
    assert (np.abs(a - b) <= tolerance * scale + 1e-12).all()


FIXED = [(), (20,), (0, 50, 340)]


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("fixed", FIXED)
def test_marginals_are_those_of_the_dense_inverse(dimension, fixed):
    graph = joined(dimension, (30, 12), seed=len(fixed), fixed=fixed)
    expected = np.einsum("kkij->kij", dense_covariance(graph))
    found = masat.covariances(graph)
    assert_close(found, expected)
    anchors = graph.index(graph.gauge)
    assert (found[anchors] == 0).all()
    assert (np.delete(found, anchors, axis=0).trace(axis1=1, axis2=2) > 0).all()


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("fixed", FIXED)
def test_relative_covariances_are_those_of_the_dense_inverse(dimension, fixed):
    graph = joined(dimension, (30, 6), seed=len(fixed), fixed=fixed)
    joint, n, d = dense_covariance(graph), len(graph.ids), graph.dof
    pairs = np.stack(np.meshgrid(np.arange(n), np.arange(n)), axis=-1).reshape(-1, 2)
    expected = []
    for a, b in pairs:
        seen = lie.between(graph.poses[a], graph.poses[b])
        ends = graph.poses[[a, b]]
        j = derivative(lambda p, seen=seen: lie.local(seen, lie.between(p[0], p[1])), ends, d)
        both = joint[np.ix_([a, b], [a, b])].transpose(0, 2, 1, 3).reshape(2 * d, 2 * d)
        expected.append(j @ both @ j.T if a != b else np.zeros((d, d)))
    assert_close(masat.relative_covariances(graph, graph.ids[pairs]), np.array(expected), 3e-5)


def test_uncertainty_grows_along_a_chain():
    n = 30
    still = PoseGraph.from_arrays([(k, k + 1) for k in range(n)], np.zeros((n, 3)))
    still = still.with_poses(np.zeros((n + 1, 3)))
    steps = np.arange(n + 1)
    assert np.allclose(masat.covariances(still), steps[:, None, None] * np.eye(3))

    # A meter a step: each heading error swings all that follows it.
    line = PoseGraph.from_arrays(still.edges, np.tile([1.0, 0, 0], (n, 1)))
    found = masat.covariances(line.with_poses(np.column_stack([steps, 0 * steps, 0 * steps])))
    lever = [sum((k - j) ** 2 for j in range(1, k + 1)) for k in steps]
    assert np.allclose(found[:, 0, 0], steps)
    assert np.allclose(found[:, 1, 1], steps + lever)
    assert np.allclose(found[:, 1, 2], steps * (steps - 1) / 2)
    assert np.allclose(found[:, 2, 2], steps)


@pytest.mark.parametrize("dimension", [2, 3])
def test_an_edge_of_a_tree_is_as_sure_as_it_says(dimension):
    graph = masat.initialize(random_graph(dimension, 60, 0, seed=1, noise=0.1), "masat")
    expected = np.linalg.inv(graph.information)
    assert_close(masat.relative_covariances(graph, graph.edges), expected, 1e-9)

    # The other way round: the same uncertainty, seen from the other end.
    turn = np.array(
        [
            derivative(
                lambda p, z=z: lie.local(lie.inverse(z), lie.inverse(p[0])), z[None], graph.dof
            )
            for z in graph.measurements
        ]
    )
    turned = turn @ expected @ turn.swapaxes(1, 2)
    assert_close(masat.relative_covariances(graph, graph.edges[:, ::-1]), turned)


@pytest.mark.parametrize("dimension", [2, 3])
def test_they_are_symmetric_and_positive_semidefinite(dimension):
    graph = random_graph(dimension, 80, 30, seed=2, noise=0.02)
    pairs = np.random.default_rng(0).integers(80, size=(100, 2))
    for c in (masat.covariances(graph), masat.relative_covariances(graph, pairs)):
        assert (c == c.swapaxes(1, 2)).all()
        smallest, largest = np.linalg.eigvalsh(c)[:, 0], np.linalg.eigvalsh(c)[:, -1]
        assert (smallest >= -1e-10 * largest).all()


@pytest.mark.parametrize("dimension", [2, 3])
def test_what_is_relative_does_not_depend_on_the_anchor(dimension):
    graph = random_graph(dimension, 40, 15, seed=3, noise=0.0)
    pairs = np.random.default_rng(1).integers(40, size=(60, 2))
    other = PoseGraph.from_arrays(
        graph.edges, graph.measurements, graph.information, poses=graph.poses, fixed=[17]
    )
    relative = masat.relative_covariances(graph, pairs)
    assert_close(masat.relative_covariances(other, pairs), relative, 1e-8)
    # Seen from its anchor a node is where it is.
    from_anchor = masat.relative_covariances(graph, [(17, k) for k in range(40)])
    assert_close(masat.covariances(other), from_anchor, 1e-8)


@pytest.mark.parametrize("dimension", [2, 3])
def test_gtsam_says_the_same(dimension):
    gtsam = pytest.importorskip("gtsam")
    graph = random_graph(dimension, 25, 10, seed=4, noise=0.0)

    # gtsam has the rotation first, and its rotation vector is twice the quaternion's part.
    order = [0, 1, 2] if dimension == 2 else [3, 4, 5, 0, 1, 2]
    scale = np.array([1.0, 1, 1] if dimension == 2 else [2.0, 2, 2, 1, 1, 1])

    def pose(p):
        if dimension == 2:
            return gtsam.Pose2(*p)
        return gtsam.Pose3(gtsam.Rot3.Quaternion(p[6], *p[3:6]), p[:3])

    kind = f"Pose{dimension}"
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, p in enumerate(graph.poses):
        values.insert(k, pose(p))
    for (a, b), z, w in zip(graph.edges, graph.measurements, graph.information, strict=True):
        noise = gtsam.noiseModel.Gaussian.Information(
            w[np.ix_(order, order)] / np.outer(scale, scale)
        )
        factors.add(getattr(gtsam, f"BetweenFactor{kind}")(int(a), int(b), pose(z), noise))
    held = gtsam.noiseModel.Isotropic.Sigma(graph.dof, 1e-6)
    factors.add(getattr(gtsam, f"PriorFactor{kind}")(0, pose(graph.poses[0]), held))
    marginals = gtsam.Marginals(factors, values)
    expected = np.array([marginals.marginalCovariance(k) for k in range(1, 25)])

    c = masat.covariances(graph, np.arange(1, 25))
    assert_close(c[:, order][:, :, order] * np.outer(scale, scale), expected, 1e-6)


@pytest.mark.parametrize("name", ["2d/input_M3500_g2o.g2o", "3d/sphere2500.g2o"])
def test_columns_of_a_real_graphs_inverse_are_solutions(name, data_dir):
    graph = masat.initialize(masat.read(data_dir / name), "masat")
    equations = normal_equations(graph)
    equations.linearize(graph.poses)
    undamped = np.zeros_like(equations.rhs())
    equations.factorize(undamped)
    before, free, d = equations.solve(), len(graph.elimination.free_nodes()), graph.dof
    marginals = masat.covariances(graph, graph.ids[graph.elimination.free_nodes()])
    every, random = np.arange(free, dtype=np.int32), np.random.default_rng(5)
    for node in random.integers(free, size=3):
        column = np.concatenate(equations.inverse(every, np.full_like(every, node)))
        block = np.concatenate(equations.inverse(np.full_like(every, node), every), axis=1)
        assert np.allclose(block, column.T, rtol=1e-9, atol=1e-12 * np.abs(column).max())
        here = slice(d * node, d * node + d)
        assert np.allclose(column[here], marginals[node], rtol=1e-8, atol=0)
        for i in range(d):
            # A stiffness s on one unknown changes the solution by its column: (x - x') / (s x'_i).
            damping, unknown = undamped.copy(), d * node + i
            damping[unknown] = 1 / marginals[node, i, i]
            equations.factorize(damping)
            after = equations.solve()
            expected = (before - after) / (damping[unknown] * after[unknown])
            assert np.allclose(column[:, i], expected, rtol=1e-6, atol=1e-7 * expected.max())
        equations.factorize(undamped)


def test_nodes_are_taken_in_the_order_asked_for():
    graph = joined(2, (20, 5))
    every = masat.covariances(graph)
    assert np.allclose(masat.covariances(graph, [70, 20, 70, 250]), every[[7, 2, 7, 25]])
    assert masat.covariances(graph, []).shape == (0, 3, 3)
    assert masat.relative_covariances(graph, []).shape == (0, 3, 3)


def test_nodes_that_are_all_fixed_are_certain():
    graph = random_graph(3, 4, 2, seed=6, noise=0.1)
    graph = PoseGraph.from_arrays(
        graph.edges, graph.measurements, poses=graph.poses, fixed=range(4)
    )
    assert (masat.covariances(graph) == np.zeros((4, 6, 6))).all()
    assert (masat.relative_covariances(graph, [(0, 3)]) == np.zeros((1, 6, 6))).all()
    # So many edges are added up in several groups.
    edges = np.tile(graph.edges, (400, 1))
    many = PoseGraph.from_arrays(
        edges, np.tile(graph.measurements, (400, 1)), poses=graph.poses, fixed=range(4)
    )
    assert len(edges) == 2000
    assert masat.optimize(many).reason is masat.StopReason.NOTHING_TO_DO


def test_what_cannot_be_told_is_refused():
    bare = PoseGraph.from_arrays([(3, 7)], [(1, 0, 0)])
    with pytest.raises(OptimizationError, match=r"no poses.*masat\.initialize"):
        masat.covariances(bare)
    graph = masat.initialize(bare, "masat")
    with pytest.raises(GraphError, match="no node 5"):
        masat.covariances(graph, [3, 5])
    with pytest.raises(GraphError, match="no node 5"):
        masat.relative_covariances(graph, [(5, 3)])
    with pytest.raises(GraphError, match=r"\(k,\)"):
        masat.covariances(graph, 3)
    with pytest.raises(GraphError, match=r"\(k, 2\)"):
        masat.relative_covariances(graph, [3, 7])
    with pytest.raises(OptimizationError, match="not finite"):
        masat.covariances(graph.with_poses([(0, 0, 0), (1e200, 0, 0)]))
    half_turn, still = [0, 0, 0, 1, 0, 0, 0], [0, 0, 0, 0, 0, 0, 1]
    singular = PoseGraph.from_arrays([(3, 7)], [half_turn], poses=[still, still])
    with pytest.raises(OptimizationError, match=r"node 7.*half a turn"):
        masat.covariances(singular)


def test_blocks_out_of_range_are_refused():
    graph = joined(2, (5,))
    equations = normal_equations(graph)
    zero = np.zeros(1, np.int32)
    for bad in (-1, 4):
        with pytest.raises(ValueError, match="out of range"):
            equations.inverse(zero, zero + np.int32(bad))
    with pytest.raises(ValueError, match="as many"):
        equations.inverse(zero, np.zeros(2, np.int32))


def two_triangles(weight):
    """Two triangles, joined by one edge of little information."""
    edges = [(0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (2, 3)]
    third = (1, 0, 2 * np.pi / 3)
    information = [np.eye(3)] * 6 + [weight * np.eye(3)]
    graph = PoseGraph.from_arrays(edges, [third] * 6 + [(1, 0, 0)], information)
    return masat.initialize(graph, "masat")


def test_covariances_near_singularity_are_right_or_doubted():
    # The heading of the second triangle is known to 1 / weight, the rest does not count.
    for weight in (1e-6, 1e-8, 1e-10):
        assert masat.covariances(two_triangles(weight), [4])[0, 2, 2] == pytest.approx(
            1 / weight, rel=1e-4
        )
    for weight in (1e-12, 1e-13):
        with pytest.warns(masat.MasatWarning, match="may be wrong by a fraction"):
            found = masat.covariances(two_triangles(weight), [4])[0, 2, 2]
        assert found == pytest.approx(1 / weight, rel=0.1)
    with pytest.raises(OptimizationError, match="do not determine its pose"):
        masat.covariances(two_triangles(1e-16), [4])


def test_covariances_do_not_depend_on_the_threads():
    graph = masat.solve(masat.worlds.perturb(masat.worlds.sphere(300, seed=1), [0.05] * 6)).graph
    rng = np.random.default_rng(0)
    rows, columns = rng.integers(len(graph) - 1, size=(2, 500)).astype(np.int32)
    found = []
    for threads in (1, 2, 3):
        equations = normal_equations(graph, threads)
        equations.linearize(graph.poses)
        assert equations.factorize(np.zeros_like(equations.rhs())) < 0
        found.append(equations.inverse(rows, columns))
    assert np.array_equal(found[0], found[1])
    assert np.array_equal(found[0], found[2])
