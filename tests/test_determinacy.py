"""What measurements leave undetermined: by node and direction, before anything is optimized."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import masat
from masat import MasatWarning, OptimizationError, PoseGraph
from masat.assembly import assemble
from masat.freedoms import undetermined

SQUARE = [(0, 1), (1, 2), (2, 3), (3, 0)]
PLANAR = [(1, 0, np.pi / 2)] * 4
SPATIAL = [(1, 0, 0, 0, 0, np.sin(np.pi / 4), np.cos(np.pi / 4))] * 4
CORNERS = [(0, 0), (1, 0), (1, 1), (0, 1)]
HEADINGS = [0, np.pi / 2, np.pi, -np.pi / 2]


def planar(priors=None, landmarks=None):
    poses = [(x, y, t) for (x, y), t in zip(CORNERS, HEADINGS, strict=True)]
    return PoseGraph.from_arrays(SQUARE, PLANAR, poses=poses, priors=priors, landmarks=landmarks)


def spatial(priors=None):
    poses = [
        (x, y, 0, 0, 0, np.sin(t / 2), np.cos(t / 2))
        for (x, y), t in zip(CORNERS, HEADINGS, strict=True)
    ]
    return PoseGraph.from_arrays(SQUARE, SPATIAL, poses=poses, priors=priors)


def fixes(*nodes, height=None):
    more = () if height is None else (height,)
    return masat.gps(nodes, [(*CORNERS[k], *more) for k in nodes], 0.1)


@pytest.mark.parametrize(
    ("graph", "translations", "rotations"),
    [
        (planar(fixes(2)), 0, 1),
        (planar(fixes(0, 2)), 0, 0),
        (planar(masat.headings([1], [np.pi / 2], 0.1)), 2, 0),
        (planar(fixes(2) + masat.headings([1], [np.pi / 2], 0.1)), 0, 0),
        (planar(masat.pose_priors([1], [(1, 0, np.pi / 2)])), 0, 0),
        (planar(masat.pose_priors([0], [(0, 0, 0)], np.diag([1.0, 0, 1]))), 1, 0),
        (spatial(fixes(2, height=0)), 0, 3),
        (spatial(fixes(0, 2, height=0)), 0, 1),
        (spatial(fixes(0, 1, 2, height=0)), 0, 0),
        (spatial(masat.altitudes([0, 1, 2], [0, 0, 0], 0.1)), 2, 1),
        (spatial(masat.altitudes([0, 1], [0, 0], 0.1)), 2, 2),
    ],
)
def test_the_rank_of_the_priors_is_that_of_a_rigid_motion(graph, translations, rotations):
    found = undetermined(assemble(graph))
    assert sum(len(f.translations) for f in found) == translations
    assert sum(len(f.rotations) for f in found) == rotations


def test_fixes_in_a_line_leave_the_rotation_about_it():
    (found,) = undetermined(assemble(spatial(fixes(0, 2, height=0))))
    assert_allclose(np.abs(found.rotations @ [1, 1, 0]) / np.sqrt(2), 1, atol=1e-6)


def test_without_priors_the_gauge_node_is_fixed_and_nothing_is_said():
    assert undetermined(assemble(planar())) == []


def test_a_node_that_partial_edges_hang_on_is_named():
    graph = PoseGraph.from_arrays(
        [*SQUARE, (0, 17), (1, 17)],
        [*PLANAR, (2, 0, 0), (0, -1, 0)],
        [*[np.eye(3)] * 4, *[np.diag([1.0, 1, 0])] * 2],
    )
    with pytest.warns(MasatWarning, match=r"node 17: heading not determined \(seen only by two"):
        result = masat.solve(graph)
    assert result.converged
    assert result.graph.notes[0].endswith("would determine it")


def test_one_fix_is_met_and_the_heading_stays():
    graph = planar(masat.gps([2], [(10, 5)], 0.1))
    with pytest.warns(MasatWarning, match="heading not determined .seen only by one position fix"):
        result = masat.solve(graph, certify=True)
    assert result.chi2 < 1e-20
    assert_allclose(result.poses[2, :2], [10, 5])
    assert result.certificate.certified


def test_landmarks_seen_along_one_ray_are_said_not_crashed():
    seen = masat.landmarks([(0, 10), (2, 11)], [(1, 1), (3, 0)], [np.eye(2), np.diag([0, 1.0])])
    graph = planar(landmarks=seen)
    with pytest.warns(MasatWarning, match="landmark 11: position along x not determined"):
        result = masat.solve(graph)
    assert result.converged
    assert_allclose(result.graph.points, [[1, 1], [-2, 1]], atol=1e-9)


def test_covariances_of_what_is_not_determined_are_refused():
    with pytest.raises(OptimizationError, match=r"no covariances: .* heading not determined"):
        masat.covariances(planar(fixes(2)))


def test_keeping_what_is_open_changes_neither_the_minimum_nor_chi2():
    # The same graph with the heading fixed by a prior has the same chi2.
    rng = np.random.default_rng(0)
    z = np.array(PLANAR) + rng.normal(size=(4, 3)) * 0.1
    one = PoseGraph.from_arrays(SQUARE, z, priors=fixes(2))
    free = PoseGraph.from_arrays(SQUARE, z)
    with pytest.warns(MasatWarning, match="heading not determined"):
        assert_allclose(masat.solve(one).chi2, masat.solve(free).chi2, rtol=1e-9)


def test_many_open_nodes_share_a_note():
    edges = [*SQUARE, *((0, k) for k in range(10, 30))]
    information = [np.eye(3)] * 4 + [np.diag([1.0, 1, 0])] * 20
    graph = PoseGraph.from_arrays(edges, PLANAR + [(1, 1, 0)] * 20, information)
    with pytest.warns(MasatWarning) as caught:
        result = masat.solve(graph)
    assert len(result.graph.notes) == len(caught) == 6
    assert result.graph.notes[5].startswith("15 more nodes are not determined")


@pytest.mark.parametrize("dimension", [2, 3])
def test_landmarks_that_nothing_measures_are_named(dimension):
    graph = planar() if dimension == 2 else spatial()
    position = [1.0] * dimension
    seen = masat.landmarks([(0, 9)], [position], ids=[8, 9], positions=[position, position])
    message = r"landmark 8: position not determined \(nothing measures it\); kept at the initial"
    with pytest.warns(MasatWarning, match=message):
        result = masat.solve(graph.with_landmarks(seen))
    assert_allclose(result.graph.points, [position, position], atol=1e-9)
