import json
import re

import numpy as np
import pytest
from click.testing import CliRunner

import masat
from masat import MasatError, PoseGraph, lie
from masat.cli.info import info as command


def test_figures_of_a_small_graph():
    graph = PoseGraph.from_arrays(
        [(10, 11), (11, 12), (12, 10), (10, 12), (20, 21)],
        [(1, 0, 0)] * 5,
        np.diag([1.0, 2.0, 8.0]),
        ids=[10, 11, 12, 20, 21, 30],
        poses=np.zeros((6, 3)),
        fixed=[10],
    )
    d = masat.diagnose(graph)
    assert (d.dimension, d.nodes, d.edges, d.ids) == (2, 6, 5, (10, 30))
    assert (d.odometry_edges, d.loop_closures, d.repeated_pairs) == (3, 2, 1)
    assert d.chain_gaps == 2
    assert d.components == (3, 2, 1)
    assert d.degree == (0, 1.5, 3)
    assert d.fixed == (10,)
    assert d.information == (1, 8)
    assert d.condition == 8
    assert d.chi2 == 5
    # Six nodes less three of the gauge leave three free: 3 (5 - 3) degrees of freedom.
    assert d.degrees_of_freedom == 6
    assert np.isclose(d.reduced_chi2, 5 / 6)
    assert d.duplicate_edges == 0
    assert np.isclose(d.information_ratio, 1)


def issues(*arguments, **options):
    graph = PoseGraph.from_arrays(*arguments, **options)
    return masat.diagnose(graph).issues


def the_only_issue(*arguments, **options):
    (issue,) = issues(*arguments, **options)
    # What was found, and then what to do.
    assert re.fullmatch(r"[A-Z0-9].*[^.]\. [A-Z].*\.", issue)
    return issue


TRIANGLE = [(0, 1), (1, 2), (2, 0)]
STEPS = [(1, 0, 0), (1, 0, 0), (-2, 0, 0)]


def test_issues_are_named():
    found = "\n".join(
        issues(
            [(0, 1), (3, 4)],
            [(1, 0, 0)] * 2,
            np.diag([1.0, 1.0, 1e12]),
            ids=range(6),
            poses=np.zeros((6, 3)),
        )
    )
    assert "4 components" in found
    assert "2 of them single nodes" in found
    assert "has no cycle" in found
    assert "broken 3 times, first between nodes 1 and 2" in found
    assert "span 1 to 1e+12" in found
    assert "are placeholders" in found


def test_a_sound_graph_has_no_issues():
    graph = PoseGraph.from_arrays(TRIANGLE, [(1, 0, 0)] * 3)
    d = masat.diagnose(graph)
    assert d.issues == ()
    assert d.chi2 is None
    assert d.worst_edges == ()
    assert (d.information_ratio, d.condition) == (1, 1)


def test_notes_of_the_graph_are_issues():
    assert issues(TRIANGLE, STEPS, notes=["the reader skipped a line"]) == (
        "the reader skipped a line",
    )


def test_issue_components():
    two = [(0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3)]
    found = issues(two, STEPS * 2)
    assert any("2 components that no edge joins. Each" in issue for issue in found)


def test_issue_no_cycle():
    assert "has no cycle" in the_only_issue([(0, 1), (1, 2)], STEPS[:2])
    # Two fixed nodes of a chain contradict it as a loop closure does.
    poses = [(0, 0, 0), (1, 0, 0), (2, 0, 0)]
    assert issues([(0, 1), (1, 2)], STEPS[:2], poses=poses, fixed=[0, 2]) == ()


def test_issue_broken_odometry_chain():
    ring = [(0, 1), (2, 3), (3, 0), (1, 3)]
    issue = the_only_issue(ring, [(1, 0, 0)] * 4)
    assert "broken once, between nodes 1 and 2, which no edge joins" in issue
    # Gaps in the list of ids are none in the chain.
    assert issues([(0, 5), (5, 9), (9, 0)], STEPS) == ()


def test_issue_no_odometry_at_all():
    square = [(0, 2), (2, 4), (4, 0), (1, 3), (3, 0), (1, 4)]
    issue = the_only_issue(square, [(1, 0, 0)] * 6)
    assert issue.startswith("There is no odometry")


def test_issue_parallel_edges():
    issue = the_only_issue([*TRIANGLE, (2, 1)], [*STEPS, (-1, 0, 0)])
    assert "Nodes 1 and 2 are joined by more than one edge" in issue
    issue = the_only_issue([*TRIANGLE, (2, 1), (0, 1)], [*STEPS, (-1, 0, 0), (2, 0, 0)])
    assert "2 pairs of nodes are joined by more than one edge, first 0 and 1" in issue


def test_issue_duplicate_edges():
    issue = the_only_issue([*TRIANGLE, (1, 2)], [*STEPS, (1, 0, -0.0)])
    assert "Edge 1 -> 2 repeats an earlier edge with the same measurement" in issue
    issue = the_only_issue([*TRIANGLE, *TRIANGLE], [*STEPS, *STEPS])
    assert "3 edges repeat an earlier edge with the same measurement, first 0 -> 1" in issue


def test_duplicates_and_parallel_edges_are_counted_apart():
    graph = PoseGraph.from_arrays(
        [*TRIANGLE, (0, 1), (0, 1), (1, 2)], [*STEPS, (1, 0, 0), (1, 0, 1), (1, 0, 0)]
    )
    d = masat.diagnose(graph)
    assert (d.repeated_pairs, d.duplicate_edges) == (2, 2)
    assert any("Nodes 0 and 1 are joined by more than one edge" in i for i in d.issues)
    assert any("2 edges repeat an earlier edge" in i and "first 0 -> 1" in i for i in d.issues)


def test_issue_nearly_singular_information():
    information = np.array([np.eye(3), np.diag([1, 1, 1e10]), np.eye(3)])
    issue = the_only_issue(TRIANGLE, STEPS, information)
    assert "edge 1 -> 2 is nearly singular: its eigenvalues span 1 to 1e+10" in issue


@pytest.mark.parametrize(("scale", "first"), [(1e6, "odometry"), (1e-6, "loop closures")])
def test_issue_information_of_different_scales(scale, first):
    information = np.array([np.eye(3) * scale, np.eye(3) * scale, np.eye(3)])
    graph = PoseGraph.from_arrays(TRIANGLE, STEPS, information)
    assert np.isclose(masat.diagnose(graph).information_ratio, scale)
    issue = the_only_issue(TRIANGLE, STEPS, information)
    assert f"The information of the {first} is 1e+06 times" in issue


def test_issue_placeholder_poses():
    assert "are placeholders" in the_only_issue(TRIANGLE, STEPS, poses=np.ones((3, 3)))
    fixed = [(0, 0, 0), (1, 1, 1), (1, 1, 1)]
    assert "are placeholders" in the_only_issue(TRIANGLE, STEPS, poses=fixed, fixed=[0])


def test_issue_all_nodes_are_fixed():
    poses = [(0, 0, 0), (1, 0, 0), (3, 0, 0)]  # reduced chi2 (1 + 1) / 9
    issue = the_only_issue(TRIANGLE, STEPS, poses=poses, fixed=[0, 1, 2])
    assert issue.startswith("Every node is fixed")


def ring(count):
    edges = [(k, (k + 1) % count) for k in range(count)]
    turn = 2 * np.pi / count
    heading = turn * np.arange(count)
    poses = np.column_stack([np.cos(heading), np.sin(heading), heading])
    return (
        edges * 2,
        poses,
        lie.between(poses[[a for a, _ in edges] * 2], poses[[b for _, b in edges] * 2]),
    )


@pytest.mark.parametrize(("sigma", "said"), [(10, "far above 1"), (1, None), (0.1, "far below 1")])
def test_issue_reduced_chi2(sigma, said):
    edges, poses, exact = ring(200)
    noise = sigma * np.random.default_rng(0).normal(size=exact.shape)
    noisy = lie.retract(exact, np.clip(noise, -100, 100) * 1e-3)
    found = issues(edges, noisy, np.eye(3) * 1e6, poses=poses)
    found = [issue for issue in found if "reduced chi2" in issue]
    assert len(found) == (said is not None)
    assert said is None or said in found[0]


def test_few_degrees_of_freedom_tell_nothing_of_the_information():
    # Three degrees of freedom: chi2 is below 0.3 in 4 % of all cases.
    poses = [(0, 0, 0), (1.1, 0, 0), (2, 0, 0)]
    assert masat.diagnose(PoseGraph.from_arrays(TRIANGLE, STEPS, poses=poses)).reduced_chi2 < 0.1
    assert issues(TRIANGLE, STEPS, poses=poses) == ()


def test_the_worst_edges_come_first():
    graph = PoseGraph.from_arrays(
        [(0, 1), (1, 2), (2, 3)], [(1, 0, 0), (3, 0, 0), (2, 0, 0)], poses=np.zeros((4, 3))
    )
    assert masat.diagnose(graph).worst_edges == ((1, 2, 9.0), (2, 3, 4.0), (0, 1, 1.0))


@pytest.mark.parametrize("pose", [None, (1, 2, 3), (1, 2, 3, 0, 0, 0, 1)])
def test_a_single_node_can_be_examined(pose):
    graph = PoseGraph.from_arrays(
        np.empty((0, 2), int), np.empty((0, 3 if pose is None else len(pose))),
        ids=[7], poses=None if pose is None else [pose],
    )  # fmt: skip
    d = masat.diagnose(graph)
    assert (d.nodes, d.edges, d.components, d.degree) == (1, 0, (1,), (0, 0, 0))
    assert (d.condition, d.information_ratio, d.reduced_chi2) == (1, None, None)
    assert d.chi2 == (None if pose is None else 0)
    (issue,) = d.issues
    assert issue.startswith("The graph has no edges")


def test_information_at_the_limit_of_double_precision_has_a_condition():
    graph = PoseGraph.from_arrays(TRIANGLE, STEPS, np.diag([1e-20, 1, 1e20]))
    assert masat.diagnose(graph).condition == pytest.approx(1 / np.finfo(float).eps)


def test_a_trajectory_without_edges_can_be_examined():
    graph = PoseGraph.from_arrays([], [], ids=[0, 1], poses=[(0, 0, 0), (1, 0, 0)])
    d = masat.diagnose(graph)
    assert (d.edges, d.components, d.information) == (0, (1, 1), (0, 0))


@pytest.mark.parametrize(("name", "gaps"), [("2d/ais2klinik.g2o", 1), ("2d/MIT.g2o", 0)])
def test_gaps_in_real_chains(name, gaps, data_dir):
    assert masat.diagnose(masat.read(data_dir / name)).chain_gaps == gaps


@pytest.fixture
def info(tmp_path):
    """Run `masat info` on the text of a g2o file."""

    def info(text, *options):
        path = tmp_path / "graph.g2o"
        path.write_text(text)
        return CliRunner().invoke(command, [str(path), *options])

    return info


CHAIN = "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n"


def test_the_command_lists_the_issues(info):
    printed = info(CHAIN).output
    assert "issues       The graph has no cycle" in printed
    ring = CHAIN + CHAIN.replace("0 1 1", "1 2 1") + CHAIN.replace("0 1 1", "2 0 1")
    assert "issues       none" in info(ring).output
    (issue,) = json.loads(info(CHAIN, "--json").output)["issues"]
    assert issue.startswith("The graph has no cycle")


def test_the_command_cannot_draw_what_has_no_poses(info, tmp_path):
    done = info(CHAIN, "--plot", str(tmp_path / "map.png"))
    assert isinstance(done.exception, MasatError)
    assert "graph.g2o has no poses to draw" in str(done.exception)
    assert not (tmp_path / "map.png").exists()


def with_fixes_and_landmarks(**options):
    """Return two poses with an edge, three fixes and three observations of a point, each off."""
    return PoseGraph.from_arrays(
        [(0, 1)],
        [(1, 0, 0)],
        poses=[(0, 0, 0), (2, 0, 0)],  # chi2 of the edge: 1
        priors=masat.gps([0, 1, 1], [(0, 2), (2, 0), (3, 0)], 1.0),  # 4 + 0 + 1
        landmarks=masat.landmarks(
            [(0, 9), (0, 9), (1, 9)], [(1, 1), (1, 2), (-1, 1)], **options  # 0 + 1 + 0
        ),
    )  # fmt: skip


def test_the_fit_is_that_of_all_measurements():
    graph = with_fixes_and_landmarks(positions=[(1, 1)])
    d = masat.diagnose(graph)
    assert d.chi2 == graph.chi2 == 7
    # 3 + 6 + 6 measured values; 6 of the poses and 2 of the point are unknown.
    assert d.degrees_of_freedom == 7
    assert d.reduced_chi2 == 1
    assert (d.priors, d.landmarks, d.observations) == (3, 1, 3)
    assert d.worst_edges == ((0, 1, 1.0),)
    result = masat.solve(graph)
    again = masat.diagnose(result.graph)
    assert np.isclose(again.reduced_chi2, result.reduced_chi2)


def test_landmarks_without_positions_leave_the_fit_open(tmp_path):
    graph = with_fixes_and_landmarks()
    d = masat.diagnose(graph)
    assert (d.chi2, d.reduced_chi2) == (None, None)
    masat.write(with_fixes_and_landmarks(positions=[(1, 1)]), tmp_path / "graph.g2o")
    said = CliRunner().invoke(command, [str(tmp_path / "graph.g2o")]).output
    assert re.search(r"priors +3\n", said)
    assert re.search(r"landmarks +1, 3 observations\n", said)
    assert "chi2 7, reduced 1" in said


def test_unmeasured_directions_are_no_issue():
    position = np.diag([4.0, 4.0, 0.0])
    full = np.diag([4.0, 4.0, 9.0])
    d = masat.diagnose(
        PoseGraph.from_arrays(
            [*TRIANGLE, (2, 3), (3, 0)], [*STEPS, (1, 0, 0), (-3, 0, 0)], [full] * 4 + [position]
        )
    )
    assert d.condition == 9 / 4
    assert np.isclose(d.information_ratio, 1)
    assert d.issues == ()


def test_fixed_nodes_beside_landmarks_are_no_issue():
    graph = with_fixes_and_landmarks(positions=[(1, 1)]).with_fixed([0, 1])
    assert not any("Every node is fixed" in issue for issue in masat.diagnose(graph).issues)
    nothing = graph.without_edges([0])
    assert not any("no edges" in issue for issue in masat.diagnose(nothing).issues)


def test_no_chain_leads_from_one_session_to_the_next():
    walk = PoseGraph.from_arrays([(0, 1), (1, 2)], STEPS[:2])
    d = masat.diagnose(masat.merge([walk, walk], ([(0, 2, 1, 0), (0, 0, 1, 2)], STEPS[:2])))
    assert (d.odometry_edges, d.loop_closures, d.chain_gaps) == (4, 2, 0)
    broken = PoseGraph.from_arrays([(0, 1), (0, 2)], STEPS[:2])
    merged = masat.merge([walk, broken], ([(0, 0, 1, 2)] * 2, STEPS[:2]))
    issue = next(issue for issue in masat.diagnose(merged).issues if "chain" in issue)
    assert "broken once, between nodes 1000001 and 1000002" in issue
