import gzip
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pooch
import pytest

import masat
from masat import GraphError, PoseGraph, datasets, lie
from masat.datasets import DATASETS, GRID_WORLDS, DatasetError, recover_grid_truth, registry
from masat.formats import FORMATS
from masat.worlds import manhattan, perturb

PUBLISHED = {
    "Manhattan3500": "M3500_groundtruth.g2o",
    "City10k": "City10k_groundtruth.g2o",
    "Manhattan10000": "Manhattan10000_groundtruth.g2o.gz",
}
REAL_MAPS = [
    *("intel", "INTEL_P", "intel_vertigo", "input_INTEL", "MIT", "CSAIL", "FR079_P"),
    *("killian-court", "kitti_00", "kitti_06", "kitti_07", "kitti_08", "kitti_09"),
]
SQUARE = [(0, 1), (1, 2), (2, 3), (0, 3)]
TURNS = [(1, 0, np.pi / 2), (1, 0, np.pi / 2), (1, 0, np.pi / 2), (0, 1, -np.pi / 2)]


@pytest.fixture
def copies(data_dir, monkeypatch):
    monkeypatch.setenv("MASAT_DATASETS", str(data_dir))


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """An empty cache, and no folder of copies."""
    monkeypatch.delenv("MASAT_DATASETS", raising=False)
    monkeypatch.setattr(pooch, "os_cache", lambda name: tmp_path / "cache" / name)
    return tmp_path / "cache" / "masat"


@pytest.fixture
def host(tmp_path, monkeypatch):
    """A folder served instead of the public host."""

    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, *_):
            pass

    folder = tmp_path / "host"
    folder.mkdir()
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=folder))
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    monkeypatch.setattr(registry, "_HOST", f"http://127.0.0.1:{server.server_port}")
    yield folder
    server.shutdown()
    thread.join()
    server.server_close()


def offer(host, name, content):
    dataset = DATASETS[name]
    file = host / dataset.repository / dataset.commit / dataset.path
    file.parent.mkdir(parents=True)
    file.write_bytes(content)


def test_the_registry_is_sound():
    assert datasets.names() == tuple(DATASETS)
    for column in ("file", "sha256", "url"):
        assert len({getattr(d, column) for d in DATASETS.values()}) == len(DATASETS)
    for dataset in DATASETS.values():
        assert len(dataset.sha256) == 64
        assert len(dataset.commit) == 40
        assert dataset.dimension in (2, 3)
        assert dataset.format is None or dataset.format in FORMATS
    assert set(GRID_WORLDS.values()) <= set(DATASETS)


def test_the_registry_lists_every_file_at_hand(data_dir):
    files = {f.name.removesuffix(".gz") for d in ("2d", "3d") for f in (data_dir / d).iterdir()}
    assert files == {dataset.file for dataset in DATASETS.values()}


@pytest.mark.filterwarnings("ignore::masat.MasatWarning")
@pytest.mark.parametrize("name", DATASETS)
def test_every_dataset_is_what_the_registry_says(name, data_dir, copies):
    dataset = DATASETS[name]
    assert datasets.fetch(name).parent == data_dir / f"{dataset.dimension}d"
    graph = datasets.load(name, indefinite="nearest")
    found = graph.dimension, len(graph.ids), len(graph.edges)
    assert found == (dataset.dimension, dataset.nodes, dataset.edges)


def test_the_format_is_told_where_the_tags_leave_it_open(copies):
    # Without, EDGE2 alone brings a warning, which fails a test.
    assert np.allclose(datasets.load("city10000_isam").information[0], np.diag([2500, 2500, 1e4]))


def test_an_unknown_name_is_refused_with_similar_ones():
    with pytest.raises(DatasetError, match="'sphere2501'; similar names: sphere2500"):
        datasets.fetch("sphere2501")
    with pytest.raises(DatasetError, match="similar names: M3500"):
        datasets.load("m3500")
    with pytest.raises(DatasetError, match="known: M3500, "):
        datasets.fetch("?")
    with pytest.raises(DatasetError, match=r"unknown grid world 'Manhattan350'.*Manhattan3500"):
        datasets.ground_truth("Manhattan350")
    assert issubclass(DatasetError, masat.MasatError)


@pytest.mark.parametrize("name", [None, 7, ["M3500"], b"M3500"])
@pytest.mark.parametrize("function", [datasets.fetch, datasets.load, datasets.ground_truth])
def test_a_name_that_is_no_string_is_refused(function, name):
    with pytest.raises(DatasetError, match="must be a string"):
        function(name)


def test_a_download_is_checked_and_kept(host, cache, data_dir):
    content = (data_dir / "3d/tinyGrid3D.g2o").read_bytes()
    offer(host, "tinyGrid3D", content)
    file = datasets.fetch("tinyGrid3D")
    assert file == cache / "tinyGrid3D.g2o"
    assert file.read_bytes() == content
    for served in host.rglob("*.g2o"):
        served.unlink()
    assert datasets.fetch("tinyGrid3D") == file
    assert len(datasets.load("tinyGrid3D").edges) == 11


def test_a_terminal_sees_how_far_a_download_is(host, cache, data_dir, monkeypatch, capsys):
    offer(host, "M3500", (data_dir / "2d/input_M3500_g2o.g2o").read_bytes())
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    monkeypatch.setenv("FORCE_COLOR", "1")
    datasets.fetch("M3500")
    assert "M3500" in capsys.readouterr().err


def test_a_folder_without_the_file_leaves_it_to_the_download(host, cache, data_dir, monkeypatch):
    monkeypatch.setenv("MASAT_DATASETS", str(host))
    offer(host, "tinyGrid3D", (data_dir / "3d/tinyGrid3D.g2o").read_bytes())
    assert datasets.fetch("tinyGrid3D").parent == cache


def test_a_download_with_another_checksum_is_refused(host, cache):
    offer(host, "MIT", b"EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n")
    with pytest.raises(DatasetError, match=r"MIT\.g2o is not the file of 'MIT'"):
        datasets.fetch("MIT")
    assert not any(cache.iterdir())


def test_what_the_host_does_not_have_is_an_error(host, cache):
    with pytest.raises(DatasetError, match=r"404.*set MASAT_DATASETS to a folder .* MIT\.g2o"):
        datasets.fetch("MIT")


def test_without_network_the_error_says_what_to_do(cache, monkeypatch):
    def offline(*_, **__):
        raise ConnectionError("no route to host")

    monkeypatch.setattr(pooch, "retrieve", offline)
    with pytest.raises(DatasetError, match=r"no route to host; .* set MASAT_DATASETS .* MIT\.g2o"):
        datasets.fetch("MIT")


@pytest.mark.parametrize("where", ["", "2d"])
@pytest.mark.parametrize("pack", [bytes, gzip.compress])
def test_a_copy_may_lie_in_the_folder_or_below_gzipped_or_not(
    where, pack, data_dir, tmp_path, monkeypatch
):
    monkeypatch.setenv("MASAT_DATASETS", str(tmp_path))
    file = tmp_path / where / ("ring.g2o" if pack is bytes else "ring.g2o.gz")
    file.parent.mkdir(exist_ok=True)
    file.write_bytes(pack((data_dir / "2d/ring.g2o").read_bytes()))
    assert datasets.fetch("ring") == file
    assert len(datasets.load("ring").ids) == 434


# Without a time in it: the names of tests must be the same in each process.
PACKED = gzip.compress(b"tampered", mtime=0)


@pytest.mark.parametrize("content", [b"", b"tampered", PACKED, b"\x1f\x8b?"])
def test_a_tampered_copy_is_an_error_that_names_it(content, tmp_path, monkeypatch):
    monkeypatch.setenv("MASAT_DATASETS", str(tmp_path))
    (tmp_path / "MIT.g2o").write_bytes(content)
    with pytest.raises(
        DatasetError, match=r"MIT\.g2o: (not the file of 'MIT'|a damaged gzip file)"
    ):
        datasets.fetch("MIT")


def test_a_folder_of_copies_that_is_not_there_is_an_error(tmp_path, monkeypatch):
    monkeypatch.setenv("MASAT_DATASETS", str(tmp_path / "none"))
    with pytest.raises(DatasetError, match=r"MASAT_DATASETS names .*none, which is not a folder"):
        datasets.fetch("MIT")


def assert_same_truth(truth, expected):
    assert (truth.ids == expected.ids).all()
    assert (truth.edges == expected.edges).all()
    for found, known in (
        (truth.poses, expected.poses),
        (truth.measurements, expected.measurements),
    ):
        off = found - known
        off[:, 2] = (off[:, 2] + np.pi) % (2 * np.pi) - np.pi
        assert np.abs(off).max() <= 1e-12


def assert_exact(truth):
    for rows in (truth.poses, truth.measurements):
        assert (rows[:, :2] == np.rint(rows[:, :2])).all()
        assert np.isin(rows[:, 2], np.pi / 2 * np.array([-1, 0, 1, 2])).all()
    assert (truth.information == np.eye(3)).all()
    assert (truth.poses[0] == 0).all()


@pytest.mark.parametrize("name", GRID_WORLDS)
def test_recovered_truths_are_the_reference_ones(name, data_dir, copies):
    truth = datasets.ground_truth(name)
    assert_exact(truth)
    assert_same_truth(truth, masat.read(data_dir / PUBLISHED[name]))
    assert datasets.ground_truth(name) is truth


@pytest.mark.filterwarnings("ignore::masat.MasatWarning")
def test_two_noises_of_a_world_have_one_truth(copies):
    # The edges of w10000 lead backward.
    one, other = (recover_grid_truth(datasets.load(n)) for n in ("10kHog-man", "w10000"))
    assert (one.poses == other.poses).all()


@pytest.mark.parametrize("sigma", [(0, 0, 0), (0.02, 0.02, 0.01), (0.1, 0.1, 0.05)])
def test_a_lightly_perturbed_walk_is_recovered(sigma):
    world = manhattan(800, 2400, extent=12, seed=4)
    truth = recover_grid_truth(perturb(world, sigma, seed=1))
    assert_exact(truth)
    assert_same_truth(truth, world)


def test_ids_may_have_gaps_and_poses_and_fixed_nodes_do_not_distort_the_map():
    square = PoseGraph.from_arrays(
        np.array([10, 20, 35, 40])[np.array(SQUARE)],
        TURNS,
        poses=[(9, 9, 1), (0, 0, 0), (3, 1, 2), (4, 4, 4)],
        fixed=[10, 35],
    )
    truth = recover_grid_truth(square)
    quarter = np.pi / 2
    expected = [(0, 0, 0), (1, 0, quarter), (1, 1, 2 * quarter), (0, 1, -quarter)]
    assert (truth.poses == expected).all()
    assert (truth.measurements == TURNS).all()
    assert truth.ids.tolist() == [10, 20, 35, 40]
    assert truth.fixed.tolist() == [10, 35]
    assert np.allclose(lie.local(truth.poses[3], (0, 1, 3 * quarter)), 0)


def test_steps_may_be_longer_than_a_meter():
    walk = PoseGraph.from_arrays([(0, 1), (1, 2), (0, 2)], [(3, 0, 0), (5, -2, 0), (8, -2, 0)])
    assert (recover_grid_truth(walk).poses[:, :2] == [(0, 0), (3, 0), (8, -2)]).all()


@pytest.mark.parametrize("name", REAL_MAPS)
def test_real_maps_are_not_taken_for_grids(name, copies):
    with pytest.raises(GraphError, match="not a world on the unit grid"):
        recover_grid_truth(datasets.load(name))


def test_a_spatial_graph_has_no_grid(copies):
    with pytest.raises(GraphError, match="3D"):
        recover_grid_truth(datasets.load("sphere2500"))


def test_a_broken_chain_is_refused():
    world = manhattan(50, 120, extent=4)
    odometry = (world.edges == (20, 21)).all(axis=1)
    broken = PoseGraph.from_arrays(world.edges[~odometry], world.measurements[~odometry])
    with pytest.raises(GraphError, match="no edge joins node 20 to 21"):
        recover_grid_truth(broken)
    with pytest.raises(GraphError, match="no edge joins node 1 to 2, and 1 more"):
        recover_grid_truth(PoseGraph.from_arrays([(0, 1)], [(1, 0, 0)], ids=[0, 1, 2, 3]))


def test_an_edge_off_the_grid_is_named():
    measured = [*TURNS[:3], (0.4, 1, -np.pi / 2 + 0.1), (0.7, 1.25, -np.pi / 2)]
    trusted = np.array([100, 100, 100, 1, 1])[:, None, None] * np.eye(3)
    square = PoseGraph.from_arrays([*SQUARE, (0, 3)], measured, trusted)
    with pytest.raises(GraphError, match=r"edge 4 \(0 -> 3\) is off by 0.7 m, 0.25 m and") as error:
        recover_grid_truth(square)
    assert error.value.edge == 4


def test_heavy_noise_and_absurd_distances_are_refused():
    world = manhattan(800, 2400, extent=12, seed=4)
    with pytest.raises(GraphError, match="edge"):
        recover_grid_truth(perturb(world, (0.4, 0.4, 0.4)))
    with pytest.raises(GraphError, match=r"edge 0 \(0 -> 1\)"):
        recover_grid_truth(PoseGraph.from_arrays([(0, 1)], [(1e100, 0, 0)]))


def test_rounding_is_not_mistaken_for_a_grid_where_no_loop_checks_it():
    random = np.random.default_rng(0)
    steps = np.column_stack([random.uniform(0, 3, 500), np.zeros((500, 2))])
    with pytest.raises(GraphError, match="spread over its cells"):
        recover_grid_truth(PoseGraph.from_arrays([(k, k + 1) for k in range(500)], steps))
    with pytest.raises(GraphError, match="no edge leads to another cell"):
        recover_grid_truth(PoseGraph.from_arrays([(0, 1)], [(0.1, 0, 0)]))
