"""g2o's priors, landmarks and sensor offsets: what they cost, and that they read back the same."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from test_measurements import graph_of_everything

import masat
from masat import FormatError, GraphError, MasatWarning, PoseGraph, lie

# Costs of the edges, priors and observations; those of the planar file are g2o's own to all digits.
PLANAR = """\
VERTEX_SE2 0 0 0 0
VERTEX_SE2 1 1 .1 1.5
VERTEX_XY 7 2 1
EDGE_SE2 0 1 1 0 1.57 1 0 0 2 0 3
EDGE_PRIOR_SE2 0 .1 .2 .3 1 .1 .2 2 .3 3
EDGE_PRIOR_SE2_XY 1 1.1 .3 2 .5 3
EDGE_PRIOR_XY 7 2.5 1.5 1 0 2
EDGE_SE2_XY 0 7 2.1 1.2 1 .2 2
EDGE_SE2_XY 1 7 .9 -.8 1 .2 2
"""
PLANAR_COSTS = (
    [0.024700006341362424],
    [0.3987117273535651, 0.16000000000000003, 0.75],
    [0.09799999999999998, 0.036845565723059796],
)
# The sensor has the x axis along the robot's y axis, y along z, z along x, at (1, 2, 3) of it; the
# robot stands at (10, 0, 0), its x axis along the world's y axis.
# The landmark of the planar file is at (2, 1), which is (1, 0.9) from node 1, whose heading is 1.5.
# g2o's error of a bearing is the difference of the angles.
BEARINGS = """\
EDGE_BEARING_SE2_XY 0 7 .5 4
EDGE_SE2_XY 0 7 2.1 1.2 1 .2 2
EDGE_BEARING_SE2_XY 1 7 -.8 9
EDGE_RANGE_BEARING_SE2_XY 1 7 1.2 -.7 4 .5 9
EDGE_RANGE_BEARING_SE2_XY 0 7 2 0 1 0 0
"""
SPATIAL = """\
PARAMS_SE3OFFSET 4 1 2 3 .5 .5 .5 .5
PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1
VERTEX_SE3:QUAT 1 10 0 0 0 0 0.70710678118654757 0.70710678118654757
VERTEX_TRACKXYZ 7 8 1 4
EDGE_SE3_PRIOR 1 4 8 1 4 -0.5 0.5 -0.5 0.5 1 0 0 0 0 0 2 0 0 0 0 3 0 0 0 4 0 0 5 0 6
EDGE_SE3_XYZ_PRIOR 1 4 10 1 2 1 0 0 2 0 3
EDGE_POINTXYZ_PRIOR 7 8 2 4 1 0 0 2 .5 3
EDGE_SE3_TRACKXYZ 1 7 4 1 2 0 1 0 0 2 0 3
EDGE_SE3_TRACKXYZ 1 7 0 1 2 3 1 0 0 2 0 3
"""


def costs(graph):
    return graph.chi2_per_edge, graph.chi2_per_prior, graph.chi2_per_observation


@pytest.fixture
def read(tmp_path):
    def read(text):
        path = tmp_path / "graph.g2o"
        path.write_text(text)
        return masat.read(path)

    return read


def test_costs_of_a_planar_file_are_those_of_g2o(read):
    for ours, theirs in zip(costs(read(PLANAR)), PLANAR_COSTS, strict=True):
        assert_allclose(ours, theirs, rtol=1e-9)


def test_costs_of_bearings_by_hand(read):
    graph = read(PLANAR + BEARINGS)
    assert graph.notes == ()
    far, angle = 1.81**0.5, np.arctan2(0.9, 1) - 1.5
    expected = [
        4 * (np.arctan2(1, 2) - 0.5) ** 2,
        PLANAR_COSTS[2][0],
        9 * (angle + 0.8) ** 2,
        4 * (far - 1.2) ** 2 + (far - 1.2) * (angle + 0.7) + 9 * (angle + 0.7) ** 2,
        (5**0.5 - 2) ** 2,
    ]
    assert_allclose(graph.chi2_per_observation[2:], expected, rtol=1e-9)


def test_a_bearing_is_wrapped_as_in_g2o(read):
    # The landmark is at 3, measured at -3: g2o takes the shorter way, 2 pi - 6.
    x, y = np.cos(3), np.sin(3)
    graph = read(f"VERTEX_SE2 0 0 0 0\nVERTEX_XY 7 {x} {y}\nEDGE_BEARING_SE2_XY 0 7 -3 1\n")
    assert_allclose(graph.chi2, (2 * np.pi - 6) ** 2, rtol=1e-9)


def test_costs_of_a_spatial_file_by_hand(read):
    graph = read(SPATIAL)
    # The robot's frame: x is the world's y, y its -x. The sensor is at (10 - 2, 1, 3), one below
    # what the prior says along the world's z, which is the z axis of the measurement turned back by
    # its own rotation.
    prior, position, point = graph.chi2_per_prior
    z = masat.lie.local(
        [8, 1, 4, -0.5, 0.5, -0.5, 0.5],
        masat.lie.compose(graph.poses[0], [1, 2, 3, 0.5, 0.5, 0.5, 0.5]),
    )
    assert_allclose(prior, (z**2 * [1, 2, 3, 4, 5, 6]).sum(), rtol=1e-12)
    assert_allclose(np.linalg.norm(z[:3]), 1)
    # g2o does not apply the sensor's offset to the prior of a position.
    assert_allclose(position, 2 * 1**2 + 3 * 2**2)
    assert_allclose(point, 2)
    # In the robot's frame the landmark is at (1, 2, 4), 1 along z from the sensor: its y axis.
    assert_allclose(graph.chi2_per_observation, [1 + 2, 3], atol=1e-12)


@pytest.mark.parametrize("text", [PLANAR, PLANAR + BEARINGS, SPATIAL])
def test_files_read_back_the_same(read, text, tmp_path):
    graph = read(text)
    masat.write(graph, tmp_path / "again.g2o")
    again = masat.read(tmp_path / "again.g2o")
    assert again.notes == ()
    assert_array_equal(again.priors.ids, graph.priors.ids)
    assert_array_equal(again.priors.measurements, graph.priors.measurements)
    assert_array_equal(again.priors.information, graph.priors.information)
    assert_array_equal(again.points, graph.points)
    assert_array_equal(again.landmarks.observations, graph.landmarks.observations)
    assert again.chi2 == graph.chi2
    masat.write(again, tmp_path / "twice.g2o")
    assert (tmp_path / "twice.g2o").read_bytes() == (tmp_path / "again.g2o").read_bytes()


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("d", [2, 3])
def test_any_graph_reads_back_the_same(d, seed, tmp_path):
    graph = graph_of_everything(d, seed, offset=d == 3)
    masat.write(graph, tmp_path / "graph.g2o.gz")
    again = masat.read(tmp_path / "graph.g2o.gz")
    assert_array_equal(again.priors.ids, graph.priors.ids)
    assert_array_equal(again.landmarks.range_bearing, graph.landmarks.range_bearing)
    assert_array_equal(again.landmarks.information, graph.landmarks.information)
    assert again.chi2 == graph.chi2


def test_a_lever_arm_in_2d_has_no_tag(tmp_path):
    with pytest.raises(GraphError, match="no tag for priors in 2D with a lever arm"):
        masat.write(graph_of_everything(2), tmp_path / "graph.g2o")


def test_an_offset_in_2d_is_the_same_observation_from_the_sensor(read):
    graph = read(
        "PARAMS_SE2OFFSET 1 1 0 1.5707963267948966\nVERTEX_SE2 0 0 0 0\nVERTEX_XY 7 0 5\n"
        "EDGE_SE2_POINTXY_OFFSET 0 7 1 5 2 1 0 4\n"
    )
    # From (1, 0), looking along y, the landmark is at (5, 1).
    assert_allclose(graph.chi2, 4 * 1)


@pytest.mark.parametrize(
    ("line", "meaning"),
    [
        ("EDGE_SE2_XY_CALIB 0 7 3 1 1 1 0 1", "observations of landmarks whose sensor offset"),
        ("EDGE_SE2_LOTSOFXY 0 1 7 1 1", "observations of many landmarks"),
        ("PARAMS_CAMERACALIB 0 1 1 1", "calibrations of cameras"),
        ("EDGE_POINTXY 7 8 0 0 1 0 1", "relative positions of two landmarks"),
    ],
)
def test_other_tags_are_skipped_by_name_with_what_they_hold(read, line, meaning):
    tag = line.split()[0]
    with pytest.warns(MasatWarning, match=f"1 line with the tag {tag} skipped .*: {meaning}"):
        read(f"{PLANAR}{line}\n")


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("EDGE_PRIOR_SE2 0 1 2", "EDGE_PRIOR_SE2 takes: id x y theta"),
        ("EDGE_PRIOR_SE2 9 0 0 0 1 0 0 1 0 1", "10: a prior names node 9"),
        ("EDGE_PRIOR_SE2 7 0 0 0 1 0 0 1 0 1", "10: the prior of landmark 7 measures a rotation"),
        ("EDGE_SE2_XY 9 7 1 2 1 0 1", r"10: observation 2 \(9 -> 7\) names pose 9"),
        ("EDGE_PRIOR_SE2_XY 0 1 2 -1 0 1", "10: .*prior of node 0, smallest eigenvalue -1"),
        ("EDGE_SE2_XY 0 9 1 2 1 0 1", "10: observation 2 .* names no landmark"),
        ("EDGE_SE2_XY 0 7 1 2 1 0", "10: EDGE_SE2_XY takes: pose point x y"),
        ("EDGE_SE2_POINTXY_OFFSET 0 7 3 1 2 1 0 1", "10: the line refers to the parameter 3"),
        (
            "EDGE_BEARING_SE2_XY 0 7 .1",
            "10: EDGE_BEARING_SE2_XY takes: pose point bearing [+] 1 inf",
        ),
        ("EDGE_BEARING_SE2_XY 0 7 .1 0", "10: .*zero or not positive semidefinite"),
        ("EDGE_BEARING_SE2_XY 0 7 nan 1", "10: found a number that is not finite"),
        ("EDGE_RANGE_BEARING_SE2_XY 0 7 -1 .1 1 0 1", "10: the range of observation 2 .* is -1 m"),
        ("EDGE_RANGE_BEARING_SE2_XY 0 7 1 .1 1 0", "takes: pose point range bearing [+] 3 inf"),
        ("EDGE_RANGE_BEARING_SE3_XYZ 0 7 1 0 0 1 0 0 1 0 1", "10: .* is 3D, the lines before"),
        ("FIX 7", "10: FIX names the landmark 7"),
        ("VERTEX_XY 0 1 1", "10: the id 0 is that of a pose and of a landmark"),
        ("VERTEX_TRACKXYZ 8 1 1 1", "10: VERTEX_TRACKXYZ is 3D"),
    ],
)
def test_bad_lines_are_one_clear_error(read, line, message):
    with pytest.raises(FormatError, match=message):
        read(f"{PLANAR}{line}\n")


SEEN = """\
EDGE_SE2 0 1 1 0 1.57 1 0 0 2 0 3
EDGE_SE2_XY 0 7 2.1 1.2 1 .2 2
"""


def test_a_landmark_without_a_vertex_is_named_where_it_is_first_seen(read):
    with pytest.raises(FormatError, match="g2o:2: FIX names the landmark 7"):
        read("EDGE_SE2_XY 0 7 1 1 1 0 1\nFIX 7\n")
    with pytest.raises(FormatError, match="g2o:2: the id 7 is that of a pose and of a landmark"):
        read(f"{SEEN}EDGE_SE2 1 7 1 0 0 1 0 0 1 0 1\n")


@pytest.mark.parametrize("quaternion", ["0 0 0 2", "0.5 0.5 0.5 0", "0 0 1e200 1"])
def test_an_offset_that_is_no_rotation_is_refused_wherever_it_is_used(read, quaternion):
    text = SPATIAL.replace("4 1 2 3 .5 .5 .5 .5", f"4 1 2 3 {quaternion}")
    for unused in ("EDGE_SE3_PRIOR", "EDGE_SE3_TRACKXYZ"):
        lines = [line for line in text.splitlines() if not line.startswith(unused)]
        with pytest.raises(FormatError, match="g2o:1: the offset of parameter 4 has a quaternion"):
            read("\n".join(lines))


@pytest.mark.parametrize("d", [2, 3])
def test_the_prior_of_a_landmark_is_written_in_the_axes_of_the_world(d, tmp_path):
    # A quarter turn about z: what the prior calls x is y of the world.
    pose = [5, 0, np.pi / 2] if d == 2 else [5, 0, 0, 0, 0, np.sqrt(0.5), np.sqrt(0.5)]
    information = np.zeros((lie.DOF[d], lie.DOF[d]))
    information[range(d), range(d)] = [4, 1, 1][:d]
    position = np.array([6.0, 3, 0][:d])
    graph = PoseGraph.from_arrays(
        [],
        np.empty((0, len(pose))),
        ids=[0],
        poses=[lie.identity(d)],
        priors=masat.pose_priors([9], [pose], information),
        landmarks=masat.landmarks([(0, 9)], [position], positions=[position]),
    )
    assert_allclose(graph.chi2, 1 * 1 + 4 * 9)
    masat.write(graph, tmp_path / "graph.g2o")
    again = masat.read(tmp_path / "graph.g2o")
    assert_allclose(again.chi2, graph.chi2)
    assert_allclose(again.priors.information[0, :2, :2], [[1, 0], [0, 4]], atol=1e-12)


def test_fixed_nodes_that_no_edge_names_are_written_and_read(tmp_path):
    graph = PoseGraph.from_arrays(
        [(0, 1)],
        [(1, 0, 0)],
        ids=[0, 1, 2, 3],
        fixed=[2, 3],
        priors=masat.gps([2], [(0, 0)], 1),
        landmarks=masat.landmarks([(0, 9), (3, 9)], [(1, 1), (1, 0)]),
    )
    masat.write(graph, tmp_path / "graph.g2o")
    again = masat.read(tmp_path / "graph.g2o")
    assert_array_equal(again.ids, graph.ids)
    assert_array_equal(again.fixed, [2, 3])


@pytest.mark.parametrize("priors", [None, masat.gps([9], [(1, 1)], 1)])
def test_a_landmark_that_no_line_can_hold_is_not_lost_silently(priors, tmp_path):
    graph = PoseGraph.from_arrays(
        [(0, 1)],
        [(1, 0, 0)],
        priors=priors,
        landmarks=masat.landmarks([(0, 8)], [(1, 1)], ids=[8, 9]),
    )
    with pytest.raises(GraphError, match="the landmark 9 has no position and no pose saw it"):
        masat.write(graph, tmp_path / "graph.g2o")
    placed = graph.with_points([(1, 1), (2, 2)])
    masat.write(placed, tmp_path / "graph.g2o")
    again = masat.read(tmp_path / "graph.g2o")
    assert_array_equal(again.point_ids, [8, 9])
    assert_array_equal(again.points, placed.points)
