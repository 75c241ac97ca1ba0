import json
import shutil

import numpy as np
import pytest

import masat
from masat import PartitionError, PoseGraph
from masat.formats import streaming
from masat.formats.streaming import read_mapped
from masat.worlds import city, perturb, sphere

CITY = masat.initialize(perturb(city(1000), (0.05, 0.05, 0.02)), "masat")
SPHERE = masat.initialize(perturb(sphere(400), (0.05, 0.02)), "masat")
GRAPHS = {"city": CITY, "sphere": SPHERE}


def spoil_missing(folder, other):
    (folder / "part-1.npz").unlink()
    return r"part-1.npz: is missing"


def spoil_torn(folder, other):
    path = folder / "part-2.npz"
    path.write_bytes(path.read_bytes()[:-100])
    return r"part-2.npz: has \d+ bytes in place of \d+: it is damaged"


def spoil_bits(folder, other):
    path = folder / "separator-0.npz"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    return r"separator-0.npz: is damaged"


def spoil_other(folder, other):
    shutil.copy(other / "part-0.npz", folder / "part-0.npz")
    return r"part-0.npz: is of another graph than the index"


def spoil_index(folder, other):
    (folder / "index.json").write_text("{")
    return r"index.json: is damaged"


def spoil_everything(folder, other):
    (folder / "index.json").unlink()
    return r"holds no partition; make one with masat partition FILE -o"


def spoil_poses(folder, other):
    (folder / "state/given/part-3.npy").unlink()
    return r"given/part-3.npy: is missing"


SPOIL = [
    spoil_missing,
    spoil_torn,
    spoil_bits,
    spoil_other,
    spoil_index,
    spoil_everything,
    spoil_poses,
]


@pytest.mark.parametrize("spoil", SPOIL)
def test_a_damaged_partition_is_one_error_that_names_the_file(tmp_path, spoil):
    moved = CITY.with_poses(CITY.poses + 0)
    moved = PoseGraph.from_arrays(
        moved.edges, moved.measurements + 1e-3, moved.information, poses=moved.poses
    )
    masat.partition(CITY, tmp_path / "parts", 4)
    masat.partition(moved, tmp_path / "other", 4)
    message = spoil(tmp_path / "parts", tmp_path / "other")
    with pytest.raises(PartitionError, match=message):
        masat.Partition(tmp_path / "parts").solve()


def test_a_solve_of_another_graph_is_refused(tmp_path):
    masat.partition(CITY, tmp_path / "parts", 2).solve("gn", max_iterations=1)
    masat.partition(SPHERE, tmp_path / "other", 2).solve("gn", max_iterations=1)
    shutil.copy(tmp_path / "other/state/solve.json", tmp_path / "parts/state/solve.json")
    with pytest.raises(PartitionError, match=r"solve\.json: is of a solve of another graph"):
        masat.Partition(tmp_path / "parts").solve()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "give either the number of parts or the part of each node"),
        ({"parts": 0}, "the number of parts must be from 1"),
        ({"labels": [0, 1]}, "labels must be 1000 integers"),
        ({"labels": -np.ones(1000, int)}, "parts are numbered from 0; node 0 has -1"),
    ],
)
def test_a_partition_that_cannot_be_is_refused(tmp_path, options, message):
    with pytest.raises(PartitionError, match=message):
        masat.partition(CITY, tmp_path / "parts", **options)


def test_a_folder_in_use_is_refused(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(PartitionError, match="is not empty"):
        masat.partition(CITY, tmp_path, 2)


def test_the_command_line_parts_solves_and_tells(run, tmp_path):
    file, folder, out = tmp_path / "city.g2o", tmp_path / "parts", tmp_path / "map.g2o"
    masat.write(CITY, file)
    code, text, err = run("partition", file, "-o", folder, "--parts", "4")
    assert (code, err) == (0, "")
    assert "parts" in text
    assert "workers" in text
    code, text, _ = run("info", folder, "--json")
    assert [cost["workers"] for cost in json.loads(text)["costs"]] == [1, 2, 4]
    assert run("status", folder)[1] == f"not solved yet: masat solve {folder}\n"
    code, text, _ = run("solve", folder, "--max-iterations", "1", "--optimizer", "gn", "--quiet")
    assert code == 1
    code, text, _ = run("solve", folder, "--optimizer", "gn", "-o", out)
    best = masat.optimize(masat.read(file), "gn")
    assert code == 0
    assert f"chi2 {best.chi2:.6g} in {best.iterations} iterations" in text
    assert masat.read(out).chi2 == pytest.approx(best.chi2, rel=1e-9)
    code, text, _ = run("status", folder)
    assert f"stopped, relative change, after {best.iterations} iterations" in text
    code, text, _ = run("solve", folder, "--json", "--restart")
    assert json.loads(text)["converged"]
    code, text, _ = run("solve", folder, "--loss", "huber", "--loss-scale", "2")
    assert code == 0
    assert "with huber" in text
    assert "lowest cost with huber" in run("status", folder)[1]


@pytest.mark.parametrize("name", GRAPHS)
@pytest.mark.parametrize("suffix", [".g2o", ".g2o.gz"])
def test_a_graph_whose_measurements_stay_on_disk_is_the_same(tmp_path, monkeypatch, name, suffix):
    monkeypatch.setattr(streaming, "_BLOCK", 1000)
    path = tmp_path / f"graph{suffix}"
    masat.write(GRAPHS[name], path)
    graph, mapped = masat.read(path), read_mapped(path, tmp_path)
    for attribute in ("ids", "poses", "edges", "measurements", "information", "fixed"):
        assert np.array_equal(getattr(graph, attribute), getattr(mapped, attribute)), attribute


def test_a_graph_with_fixes_is_read_as_a_whole(tmp_path):
    path = tmp_path / "graph.g2o"
    masat.write(CITY.with_priors(masat.gps([5], [[1.0, 2.0]], 0.5)), path)
    assert len(read_mapped(path, tmp_path).priors) == 1


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("EDGE_SE2 0 1 1 0", r"graph.g2o:3070: "),
        ("EDGE_SE2 0 1 1 0 0 -1 0 0 1 0 1", r"graph.g2o:3070: .* first that of edge 1 \(0 -> 1\)"),
        ("EDGE_SE2 0 5000 1 0 0 1 0 0 1 0 1", r"5000, which is not among the nodes"),
        ("FIX 5000", r"the fixed node 5000 is not in the graph"),
        ("VERTEX_SE2 0 1 2 3", r"the node id 0 occurs twice"),
    ],
)
def test_errors_of_a_graph_on_disk_name_the_line(tmp_path, monkeypatch, line, message):
    monkeypatch.setattr(streaming, "_BLOCK", 1000)
    path = tmp_path / "graph.g2o"
    masat.write(CITY, path)
    path.write_text(path.read_text() + line + "\n")
    with pytest.raises(masat.MasatError, match=message):
        read_mapped(path, tmp_path)


def test_the_command_line_takes_labels_and_refuses_what_does_not_fit(run, tmp_path):
    file, labels, folder = tmp_path / "city.g2o", tmp_path / "labels.txt", tmp_path / "parts"
    masat.write(CITY, file)
    np.savetxt(labels, np.stack([CITY.ids, CITY.ids // 500], 1), fmt="%d")
    assert run("partition", file, "-o", folder, "--labels", labels)[0] == 0
    assert masat.Partition(folder).index.parts == 2
    code, _, err = run("solve", folder, "--robust")
    assert code == 2
    assert "--robust does not go with a folder of parts" in err
    code, _, err = run("solve", file, "--restart")
    assert code == 2
    assert "--restart goes with a folder that masat partition made" in err
    labels.write_text("0 1 2\n")
    code, _, err = run("partition", file, "-o", tmp_path / "more", "--labels", labels)
    assert (code, err) == (2, f"masat: {labels}: has 3 columns, expected 'id part'\n")
