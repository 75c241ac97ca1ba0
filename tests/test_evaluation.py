"""ATE and RPE: answers derived by hand, a plain implementation, and the command line."""

import json
import pickle

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from masat import (
    EvaluationError,
    PoseGraph,
    evaluate,
    initialize,
    lie,
    read,
    solve,
    write,
)
from masat.worlds import manhattan, perturb, sphere

LINE = [(0, 0, 0), (1, 0, 0), (2, 0, 0), (3, 0, 0)]
CORNER = [(0, 0, 0), (2, 0, np.pi / 2), (2, 1, np.pi / 2)]


def trajectory(poses, stamps=None, ids=None):
    return PoseGraph.from_arrays(
        np.empty((0, 2), int), np.empty((0, np.shape(poses)[1])),
        ids=range(len(poses)) if ids is None else ids, poses=poses, stamps=stamps,
    )  # fmt: skip


def test_ate_without_alignment_is_the_distance_angle_and_norm():
    moved = [(0, 0, 0), (1, 0.3, 0), (2.4, 0, np.pi / 2), (3, 0, -np.pi)]
    found = evaluate(trajectory(moved), trajectory(LINE), align="none")
    assert_allclose(found.ate.translation, [0, 0.3, 0.4, 0], atol=1e-15)
    assert_allclose(found.ate.rotation, [0, 0, np.pi / 2, np.pi], atol=1e-15)
    # R - I of a turn by 90 degrees has four entries of size 1; of one by 180 two of size 2.
    assert_allclose(found.ate.full, [0, 0.3, np.sqrt(0.16 + 4), np.sqrt(8)], atol=1e-15)
    assert found.scale == 1
    assert_array_equal(found.transform, [0, 0, 0, 0, 0, 0, 1])
    assert found.ate.statistics()["translation"] == {
        "rmse": pytest.approx(0.25),
        "mean": pytest.approx(0.175),
        "median": pytest.approx(0.15),
        "std": pytest.approx(np.sqrt(0.25**2 - 0.175**2)),
        "min": 0.0,
        "max": pytest.approx(0.4),
    }


def test_rpe_is_that_of_the_motions():
    # One step is too long by 0.5, and the heading jumps by 0.1 before the last one.
    moved = [(0, 0, 0), (1.5, 0, 0), (2.5, 0, 0.1), (3.5, 0, 0.1)]
    found = evaluate(trajectory(moved), trajectory(LINE), align="none")
    assert found.pairs.tolist() == [[0, 1], [1, 2], [2, 3]]
    chord = 2 * np.sin(0.05)  # a step of 1 m, turned by -0.1
    assert_allclose(found.rpe.translation, [0.5, 0, chord], atol=1e-15)
    assert_allclose(found.rpe.rotation, [0, 0.1, 0], atol=1e-15)


@pytest.mark.parametrize(
    ("delta", "unit", "all_pairs", "pairs"),
    [
        (2, "frames", False, [[0, 2], [2, 4]]),
        (2, "frames", True, [[0, 2], [1, 3], [2, 4], [3, 5]]),
        # The path is at 0, 1, 1, 3, 3.5, 4.5.
        (2.0, "meters", False, [[0, 3]]),
        (1.4, "meters", False, [[0, 3], [3, 5]]),
        (1.0, "meters", True, [[0, 1], [4, 5]]),
        (2.1, "meters", True, [[1, 3], [2, 3]]),
        (1.5, "meters", True, [[3, 5]]),
    ],
)
def test_the_pairs_of_the_rpe(delta, unit, all_pairs, pairs):
    x = np.array([0, 1, 1, 3, 3.5, 4.5])
    graph = trajectory(np.column_stack([x, 0 * x, 0 * x]))
    found = evaluate(graph, graph, align="none", delta=delta, unit=unit, all_pairs=all_pairs)
    assert found.pairs.tolist() == pairs
    assert len(found.rpe.full) == len(pairs)


@pytest.mark.parametrize("seed", range(20))
def test_all_pairs_in_meters_are_those_of_a_plain_search(seed):
    rng = np.random.default_rng(seed)
    # Steps of zero too: the robot waits.
    x = np.cumsum(rng.choice([0, 16, 32, 64, rng.integers(99)], 60) / 64)
    graph = trajectory(np.column_stack([x, 0 * x, 0 * x]))
    delta = rng.uniform(0.5, 4)
    expected = []
    for i in range(59):
        off = np.abs((x[i + 1 :] - x[i]) - delta)
        if off.min() <= 0.1 * delta:
            expected.append([i, i + 1 + int(off.argmin())])
    found = evaluate(graph, graph, align="none", delta=delta, unit="meters", all_pairs=True)
    assert found.pairs.tolist() == expected


@pytest.mark.parametrize("world", [manhattan(60, 80, extent=5), sphere(60, 90)], ids=["2D", "3D"])
@pytest.mark.parametrize("align", ["origin", "se3", "sim3"])
def test_an_alignment_undoes_a_motion(world, align):
    frame = [5, -3, 2.0] if world.dimension == 2 else [5, -3, 1, 0.5, -0.5, 0.5, 0.5]
    poses = world.poses.copy()
    scale = 0.25 if align == "sim3" else 1.0
    poses[:, : world.dimension] *= scale
    found = evaluate(world.with_poses(lie.compose(frame, poses)), world, align=align)
    assert found.scale == pytest.approx(1 / scale, rel=1e-12)
    assert max(found.ate.full.max(), found.rpe.full.max()) < 1e-11
    assert_allclose(found.poses[:, :3], found.truth[:, :3], atol=1e-11)
    graph = lie.to_3d(lie.compose(frame, poses))
    graph[:, :3] *= found.scale
    assert_allclose(lie.compose(found.transform, graph), found.poses, atol=1e-11)


@pytest.mark.parametrize("align", ["se3", "sim3"])
def test_no_other_alignment_is_better(align):
    rng = np.random.default_rng(1)
    truth = sphere(60, 90)
    noisy = truth.poses.copy()
    noisy[:, :3] += rng.normal(size=(60, 3))
    found = evaluate(truth.with_poses(noisy), truth, align=align)
    least = (found.ate.translation**2).sum()
    for _ in range(50):
        step = np.append(rng.normal(size=3) * 0.01, [*(rng.normal(size=3) * 0.01), 1])
        step[3:] /= np.linalg.norm(step[3:])
        moved = found.poses.copy()
        if align == "sim3":
            moved[:, :3] *= 1 + 0.01 * rng.normal()
        moved = lie.compose(step, moved)
        assert ((moved[:, :3] - found.truth[:, :3]) ** 2).sum() > least


def test_a_mirrored_map_is_turned_in_its_plane_alone():
    mirrored = [(x, -y, -heading) for x, y, heading in CORNER]
    found = evaluate(trajectory(mirrored), trajectory(CORNER))
    assert_allclose(found.poses[:, 2:5], 0)
    assert found.ate.translation.max() > 0.1
    # Turned over about an axis in the plane, its positions would fit, as those of a 3D map do.
    space = evaluate(trajectory(lie.to_3d(mirrored)), trajectory(CORNER))
    assert space.ate.translation.max() < 1e-12


def test_a_planar_line_determines_an_alignment_but_a_spatial_one_does_not():
    assert evaluate(trajectory(LINE), trajectory(LINE)).ate.full.max() < 1e-14
    for truth in (trajectory(lie.to_3d(LINE)), trajectory(lie.to_3d([(1, 1, 0)] * 4))):
        with pytest.raises(EvaluationError, match="all the same or on one line"):
            evaluate(trajectory(LINE), truth)
    with pytest.raises(EvaluationError, match="all the same or on one line"):
        evaluate(trajectory([(1, 2, 3)] * 4), trajectory(LINE))


# --- which poses are compared ---


def test_poses_are_matched_by_the_closest_stamp():
    truth = trajectory(LINE, [0.0, 1.0, 2.0, 3.0])
    graph = trajectory([(7, 0, 0), (8, 0, 0), (9, 0, 0)], [2.004, 0.992, 2.5], ids=[4, 5, 6])
    found = evaluate(graph, truth, align="none")
    assert found.matched_by == "stamps"
    assert found.ids.tolist() == [[5, 1], [4, 2]]
    assert found.notes == ("1 of 3 poses have no match and do not count",)
    wider = evaluate(graph, truth, align="none", max_difference=0.5)
    assert wider.ids.tolist() == [[5, 1], [4, 2], [6, 2]]  # a tie: the earlier one
    assert evaluate(truth, graph, align="none").ids.tolist() == [[1, 5], [2, 4]]


def test_the_map_with_fewer_poses_looks_for_its_matches():
    few, many = trajectory(LINE[:2], [0.0, 1.0]), trajectory(LINE, [0.0, 0.005, 1.0, 1.005])
    assert evaluate(few, many, align="none").ids.tolist() == [[0, 0], [1, 2]]
    assert evaluate(many, few, align="none").ids.tolist() == [[0, 0], [2, 1]]


@pytest.mark.parametrize("unit", ["both", "graph", "truth"])
def test_nanoseconds_are_compared_with_seconds(unit):
    start = 1305031098665900000
    whole = np.arange(4) * 10**9 + start
    seconds = whole / 1e9
    graph = trajectory(LINE, whole + 5_000_000 if unit != "truth" else seconds + 0.005)
    truth = trajectory(LINE, whole if unit != "graph" else seconds)
    found = evaluate(graph, truth, align="none")
    assert found.ids.tolist() == [[k, k] for k in range(4)]
    with pytest.raises(EvaluationError, match=r"no stamps .* within 0.004 s .* allow a larger"):
        evaluate(graph, truth, max_difference=0.004)


def test_differences_of_nanoseconds_are_exact():
    start = 2**62
    graph = trajectory(LINE, np.arange(4) * 100 + start)
    truth = trajectory(LINE, np.arange(4) * 100 + start + 49)
    assert evaluate(graph, truth, align="none").ate.translation.max() == 0
    far = trajectory(LINE, [-(2**63), 0, 10**9, 2**63 - 1])
    assert evaluate(far, far, align="none", max_difference=0).ids.tolist() == [
        [k, k] for k in range(4)
    ]


def test_poses_are_matched_by_id_where_stamps_are_missing():
    graph = trajectory(LINE[1:], [1.0, 2, 3], ids=[1, 2, 8])
    found = evaluate(graph, trajectory(LINE), align="none")
    assert found.matched_by == "ids"
    assert found.ids.tolist() == [[1, 1], [2, 2]]
    stamped = trajectory(LINE, [5.0, 6, 7, 8])
    assert evaluate(graph, stamped, align="none", match="ids").ids.tolist() == [[1, 1], [2, 2]]


def test_a_map_in_parts_is_noted():
    world = manhattan(60, 80, extent=5)
    cut = world.without_edges((world.edges > 30).any(axis=1) & (world.edges <= 30).any(axis=1))
    (note,) = evaluate(cut, world).notes
    assert note.startswith("the map has 2 components in frames of their own")
    assert evaluate(cut.with_fixed([0, 59]), world).notes == ()


@pytest.mark.parametrize(
    ("graph", "options", "message"),
    [
        (PoseGraph.from_arrays([(0, 1)], [(1, 0, 0)]), {}, "the map has no poses to compare"),
        (trajectory(LINE, ids=[7, 8, 9, 10]), {}, "have no node id in common"),
        (trajectory(LINE), {"match": "stamps"}, "the map has no stamps: match by node id"),
        (trajectory(LINE), {"match": "names"}, "match must be"),
        (trajectory(LINE), {"align": "SE3"}, "align must be"),
        (trajectory(LINE), {"delta": 4}, "no two of the 4 poses .* are 4 frames apart"),
        (trajectory(LINE), {"delta": 1.5}, "delta must be a positive integer in frames, got 1.5"),
        (trajectory(LINE), {"delta": 0}, "delta must be a positive integer in frames"),
        (trajectory(LINE), {"delta": -1, "unit": "meters"}, "delta must be positive in meters"),
        (trajectory(LINE), {"delta": np.nan, "unit": "meters"}, "delta must be positive"),
        (trajectory(LINE), {"delta": np.inf}, "delta must be a positive integer"),
        (trajectory(LINE), {"unit": "feet"}, 'the unit of delta must be "frames" or "meters"'),
        (trajectory(LINE), {"delta": 9, "unit": "meters"}, "are 9 meters apart"),
        (
            trajectory(LINE),
            {"delta": 9, "unit": "meters", "all_pairs": True},
            "are 9 meters apart: choose a smaller delta",
        ),
        (trajectory(LINE, [0.0, 1, 2, 3]), {"max_difference": -1}, "is negative"),
        (trajectory(LINE, [0.0, 1, 2, 3]), {"max_difference": np.nan}, "is negative"),
        (trajectory(LINE, [9.0, 10, 11, 12]), {}, "the map is from 9 to 12 s, the truth from 0"),
    ],
)
def test_what_cannot_be_compared_is_refused(graph, options, message):
    truth = trajectory(LINE, None if graph.stamps is None else [0.0, 1, 2, 3])
    with pytest.raises(EvaluationError, match=message):
        evaluate(graph, truth, **options)


def test_an_evaluation_can_be_pickled_and_not_changed():
    found = evaluate(trajectory(CORNER), trajectory(CORNER))
    again = pickle.loads(pickle.dumps(found))
    assert again.to_dict() == found.to_dict()
    for array in (found.poses, found.ate.full, again.ids, again.rpe.rotation):
        assert not array.flags.writeable
    assert repr(found).startswith("Evaluation(3 poses matched by ids, rmse: ATE ")


# --- a plain implementation, with 4x4 matrices ---


def matrices(poses):
    x, y, z, w = poses[:, 3:].T
    out = np.tile(np.eye(4), (len(poses), 1, 1))
    out[:, :3, :3] = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    ).transpose(2, 0, 1)
    out[:, :3, 3] = poses[:, :3]
    return out


def plain_errors(steps):
    turn = steps[:, :3, :3]
    sine = np.stack([turn[:, a, b] - turn[:, b, a] for a, b in ((2, 1), (0, 2), (1, 0))], axis=1)
    return {
        "translation": np.linalg.norm(steps[:, :3, 3], axis=1),
        "rotation": np.arctan2(np.linalg.norm(sine, axis=1), np.trace(turn, axis1=1, axis2=2) - 1),
        "full": np.linalg.norm(steps - np.eye(4), axis=(1, 2)),
    }


@pytest.mark.parametrize("dimension", [2, 3])
def test_errors_are_those_of_matrices(dimension):
    world = manhattan(200, 300, extent=8) if dimension == 2 else sphere(200, 300)
    noise = (0.05, 0.05, 0.02) if dimension == 2 else (0.05, 0.02)
    chain = initialize(perturb(world, noise), "odometry")
    found = evaluate(chain, world, delta=7, all_pairs=True)
    inverse = np.linalg.inv
    true, poses = matrices(found.truth), matrices(found.poses)
    assert_array_equal(found.truth, lie.to_3d(world.poses))
    motions = [inverse(m[:-7]) @ m[7:] for m in (true, poses)]
    for errors, steps in (
        (found.ate, inverse(true) @ poses),
        (found.rpe, inverse(motions[0]) @ motions[1]),
    ):
        for name, expected in plain_errors(steps).items():
            assert_allclose(getattr(errors, name), expected, atol=1e-9)


# --- the command line ---


@pytest.fixture
def solved(tmp_path):
    """A truth and a map of it, as files of all kinds."""
    truth = manhattan(100, 150, extent=6).with_stamps(np.arange(100) * 0.1 + 1.3e9)
    result = solve(perturb(truth, (0.05, 0.05, 0.02)))
    result.save(tmp_path / "map.npz")
    for suffix in (".g2o", ".tum", ".kitti"):
        write(truth, tmp_path / f"truth{suffix}")
        write(result.graph, tmp_path / f"map{suffix}")
    return result.graph, truth


@pytest.mark.parametrize("estimate", ["map.g2o", "map.tum", "map.kitti", "map.npz"])
@pytest.mark.parametrize("truth", ["truth.g2o", "truth.tum", "truth.kitti"])
def test_evaluate_takes_files_of_all_kinds(run, solved, estimate, truth):
    code, text, err = run("evaluate", estimate, truth, "--json", "--delta", 3)
    found = json.loads(text)
    assert (code, err) == (0, "")
    expected = evaluate(*solved, delta=3).to_dict()
    assert found["ate"]["translation"]["rmse"] == pytest.approx(
        expected["ate"]["translation"]["rmse"], rel=1e-9
    )
    assert found["rpe"]["pairs"] == 33
    assert found["rpe"]["full"]["max"] == pytest.approx(expected["rpe"]["full"]["max"], rel=1e-9)
    assert found["matched_by"] == ("ids" if "kitti" in estimate + truth else "stamps")


def test_evaluate_prints_a_table_and_draws(run, solved, tmp_path):
    code, text, err = run("evaluate", "map.g2o", "truth.tum", "--plot", "e.png", "--align", "sim3")
    assert (code, err) == (0, "")
    found = evaluate(*solved, align="sim3")
    assert "100, matched by stamp" in text
    assert f"a rigid motion and the scale {found.scale:.6g}" in text
    rmse = found.ate.statistics()["rotation"]["rmse"]
    assert f"ATE, rotation (deg) {np.degrees(rmse):>20.6g}".split() == next(
        line.split()[:4] for line in text.splitlines() if "ATE, rotation" in line
    )
    assert "RPE, 1 frame, translation (m)" in text
    assert (tmp_path / "e.png").read_bytes().startswith(b"\x89PNG")
    assert run("evaluate", "map.g2o", "truth.tum", "-q") == (0, "", "")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["map.g2o", "missing.tum"], "missing.tum: No such file"),
        (["map.g2o", "map.g2o", "--plot", "map.g2o"], "is the input"),
        (["map.g2o", "truth.tum", "--plot", "truth.tum"], "is the input"),
        (["map.g2o", "truth.tum", "--plot", "e.txt"], "a picture ends in"),
        (["map.kitti", "truth.tum", "--match", "stamps"], "the map has no stamps"),
        (["map.g2o", "truth.tum", "--delta", "1000"], "are 1000 frames apart"),
        (["map.g2o", "truth.tum", "--format", "tum"], "map.g2o: the file holds neither"),
        (["map.g2o", "truth.tum", "--truth-format", "kitti"], "truth.tum:1: a line takes"),
        (["map.g2o", "bad.npz"], "bad.npz: not a saved result"),
    ],
)
def test_evaluate_refuses(run, solved, tmp_path, arguments, message):
    (tmp_path / "bad.npz").write_bytes(b"PK\x03\x04 nothing")
    before = sorted(tmp_path.iterdir())
    code, text, err = run("evaluate", *arguments)
    assert (code, text) == (2, "")
    assert message in err.splitlines()[-1]
    assert sorted(tmp_path.iterdir()) == before


def test_evaluate_ignores_the_information_of_edges(run, solved, tmp_path):
    edge = "EDGE_SE2 0 1 1 0 0 -1 0 0 1 0 1\n"
    (tmp_path / "bad.g2o").write_text((tmp_path / "map.g2o").read_text() + edge)
    code, _, err = run("evaluate", "bad.g2o", "truth.g2o")
    assert code == 0
    assert "not positive" in err


@pytest.mark.parametrize(
    ("source", "target", "shown"),
    [
        ("map.g2o", "o.tum", "o.tum: 100 poses"),
        ("map.npz", "o.kitti", "o.kitti: 100 poses"),
        ("map.npz", "o.g2o", "o.g2o: 100 nodes, 150 edges"),
        ("map.tum", "o.g2o.gz", "o.g2o.gz: 100 nodes, 0 edges"),
        ("map.tum", "o.kitti.gz", "o.kitti.gz: 100 poses"),
    ],
)
def test_convert_picks_the_format_by_suffix(run, solved, source, target, shown):
    code, text, err = run("convert", source, target)
    assert (code, text.strip()) == (0, shown)
    lost = []
    if ".tum" not in source and ".g2o" not in target:
        lost.append("note: a trajectory holds poses alone: 150 edges are not written")
    if ".kitti" in target:
        lost.append("note: the format 'kitti' has no stamps: they are not written")
    assert err.splitlines() == lost
    again = read(target)
    poses = solved[0].poses if again.dimension == 2 else lie.to_3d(solved[0].poses)
    assert np.abs(lie.local(again.poses, poses)).max() < 1e-15
    assert (again.stamps is None) == (".kitti" in target)


def test_convert_can_be_told_the_format(run, solved, tmp_path):
    assert run("convert", "map.g2o", "poses.txt", "--to", "tum", "-q") == (0, "", "")
    assert (tmp_path / "poses.txt").read_text() == (tmp_path / "map.tum").read_text()
    said = json.loads(run("convert", "poses.txt", "map.csv", "--to", "kitti", "--json")[1])
    assert said["format"] == "kitti"
    assert said["notes"] == ["the format 'kitti' has no stamps: they are not written"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["convert", "map.kitti", "o.tum"], "o.tum: the graph has no stamps"),
        (["convert", "bare.g2o", "o.kitti"], "o.kitti: the graph has no poses"),
        (["convert", "map.g2o", "o.npz"], "o.npz: the suffix '.npz' belongs to no format"),
        (["convert", "map.g2o", "o.graph"], "o.graph: the suffix '.graph' belongs to no format"),
        (["convert", "map.g2o", "o.g2o", "--to", "toro"], "'toro' is not one of"),
        (["solve", "bare.g2o", "-o", "o.tum"], "o.tum: the graph has no stamps"),
        (["certify", "map.kitti", "-o", "o.tum"], "o.tum: the graph has no stamps"),
    ],
)
def test_what_a_format_cannot_hold_is_refused_before_the_work(
    run, solved, tmp_path, arguments, message
):
    write(PoseGraph.from_arrays([(0, 1)], [(1, 0, 0)]), tmp_path / "bare.g2o")
    before = sorted(tmp_path.iterdir())
    code, text, err = run(*arguments)
    assert (code, text) == (2, "")
    assert message in err
    assert sorted(tmp_path.iterdir()) == before


def test_solve_keeps_stamps_and_writes_trajectories(run, solved, tmp_path):
    assert run("solve", "truth.g2o", "-o", "o.tum", "-q") == (0, "", "")
    assert_array_equal(read("o.tum").stamps, solved[1].stamps)
