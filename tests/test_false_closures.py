from dataclasses import replace

import numpy as np
import pytest

import masat
from masat import GraphError, PoseGraph, lie
from masat.chain import odometry_edges
from masat.residuals import residuals
from masat.worlds import (
    add_false_closures,
    add_fixes,
    add_landmarks,
    grid,
    manhattan,
    normalized,
    perturb,
)
from masat.worlds.false_closures import KINDS

MIN_CHI2 = {2: 40, 3: 60}
RUNS = ("grouped", "alias")


def world(dimension, nodes=500, edges=800):
    """A noisy graph at its true poses."""
    if dimension == 2:
        return perturb(manhattan(nodes, edges, seed=1), [0.02, 0.02, 0.01], seed=1)
    return perturb(grid(nodes, edges, seed=1), [0.02, 0.01], seed=1)


def runs_of(a):
    """The whole runs of 20, (r, 20, ...)."""
    return a[: len(a) // 20 * 20].reshape(-1, 20, *a.shape[1:])


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("fraction", [0.1, 0.5, 0.9])
def test_what_holds_for_every_kind(dimension, kind, fraction):
    clean = world(dimension)
    spoiled, is_false = add_false_closures(clean, kind, fraction, seed=2)
    closures = (~odometry_edges(clean)).sum()
    count = round(fraction / (1 - fraction) * closures)
    assert is_false.sum() == count
    assert is_false.mean() == count / len(spoiled.edges)
    assert not is_false[: len(clean.edges)].any()
    for name in ("edges", "measurements", "information"):
        assert np.array_equal(getattr(spoiled, name)[~is_false], getattr(clean, name))
    assert np.array_equal(spoiled.poses, clean.poses)
    assert (spoiled.chi2_per_edge[is_false] > MIN_CHI2[dimension]).all()
    gap = np.diff(spoiled.edges[is_false], axis=1)
    assert gap.min() >= 2
    if kind == "local":
        assert gap.max() == 20
    else:
        assert gap.max() > 100
    # Odometry is still the first edge of each consecutive pair.
    assert np.array_equal(odometry_edges(spoiled)[~is_false], odometry_edges(clean))
    assert not odometry_edges(spoiled)[is_false].any()


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("kind", RUNS)
def test_runs_are_consecutive_pairs(dimension, kind):
    spoiled, is_false = add_false_closures(world(dimension), kind, 0.7)
    runs = runs_of(spoiled.edges[is_false])
    assert len(runs) > 10
    assert (runs - runs[:, :1] == np.arange(20)[:, None]).all()


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_group_has_one_measurement(dimension):
    spoiled, is_false = add_false_closures(world(dimension), "grouped", 0.7)
    runs = runs_of(spoiled.measurements[is_false])
    assert (runs == runs[:, :1]).all()
    assert len(np.unique(runs[:, 0], axis=0)) == len(runs)


def alias_residuals(transform, first, second, z):
    """Residuals of edges to second poses that are moved by one transform: T pose(b) for pose(b)."""
    moved = lie.compose(np.broadcast_to(transform, second.shape), second)
    return lie.local(z, lie.between(first, moved))


def least_chi2(first, second, z, information):
    """The transform with the least chi2 by Gauss-Newton, and that chi2."""
    transform = lie.compose(lie.compose(first[0], z[0]), lie.inverse(second[0]))
    upper = np.linalg.cholesky(information).swapaxes(1, 2)
    dof, step = information.shape[1], 1e-6

    def whitened(t):
        return np.einsum("kij,kj->ki", upper, alias_residuals(t, first, second, z)).ravel()

    for _ in range(6):
        r = whitened(transform)
        moved = [whitened(lie.retract(transform, step * axis)) for axis in np.eye(dof)]
        jacobian = (np.array(moved) - r).T / step
        transform = lie.retract(transform, -np.linalg.lstsq(jacobian, r, rcond=None)[0])
    return transform, float(r @ r)


@pytest.mark.parametrize("dimension", [2, 3])
def test_an_alias_is_one_wrong_transform_with_noise(dimension):
    spoiled, is_false = add_false_closures(world(dimension), "alias", 0.8)
    first, second = (runs_of(spoiled.poses[k]) for k in spoiled.edge_indices[is_false].T)
    z, information = (runs_of(a[is_false]) for a in (spoiled.measurements, spoiled.information))
    fits = [least_chi2(*run) for run in zip(first, second, z, information, strict=True)]
    # Noise that fits the information has a chi2 of as many values as the transform leaves.
    expected = 19 * lie.DOF[dimension]
    chi2 = np.array([chi2 for _, chi2 in fits])
    assert chi2.mean() == pytest.approx(expected, rel=4 * np.sqrt(2 / expected / len(chi2)))
    assert chi2.max() < 2 * expected
    # The transform brings the first pair together. Without it the edges are false.
    for (transform, _), a, b in zip(fits, first[:, 0], second[:, 0], strict=True):
        brought = lie.between(a, lie.compose(transform, b))
        assert np.linalg.norm(brought[:dimension]) < 5 * 0.3 + 0.2


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("kind", ["random", "local", "grouped"])
def test_measurements_spread_around_the_identity(dimension, kind):
    # Information so large that no draw is left out for its chi2.
    clean = world(dimension)
    clean = replace(clean, information=1e4 * clean.information)
    spoiled, is_false = add_false_closures(clean, kind, 0.95)
    z = spoiled.measurements[is_false]
    z = z[::20] if kind == "grouped" else z
    step = lie.local(np.broadcast_to(lie.identity(dimension), z.shape), z)
    spread = 1.0 if dimension == 2 else 0.5  # the vector part of a quaternion is half the angle
    tolerance = 4 / np.sqrt(2 * len(z)) + 0.02  # and the sine of half an angle is smaller still
    sigma = [0.3] * dimension + [spread * np.radians(10)] * (lie.DOF[dimension] - dimension)
    assert np.std(step, axis=0) == pytest.approx(sigma, rel=tolerance)
    assert (np.abs(step.mean(axis=0)) < 4 * np.array(sigma) / np.sqrt(len(z))).all()


def test_pairs_of_nodes_are_drawn_uniformly():
    # Six nodes have ten pairs that are not consecutive.
    poses = np.column_stack([100.0 * np.arange(6), np.zeros((6, 2))])
    pairs = [*((k, k + 1) for k in range(5)), (0, 5)]
    exact = [lie.between(poses[a], poses[b]) for a, b in pairs]
    graph = PoseGraph.from_arrays(pairs, exact, poses=poses)
    spoiled, is_false = add_false_closures(graph, "random", 1 - 1 / 10001)
    drawn, counts = np.unique(spoiled.edges[is_false], axis=0, return_counts=True)
    assert drawn.tolist() == [[a, b] for a in range(6) for b in range(a + 2, 6)]
    assert counts == pytest.approx(1000, abs=150)


def test_information_is_that_of_true_closures_only():
    graph = PoseGraph.from_arrays(
        [(0, 1), (1, 2), (2, 3), (3, 4), (0, 1), (0, 4)],
        [(9.0, 0, 0)] * 5 + [(36.0, 0, 0)],
        [k * np.eye(3) for k in (1, 2, 3, 4, 5, 6)],
        poses=[(9.0 * k, 0, 0) for k in range(5)],
    )
    # The second edge between 0 and 1 is a loop closure: odometry is the first.
    spoiled, is_false = add_false_closures(graph, "random", 0.99)
    assert is_false.sum() == 198
    assert set(spoiled.information[is_false][:, 0, 0]) == {5, 6}


@pytest.mark.parametrize("kind", KINDS)
def test_the_seed_decides(kind):
    clean = world(2)
    one, same, other = (add_false_closures(clean, kind, 0.5, seed=s)[0] for s in (1, 1, 2))
    assert np.array_equal(one.measurements, same.measurements)
    assert np.array_equal(one.edges, same.edges)
    assert not np.array_equal(one.edges, other.edges)


@pytest.mark.parametrize("kind", KINDS)
def test_gaps_in_the_ids_change_nothing(kind):
    clean = world(2)
    spoiled, is_false = add_false_closures(clean, kind, 0.5)
    gaps, also = add_false_closures(clean.relabel(lambda k: 10 * k - 700), kind, 0.5)
    assert np.array_equal(is_false, also)
    assert np.array_equal(gaps.edges, 10 * spoiled.edges - 700)
    assert np.array_equal(gaps.measurements, spoiled.measurements)


def test_labels_tell_false_edges():
    clean = world(2)
    assert add_false_closures(clean, "random", 0.5)[0].labels is None
    words = replace(clean, labels=np.full(len(clean.edges), "a"))
    spoiled, is_false = add_false_closures(words, "random", 0.5)
    assert np.array_equal(spoiled.labels, np.where(is_false, "false", "a"))
    numbers = replace(clean, labels=np.full(len(clean.edges), 7))
    spoiled, is_false = add_false_closures(numbers, "random", 0.5)
    assert np.array_equal(spoiled.labels, np.where(is_false, -1, 7))


def test_a_fraction_of_zero_adds_nothing():
    clean = world(2)
    spoiled, is_false = add_false_closures(clean, "alias", 0)
    assert np.array_equal(spoiled.edges, clean.edges)
    assert is_false.tolist() == [False] * len(clean.edges)


@pytest.mark.parametrize("fraction", [1, -0.1, 1.5, np.nan, "many", None, [0.5, 0.5]])
def test_a_fraction_that_cannot_be_is_refused(fraction):
    with pytest.raises(GraphError, match="at least 0 and below 1"):
        add_false_closures(world(2), "random", fraction)


def test_what_cannot_be_spoiled_is_refused():
    clean = world(2)
    with pytest.raises(GraphError, match="choose one of random, local, grouped, alias"):
        add_false_closures(clean, "evil", 0.5)
    with pytest.raises(GraphError, match="solve it first"):
        add_false_closures(replace(clean, poses=None), "random", 0.5)
    with pytest.raises(GraphError, match="seed"):
        add_false_closures(clean, "random", 0.5, seed=-1)
    with pytest.raises(GraphError, match="no loop closures"):
        add_false_closures(manhattan(50, 49), "random", 0.5)
    with pytest.raises(GraphError, match="more than the 2147483647 possible"):
        add_false_closures(clean, "random", 1 - 1e-15)
    vague = replace(clean, information=1e-9 * clean.information)
    with pytest.raises(GraphError, match="too small"):
        add_false_closures(vague, "random", 0.5)


@pytest.mark.parametrize(("kind", "least"), [("random", 3), ("local", 3), *((k, 22) for k in RUNS)])
def test_the_smallest_graph_that_can_be_spoiled(kind, least):
    def line(nodes):
        poses = np.column_stack([100.0 * np.arange(nodes), np.zeros((nodes, 2))])
        pairs = [*((k, k + 1) for k in range(nodes - 1)), (0, nodes - 1)]
        exact = [lie.between(poses[a], poses[b]) for a, b in pairs]
        return PoseGraph.from_arrays(pairs, exact, poses=poses)

    spoiled, is_false = add_false_closures(line(least), kind, 0.5)
    assert spoiled.edges[is_false].tolist() == [[0, 2]]
    with pytest.raises(GraphError, match=f"at least {least} nodes"):
        add_false_closures(line(least - 1) if least > 3 else loop_of_two(), kind, 0.5)


def loop_of_two():
    return PoseGraph.from_arrays([(0, 1), (0, 1)], np.zeros((2, 3)), poses=np.zeros((2, 3)))


def test_normalized_information_fits_the_residuals():
    # One cycle of three edges with the residuals 0, 0 and (0, 3, 0): reduced chi2 4 * 9 / 3.
    graph = PoseGraph.from_arrays(
        [(0, 1), (1, 2), (0, 2)],
        [(1, 0, 0), (1, 0, 0), (2, 3, 0)],
        4 * np.eye(3),
        poses=[(0, 0, 0), (1, 0, 0), (2, 0, 0)],
    )
    assert residuals(graph)[2] == pytest.approx([0, -3, 0])
    scaled = normalized(graph)
    assert scaled.information == pytest.approx(np.tile(np.eye(3) / 3, (3, 1, 1)))
    assert scaled.chi2 == pytest.approx(3)
    noisy = masat.solve(world(3)).graph
    assert masat.diagnose(normalized(noisy)).reduced_chi2 == pytest.approx(1)
    assert normalized(noisy).structure is noisy.structure


@pytest.mark.parametrize("dimension", [2, 3])
def test_false_closures_of_partial_information_agree_with_each_other(dimension):
    graph = world(dimension)
    d = dimension
    information = graph.information.copy()
    closures = np.flatnonzero(~odometry_edges(graph))
    information[closures[::2], d:], information[closures[::2], :, d:] = 0, 0
    graph = replace(graph, information=information)
    spoiled, is_false = add_false_closures(graph, "alias", 0.5, seed=3)
    assert (spoiled.chi2_per_edge[is_false] > MIN_CHI2[d]).all()
    false = spoiled.information[is_false]
    assert 0 < np.count_nonzero(~false[:, d:].any(axis=(1, 2))) < len(false)


def test_priors_and_landmarks_count_in_the_reduced_chi2():
    truth = manhattan(200, 300, seed=1)
    graph, _ = add_fixes(perturb(truth, [0.02, 0.02, 0.01], seed=1), 0.3, 0.5, seed=1)
    graph = add_landmarks(graph, 20, sigma=0.1, seed=1)
    solved = masat.solve(graph).graph
    found = normalized(solved)
    assert masat.diagnose(found).reduced_chi2 == pytest.approx(1)
    factor = masat.diagnose(solved).reduced_chi2
    assert np.allclose(found.priors.information * factor, graph.priors.information)
    assert np.allclose(found.landmarks.information * factor, graph.landmarks.information)
    # The optimum is the same.
    assert np.allclose(masat.optimize(found).poses, solved.poses, atol=1e-6)


def test_information_without_residuals_is_not_normalized():
    with pytest.raises(GraphError, match="exact"):
        normalized(manhattan(100, 150))
    with pytest.raises(GraphError, match="not redundant"):
        normalized(manhattan(50, 49))
    with pytest.raises(GraphError, match="no poses"):
        normalized(replace(world(2), poses=None))


@pytest.mark.parametrize("name", ["manhattan", "grid"])
def test_simulate_writes_labeled_false_closures(run, name):
    sigma = "0.02,0.02,0.01" if name == "manhattan" else "0.02,0.01"
    code, out, _ = run(
        "simulate", name, "--nodes", 200, "--edges", 299, "--noise", sigma, "--seed", 5,
        "--false", "alias:.5", "-o", "w.g2o", "--truth", "truth.g2o",
    )  # fmt: skip
    assert code == 0
    assert out == "w.g2o: 200 nodes, 399 edges, 100 of them false loop closures\n"
    written = masat.read("w.g2o")
    assert written.poses is None
    texts, counts = np.unique(written.labels, return_counts=True)
    assert dict(zip(texts.tolist(), counts.tolist(), strict=True)) == {
        "closure": 100,
        "false": 100,
        "odometry": 199,
    }
    assert (np.diff(written.edges[written.labels == "odometry"], axis=1) == 1).all()
    truth = masat.read("truth.g2o")
    assert len(truth.edges) == 299
    is_false = written.labels == "false"
    chi2 = written.with_poses(truth.poses).chi2_per_edge
    assert chi2[is_false].min() > MIN_CHI2[written.dimension] > chi2[~is_false].max()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--false", "evil:.5"], "random, local, grouped, alias"),
        (["--false", "random"], "random:0.5"),
        (["--false", "random:1"], "below 1"),
        (["--false", "random:nan"], "below 1"),
        (["--false", "random:.5"], "--false needs --noise"),
    ],
)
def test_simulate_refuses_what_cannot_be(run, tmp_path, arguments, said):
    code, _, err = run("simulate", "city", "--nodes", 100, "-o", "w.g2o", *arguments)
    assert code == 2
    assert said in " ".join(err.split())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "true", "false"),
    [("kitti_00_alpha_0.00", 118, 329), ("kitti_07_alpha_0.00", 1, 134)],
)
def test_labeled_graphs_are_read(data_dir, name, true, false):
    # Importable where tests run from the repository's root.
    benchmark = pytest.importorskip("benchmarks.false_closures")
    graph, is_true = benchmark.labeled(name)
    assert odometry_edges(graph).sum() == len(graph) - 1
    assert is_true.sum() == len(graph) - 1 + true
    assert (~is_true).sum() == false
