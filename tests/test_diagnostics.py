import numpy as np
import pytest

import masat
from masat import PoseGraph


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
    # Six nodes less three anchors leave three free: 3 (5 - 3) degrees of freedom.
    assert np.isclose(d.reduced_chi2, 5 / 6)


def test_oddities_are_named():
    graph = PoseGraph.from_arrays(
        [(0, 1), (3, 4)],
        [(1, 0, 0)] * 2,
        np.diag([1.0, 1.0, 1e12]),
        ids=range(6),
        poses=np.zeros((6, 3)),
    )
    odd = "\n".join(masat.diagnose(graph).odd)
    assert "4 components" in odd
    assert "2 of them single nodes" in odd
    assert "no loop is closed" in odd
    assert "broken 3 times, first between 1 and 2" in odd
    assert "spans 1 to 1e+12" in odd
    assert "all poses are the same" in odd


def test_a_sound_graph_has_no_oddities():
    graph = PoseGraph.from_arrays([(0, 1), (1, 2), (2, 0)], [(1, 0, 0)] * 3)
    d = masat.diagnose(graph)
    assert d.odd == ()
    assert d.chi2 is None
    assert d.worst_edges == ()


def test_the_worst_edges_come_first():
    graph = PoseGraph.from_arrays(
        [(0, 1), (1, 2), (2, 3)], [(1, 0, 0), (3, 0, 0), (2, 0, 0)], poses=np.zeros((4, 3))
    )
    assert masat.diagnose(graph).worst_edges == ((1, 2, 9.0), (2, 3, 4.0), (0, 1, 1.0))


def test_a_trajectory_without_edges_is_looked_over():
    graph = PoseGraph.from_arrays([], [], ids=[0, 1], poses=[(0, 0, 0), (1, 0, 0)])
    d = masat.diagnose(graph)
    assert (d.edges, d.components, d.information) == (0, (1, 1), (0, 0))


@pytest.mark.parametrize(("name", "gaps"), [("2d/ais2klinik.g2o", 1), ("2d/MIT.g2o", 0)])
def test_gaps_in_real_chains(name, gaps, data_dir):
    assert masat.diagnose(masat.read(data_dir / name)).chain_gaps == gaps
