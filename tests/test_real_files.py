from contextlib import nullcontext

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from masat import FormatError, MasatWarning, PoseGraph, lie
from masat.formats import read as read_file

RIVAL = "the tags fit isam and toro"
BARE = "have no information"
# Dimension, vertices, edges, whether there are poses, and what the notes say.
FILES = {
    "2d/10kHog-man.txt.gz": (2, 10000, 64311, True, ()),
    "2d/CSAIL.g2o": (2, 1045, 1172, False, ()),
    "2d/FR079_P_g2o.g2o": (2, 989, 1217, True, ()),
    "2d/INTEL_P_g2o.g2o": (2, 1228, 1505, True, ()),
    "2d/MIT.g2o": (2, 808, 827, True, ()),
    "2d/ais2klinik.g2o": (2, 15115, 16727, True, ()),
    "2d/city10000.g2o": (2, 10000, 20687, True, ()),
    "2d/city10000_isam.txt": (2, 10000, 20687, False, (RIVAL,)),
    "2d/city10k.txt": (2, 10000, 20687, False, ()),
    "2d/input_INTEL_g2o.g2o": (2, 1228, 1483, True, ()),
    "2d/input_M3500_g2o.g2o": (2, 3500, 5453, True, ()),
    "2d/intel.g2o": (2, 1728, 2512, True, ()),
    "2d/intel_vertigo.g2o": (2, 943, 1837, True, ()),
    "2d/killian-court.txt": (2, 1941, 3995, True, ()),
    "2d/kitti_00.g2o": (2, 4541, 4677, False, ()),
    "2d/kitti_06.g2o": (2, 1101, 1150, False, ()),
    "2d/kitti_07.g2o": (2, 1101, 1106, False, ()),
    "2d/kitti_08.g2o": (2, 4071, 4070, False, ()),
    "2d/kitti_09.g2o": (2, 1591, 1592, False, ()),
    "2d/manhattan.g2o": (2, 3500, 5453, False, ()),
    "2d/manhattanOlson3500.g2o": (2, 3500, 5598, True, ()),
    "2d/manhattanOlson3500_isam.txt": (2, 3500, 5598, False, ()),
    "2d/manhattanOlson3500_olson.g2o": (2, 3500, 5598, True, ()),
    "2d/ring.g2o": (2, 434, 459, True, ()),
    "2d/ring_groundtruth.g2o": (2, 434, 459, True, ()),
    "2d/w10000.graph.gz": (2, 10000, 64311, True, ("5875 lines with the unknown tag EQUIV",)),
    "3d/burghers.g2o": (3, 1124, 4118, True, (f"4118 edges {BARE}",)),
    "3d/car.g2o": (3, 6523, 22207, True, (f"22207 edges {BARE}",)),
    "3d/parking-garage.g2o": (3, 1661, 6275, True, ()),
    "3d/sphere2500.g2o": (3, 2500, 4949, True, ()),
    "3d/sphere3D.g2o.gz": (3, 5000, 19599, True, ()),
    "3d/sphere_bignoise_vertex3.g2o": (3, 2200, 8647, True, ()),
    "3d/stonewall.g2o": (3, 271, 888, True, (f"888 edges {BARE}",)),
    "3d/tinyGrid3D.g2o": (3, 9, 11, True, ()),
    "3d/torus3D.g2o.gz": (3, 5000, 9048, True, ()),
    "City10k_groundtruth.g2o": (2, 10000, 20687, True, ()),
    "M3500_5598_groundtruth.g2o": (2, 3500, 5598, True, ()),
    "M3500_groundtruth.g2o": (2, 3500, 5453, True, ()),
    "Manhattan10000_groundtruth.g2o.gz": (2, 10000, 64311, True, ()),
    "sphere2500_groundtruth.g2o": (3, 2500, 4949, True, ()),
    "published_groundtruth/ISAM2_GT_city10000.txt": (2, 10000, 0, True, ()),
    "published_groundtruth/city10000_groundtruth.txt": (2, 10000, 20687, False, (RIVAL,)),
    "published_groundtruth/manhattanOlson3500_edges_groundTruth.dat": (2, 3500, 5598, False, ()),
    "published_groundtruth/manhattanOlson3500_groundtruth.txt": (2, 3500, 5598, False, (RIVAL,)),
    "published_groundtruth/manhattanOlson3500_nodes_groundTruth.dat": (2, 3500, 0, True, ()),
    "published_groundtruth/sphere2500_groundtruth.txt": (3, 2500, 4949, False, (RIVAL,)),
}


@pytest.fixture(scope="module")
def real(data_dir):
    """Read a file of the data folder whatever it is noted for, each once."""
    graphs: dict[str, PoseGraph] = {}

    def real(name):
        if name not in graphs:
            noted = FILES[name][-1]
            with pytest.warns(MasatWarning) if noted else nullcontext():
                graphs[name] = read_file(data_dir / name)
        return graphs[name]

    return real


@pytest.mark.parametrize("name", FILES)
def test_real_files_have_the_vertices_and_edges_that_they_are_known_for(real, name):
    dimension, vertices, edges, placed, notes = FILES[name]
    graph = real(name)
    assert (graph.dimension, len(graph.ids), len(graph.edges)) == (dimension, vertices, edges)
    assert_array_equal(graph.ids, np.arange(vertices))
    assert (graph.poses is not None) == placed
    assert len(graph.notes) == len(notes)
    for note, beginning in zip(graph.notes, notes, strict=True):
        assert note.startswith(beginning)
    assert len(np.unique(graph.components)) == (1 if edges else vertices)


def test_the_indefinite_matrices_of_cubicle_are_counted_and_can_be_repaired(data_dir):
    path = data_dir / "3d/cubicle.g2o"
    with pytest.raises(FormatError, match="of 5021 of 16869 edges are zero or not positive"):
        read_file(path)
    for indefinite in ("nearest", "identity"):
        with pytest.warns(MasatWarning, match="5021 information matrices are not positive"):
            graph = read_file(path, indefinite=indefinite)
        assert (len(graph.ids), len(graph.edges)) == (5750, 16869)
        assert np.linalg.eigvalsh(graph.information).min() > 0


def residuals(graph):
    """Return the errors of the edges at the poses of the graph."""
    start, end = graph.edge_indices.T
    return lie.local(graph.measurements, lie.between(graph.poses[start], graph.poses[end]))


# Sums of e' Omega e at the vertices of the file, found once by the g2o library.
COSTS = {
    "2d/10kHog-man.txt.gz": 6880893.6,
    "2d/FR079_P_g2o.g2o": 8502.7737,
    "2d/INTEL_P_g2o.g2o": 4943388.6,
    "2d/MIT.g2o": 4.4141817e09,
    "2d/ais2klinik.g2o": 1297393.9,
    "2d/city10000.g2o": 6.5416269e08,
    "2d/input_INTEL_g2o.g2o": 5149721,
    "2d/input_M3500_g2o.g2o": 2566667.7,
    "2d/intel.g2o": 551.73573,
    "2d/intel_vertigo.g2o": 1331.4989,
    "2d/killian-court.txt": 2.0467303e-07,
    "2d/manhattanOlson3500.g2o": 69142.942,
    "2d/manhattanOlson3500_olson.g2o": 2566434.3,
    "2d/ring.g2o": 2041063.9,
    "2d/ring_groundtruth.g2o": 3.2854855e-08,
    "2d/w10000.graph.gz": 49440240,
    "3d/burghers.g2o": 591.05865,
    "3d/car.g2o": 368.73865,
    "3d/parking-garage.g2o": 16720.018,
    "3d/sphere2500.g2o": 2547810.9,
    "3d/sphere3D.g2o.gz": 1.3474545e11,
    "3d/sphere_bignoise_vertex3.g2o": 1.7663122e08,
    "3d/stonewall.g2o": 187.13396,
    "3d/tinyGrid3D.g2o": 213.06437,
    "3d/torus3D.g2o.gz": 2946826.5,
}


@pytest.mark.parametrize("name", COSTS)
def test_real_files_cost_at_their_vertices_what_g2o_says(real, name):
    graph = real(name)
    error = residuals(graph)
    cost = np.einsum("ki,kij,kj->", error, graph.information, error)
    assert cost == pytest.approx(COSTS[name], rel=1e-7)


@pytest.mark.parametrize("name", [name for name in FILES if name.count("groundtruth.g2o")])
def test_ground_truth_agrees_with_its_own_edges(real, name):
    # The printed numbers of the ring have six decimals, those of the others all their digits.
    assert np.abs(residuals(real(name))).max() < (2e-6 if "ring" in name else 2e-13)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("M3500_groundtruth.g2o", "2d/input_M3500_g2o.g2o"),
        ("M3500_5598_groundtruth.g2o", "2d/manhattanOlson3500.g2o"),
        ("M3500_5598_groundtruth.g2o", "2d/manhattanOlson3500_isam.txt"),
        ("City10k_groundtruth.g2o", "2d/city10k.txt"),
        ("City10k_groundtruth.g2o", "2d/city10000_isam.txt"),
        ("Manhattan10000_groundtruth.g2o.gz", "2d/10kHog-man.txt.gz"),
        ("sphere2500_groundtruth.g2o", "3d/sphere2500.g2o"),
    ],
)
def test_files_of_one_world_have_the_same_edges_in_the_same_order(real, one, other):
    assert_array_equal(real(one).edges, real(other).edges)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("City10k_groundtruth.g2o", "2d/city10000.g2o"),
        ("Manhattan10000_groundtruth.g2o.gz", "2d/w10000.graph.gz"),
    ],
)
def test_files_of_one_world_have_the_same_pairs_in_any_order(real, one, other):
    pairs = [np.unique(np.sort(real(name).edges), axis=0) for name in (one, other)]
    assert_array_equal(*pairs)


def test_g2o_and_isam_files_of_city10k_are_one_graph(real):
    g2o, isam = real("2d/city10k.txt"), real("2d/city10000_isam.txt")
    for name in ("ids", "edges", "measurements", "information"):
        assert_array_equal(getattr(g2o, name), getattr(isam, name))


def test_g2o_and_isam_files_of_manhattan_measure_the_same(real):
    g2o, isam = real("2d/manhattanOlson3500.g2o"), real("2d/manhattanOlson3500_isam.txt")
    assert_array_equal(g2o.measurements, isam.measurements)
    # This g2o file holds the square root where the information belongs.
    assert_allclose(g2o.information**2, isam.information, rtol=1e-15)


@pytest.mark.parametrize(
    ("published", "exact", "within"),
    [
        ("manhattanOlson3500_groundtruth.txt", "M3500_5598_groundtruth.g2o", 4e-6),
        ("manhattanOlson3500_edges_groundTruth.dat", "M3500_5598_groundtruth.g2o", 4e-6),
        ("city10000_groundtruth.txt", "City10k_groundtruth.g2o", 4e-6),
        # Roll, pitch and yaw here, quaternions there.
        ("sphere2500_groundtruth.txt", "sphere2500_groundtruth.g2o", 5e-6),
    ],
)
def test_published_edges_are_the_exact_ones_to_their_printed_digits(real, published, exact, within):
    printed, exact = real(f"published_groundtruth/{published}"), real(exact)
    # The order differs, and repeated pairs measure the same.
    order = [np.lexsort(graph.edges.T) for graph in (printed, exact)]
    assert_array_equal(printed.edges[order[0]], exact.edges[order[1]])
    steps = lie.local(printed.measurements[order[0]], exact.measurements[order[1]])
    assert np.abs(steps).max() < within


@pytest.mark.parametrize(
    ("published", "exact", "within"),
    [
        ("manhattanOlson3500_nodes_groundTruth.dat", "M3500_5598_groundtruth.g2o", 4e-6),
        ("ISAM2_GT_city10000.txt", "City10k_groundtruth.g2o", 1.1e-4),
    ],
)
def test_published_trajectories_are_the_exact_ones_to_their_printed_digits(
    real, published, exact, within
):
    printed, exact = real(f"published_groundtruth/{published}"), real(exact)
    assert np.abs(lie.local(printed.poses, exact.poses)).max() < within
