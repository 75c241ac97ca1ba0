"""ATE and RPE equal evo's, which reads our trajectories unchanged.

evo is under the GPL, so no extra of the package has it: `make test-evo` installs it.
"""

import copy

import numpy as np
import pytest

from masat import evaluate, initialize, read, solve, write
from masat.worlds import manhattan, perturb, sphere

pytest.importorskip("evo", reason="evo is not installed: make test-evo")
from evo.core import metrics, sync
from evo.tools import file_interface

RELATIONS = {
    "translation": metrics.PoseRelation.translation_part,
    "rotation": metrics.PoseRelation.rotation_angle_rad,
    "full": metrics.PoseRelation.full_transformation,
}
UNITS = {"frames": metrics.Unit.frames, "meters": metrics.Unit.meters}
ALIGNMENTS = ("none", "origin", "se3", "sim3")


def worlds():
    plane = manhattan(400, 600, extent=12, seed=1)
    space = sphere(400, 800, seed=1)
    yield "plane", plane, perturb(plane, (0.05, 0.05, 0.01), seed=2)
    yield "space", space, perturb(space, (0.05, 0.01), seed=2)


@pytest.fixture(scope="module", params=worlds(), ids=lambda world: world[0])
def files(request, tmp_path_factory):
    """A map and its truth as files: of different lengths, frames and scales."""
    folder = tmp_path_factory.mktemp("evo")
    _, truth, measured = request.param
    n = len(truth)
    rng = np.random.default_rng(3)
    stamps = 1.3e9 + np.cumsum(rng.uniform(0.02, 0.2, n))
    chain = initialize(measured, "odometry")
    poses = chain.poses.copy()
    poses[:, : truth.dimension] *= 1.3
    every = chain.with_poses(poses).with_stamps(stamps + rng.uniform(-0.008, 0.008, n))
    estimate = every.without_nodes(every.ids[rng.random(n) < 0.2])
    for name, graph in (("map", estimate), ("every", every), ("truth", truth.with_stamps(stamps))):
        write(graph, folder / f"{name}.tum")
        write(graph, folder / f"{name}.kitti")
        write(graph, folder / f"{name}.g2o")
    return folder


def evo_errors(reference, estimate, align, metric):
    if align in ("se3", "sim3"):
        estimate.align(reference, correct_scale=align == "sim3")
    elif align == "origin":
        estimate.align_origin(reference)
    metric.process_data((reference, estimate))
    return metric.error


def by_stamp(folder):
    return sync.associate_trajectories(
        file_interface.read_tum_trajectory_file(str(folder / "truth.tum")),
        file_interface.read_tum_trajectory_file(str(folder / "map.tum")),
    )


def by_line(folder):
    return [
        file_interface.read_kitti_poses_file(str(folder / f"{name}.kitti"))
        for name in ("truth", "every")
    ]


def differences(ours, theirs):
    assert len(ours) == len(theirs)
    worst = float(np.abs(ours - theirs).max())
    print(f"largest difference: {worst:.3g}")
    return worst


@pytest.mark.parametrize("relation", RELATIONS)
@pytest.mark.parametrize("align", ALIGNMENTS)
@pytest.mark.parametrize("suffix", ["tum", "g2o"])
def test_ate_by_stamp(files, align, relation, suffix):
    found = evaluate(read(files / f"map.{suffix}"), read(files / f"truth.{suffix}"), align=align)
    assert found.matched_by == "stamps"
    theirs = evo_errors(*by_stamp(files), align, metrics.APE(RELATIONS[relation]))
    assert differences(getattr(found.ate, relation), theirs) < 1e-9


@pytest.mark.parametrize("relation", RELATIONS)
@pytest.mark.parametrize("align", ALIGNMENTS)
def test_ate_by_line(files, align, relation):
    found = evaluate(read(files / "every.kitti"), read(files / "truth.kitti"), align=align)
    assert found.matched_by == "ids"
    theirs = evo_errors(*by_line(files), align, metrics.APE(RELATIONS[relation]))
    assert differences(getattr(found.ate, relation), theirs) < 1e-9


@pytest.mark.parametrize("relation", RELATIONS)
@pytest.mark.parametrize("all_pairs", [False, True])
@pytest.mark.parametrize(
    ("delta", "unit"), [(1, "frames"), (7, "frames"), (2.5, "meters"), (20.0, "meters")]
)
@pytest.mark.parametrize("align", ["se3", "sim3"])
def test_rpe(files, delta, unit, all_pairs, relation, align):
    options = {"align": align, "delta": delta, "unit": unit, "all_pairs": all_pairs}
    found = evaluate(read(files / "map.tum"), read(files / "truth.tum"), **options)
    metric = metrics.RPE(RELATIONS[relation], delta, UNITS[unit], all_pairs=all_pairs)
    theirs = evo_errors(*by_stamp(files), align, metric)
    assert found.pairs[:, 1].tolist() == metric.delta_ids
    assert differences(getattr(found.rpe, relation), theirs) < 1e-9


def test_statistics(files):
    found = evaluate(read(files / "map.tum"), read(files / "truth.tum"))
    metric = metrics.APE(RELATIONS["translation"])
    evo_errors(*by_stamp(files), "se3", metric)
    theirs = metric.get_all_statistics()
    for name, value in found.ate.statistics()["translation"].items():
        assert value == pytest.approx(theirs[name], abs=1e-9)


@pytest.mark.parametrize(
    ("graph", "truth"),
    [
        ("2d/input_M3500_g2o.g2o", "M3500_groundtruth.g2o"),
        ("3d/sphere2500.g2o", "sphere2500_groundtruth.g2o"),
        ("2d/kitti_00.g2o", None),
    ],
)
@pytest.mark.parametrize("align", ["se3", "sim3"])
def test_ate_of_public_graphs(data_dir, tmp_path, graph, truth, align):
    """With the solution as truth where there is no other."""
    graph = read(data_dir / graph)
    chain = initialize(graph, "odometry")
    true = solve(graph, init="odometry").graph if truth is None else read(data_dir / truth)
    for name, poses in (("every", chain), ("truth", true)):
        write(poses, tmp_path / f"{name}.kitti")
        write(poses.with_stamps(0.1 * np.arange(len(poses))), tmp_path / f"{name}.tum")
    found = evaluate(chain, true, align=align)
    assert len(found.ids) == len(graph)
    reference, estimate = (
        file_interface.read_tum_trajectory_file(str(tmp_path / f"{name}.tum"))
        for name in ("truth", "every")
    )
    for pair in (by_line(tmp_path), (reference, estimate)):
        for name, relation in RELATIONS.items():
            aligned = copy.deepcopy(pair[1])
            theirs = evo_errors(pair[0], aligned, align, metrics.APE(relation))
            assert differences(getattr(found.ate, name), theirs) < 1e-9
