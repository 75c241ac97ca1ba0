"""JSON robot logs: gtsam's factors, their order of covariances, and what a log may lack."""

import json

import numpy as np
import pytest
from random_graphs import random_graph

import masat
from masat import FormatError, lie

ROTATION_FIRST = [3, 4, 5, 0, 1, 2]
# gtsam's step is the rotation vector, g2o's half of it.
HALVES = np.array([0.5, 0.5, 0.5, 1, 1, 1])
A = 97 << 56


def pose_value(pose):
    if len(pose) == 3:
        return {"type": "Pose2", "x": pose[0], "y": pose[1], "theta": pose[2]}
    x, y, z, qx, qy, qz, qw = pose
    return {"type": "Pose3", "translation": [x, y, z], "rotation": [qw, qx, qy, qz]}


def covariance(information):
    if len(information) == 3:
        return np.linalg.inv(information).ravel().tolist()
    w = information[ROTATION_FIRST][:, ROTATION_FIRST] * np.outer(HALVES, HALVES)
    return np.linalg.inv(w).ravel().tolist()


def log_of(measurements, **more):
    entry = {"stamp": 0, "measurements": measurements}
    return {"name": "test", "robots": ["a"], "measurements": {"a": [entry]}} | more


def saved(tmp_path, log):
    path = tmp_path / "log.jrl"
    path.write_text(json.dumps(log))
    return path


@pytest.mark.parametrize("d", [2, 3])
def test_edges_and_initialization_are_those_of_the_log(tmp_path, d):
    graph = random_graph(d, 8, 14, seed=1, noise=0.1)
    rng = np.random.default_rng(2)
    root = rng.normal(size=(len(graph.edges), graph.dof, graph.dof))
    w = root @ root.transpose(0, 2, 1) + np.eye(graph.dof)
    factors = [
        {
            "type": f"BetweenFactorPose{d}",
            "key1": int(a) + A,
            "key2": int(b) + A,
            "measurement": pose_value(z.tolist()),
            "covariance": covariance(own),
        }
        for (a, b), z, own in zip(graph.edges, graph.measurements, w, strict=True)
    ]
    values = {
        str(node + A): pose_value(pose.tolist())
        for node, pose in zip(graph.ids.tolist(), graph.poses, strict=True)
    }
    read = masat.read(saved(tmp_path, log_of(factors, initialization={"a": values})))
    assert (read.ids == graph.ids + A).all()
    assert (read.edges == graph.edges + A).all()
    assert np.allclose(read.information, w, rtol=1e-9)
    assert np.allclose(lie.local(read.poses, graph.poses), 0, atol=1e-12)
    expected = masat.PoseGraph.from_arrays(graph.edges, graph.measurements, w, poses=graph.poses)
    assert np.isclose(read.chi2, expected.chi2, rtol=1e-9)
    assert read.notes == ()


@pytest.mark.parametrize("d", [2, 3])
def test_priors_and_landmarks_are_read(tmp_path, d):
    world = masat.worlds.WORLDS["manhattan" if d == 2 else "sphere"](30, 40, seed=1)
    rng = np.random.default_rng(0)
    points = world.poses[:3, :d] + rng.normal(size=(3, d))
    factors = [
        {
            "type": f"BetweenFactorPose{d}",
            "key1": int(a),
            "key2": int(b),
            "measurement": pose_value(z.tolist()),
            "covariance": covariance(np.eye(world.dof)),
        }
        for (a, b), z in zip(world.edges, world.measurements, strict=True)
    ]
    factors.append(
        {
            "type": f"PriorFactorPose{d}",
            "key": 0,
            "prior": pose_value(world.poses[0].tolist()),
            "covariance": covariance(np.eye(world.dof)),
        }
    )
    for k, point in enumerate(points):
        for node in range(6):
            ahead = lie.between(world.poses[node], np.append(point, lie.identity(d)[d:]))[:d]
            distance = np.linalg.norm(ahead)
            bearing = [np.arctan2(ahead[1], ahead[0])] if d == 2 else (ahead / distance).tolist()
            seen = {
                "type": f"BearingRangeFactor{d}D",
                "key1": node,
                "key2": 100 + k,
                "measurement": {"bearing": bearing, "range": distance},
                "covariance": np.diag([0.01] * (d - 1) + [0.04]).ravel().tolist(),
            }
            if node == 5:
                seen |= {
                    "type": f"RangeFactor{d}D",
                    "measurement": distance,
                    "covariance": [0.04],
                }
            factors.append(seen)
    factors.append(
        {
            "type": f"PriorFactorPoint{d}",
            "key": 100,
            "prior": dict(zip("xyz", points[0].tolist(), strict=False)),
            "covariance": np.eye(d).ravel().tolist(),
        }
    )
    graph = masat.read(saved(tmp_path, log_of(factors)))
    assert graph.poses is None
    assert graph.point_ids.tolist() == [100, 101, 102]
    result = masat.solve(graph)
    assert result.chi2 < 1e-12
    assert np.allclose(result.graph.points, points, atol=1e-6)
    assert np.allclose(result.poses[:, :d], world.poses[:, :d], atol=1e-6)
    seen = graph.landmarks.information[0]
    assert np.allclose(np.diag(seen), [25] + [100] * (d - 1))


def test_what_is_not_known_is_skipped_by_name(tmp_path):
    factor = {
        "type": "BetweenFactorPose2",
        "key1": 0,
        "key2": 1,
        "measurement": pose_value([1.0, 0, 0]),
        "covariance": np.eye(3).ravel().tolist(),
    }
    other = {"type": "StereoFactor", "key1": 0}
    with pytest.warns(masat.MasatWarning) as told:
        graph = masat.read(
            saved(tmp_path, log_of([factor, other, other], outlier_factors=[[0, 1]]))
        )
    assert len(graph.edges) == 1
    assert "2 measurements of the type StereoFactor skipped" in str(told[0].message)
    assert (
        graph.notes[-1] == "outlier_factors of the log: which measurements are false, is not read"
    )


BETWEEN = {"type": "BetweenFactorPose2", "key1": 0, "key2": 1}
STEP = {"measurement": {"x": 1, "y": 0, "theta": 0}, "covariance": [1, 0, 0, 0, 1, 0, 0, 0, 1]}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "log.jrl:1: not JSON"),
        ("{}", "no JSON robot log"),
        (json.dumps(log_of([])), "holds no measurement"),
        (json.dumps(log_of([BETWEEN])), "robot 'a', entry 0, measurement 0: no 'covariance'"),
        (
            json.dumps(log_of([BETWEEN | STEP, BETWEEN | STEP | {"key1": -1}])),
            "measurement 1: the key -1",
        ),
        (
            json.dumps(log_of([BETWEEN | STEP | {"covariance": [1, 0, 0, 1]}])),
            "must have 9 numbers",
        ),
        (
            json.dumps(log_of([BETWEEN | STEP | {"covariance": [0.0] * 9}])),
            "variances must be positive",
        ),
        (json.dumps(log_of([BETWEEN | STEP | {"measurement": {"x": 1}}])), "no 'y'"),
        (json.dumps(log_of([BETWEEN | STEP, {"type": "RangeFactor3D"}])), "is in 3D"),
        (json.dumps(log_of(3)), "no list"),
    ],
)
def test_a_broken_log_gives_one_error_that_names_the_place(tmp_path, text, message):
    path = tmp_path / "log.jrl"
    path.write_text(text)
    with pytest.raises(FormatError, match=message):
        masat.read(path)
