from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from records import EDGE, UNIT_2D, UNIT_3D, WORLD

from masat import PoseGraph, _core, read, write
from masat.formats import FORMATS
from masat.formats.labels import label_texts, read_labels

LABELED = "labels" in {field.name for field in fields(PoseGraph)}

integers = st.lists(st.integers(-(2**63), 2**63 - 1), min_size=1).map(
    lambda labels: np.array(labels, np.int64)
)
# Also words that look like integers, quotes, line ends, comments; NumPy drops final zero bytes.
words = st.one_of(
    st.text(max_size=8),
    st.sampled_from(["7", "-0", "+1", "007", "", " ", '"', '"a"', "#", "a b", "a\nb", "\r", "ä"]),
).map(lambda word: word.rstrip("\0"))
strings = st.lists(words, min_size=1).map(lambda labels: np.array(labels, np.str_))


def parsed_labels(text, name="g2o"):
    return _core.parse(text, FORMATS[name].records)["edge_labels"]


def written(labels):
    return _core.format_lines(
        "EDGE_SE2",
        np.array([[0, 1]] * len(labels)),
        np.array([[1, 2, 3, 1, 0, 0, 1, 0, 1.0]] * len(labels)),
        label_texts(labels),
    )


def test_a_label_is_a_comment_behind_the_numbers_of_an_edge():
    assert written(np.array([7, -1])) == (
        b"EDGE_SE2 0 1 1 2 3 1 0 0 1 0 1 # label: 7\nEDGE_SE2 0 1 1 2 3 1 0 0 1 0 1 # label: -1\n"
    )
    assert label_texts(np.array(["gps", "scan match", "ä", "#1"])) == [
        *("gps", "scan match", "ä", "#1")
    ]


def test_strings_that_would_read_back_otherwise_are_quoted():
    labels = np.array(["7", "", " a", 'say "a"', '"', "a\nb"])
    assert label_texts(labels) == ['"7"', '""', '" a"', 'say "a"', '"\\""', '"a\\nb"']


@given(st.one_of(integers, strings))
def test_labels_read_back_as_they_were_written(labels):
    again = read_labels(parsed_labels(written(labels)))
    assert again.dtype.kind == labels.dtype.kind
    assert again.tolist() == labels.tolist()


@pytest.mark.parametrize("dtype", [np.int8, np.uint16, np.int32, np.uint64])
def test_integers_of_any_size_are_written(dtype):
    assert read_labels(parsed_labels(written(np.array([1, 100], dtype)))).tolist() == [1, 100]


@pytest.mark.parametrize(
    ("comment", "label"),
    [
        ("# label: loop", b"loop"),
        ("#label:loop \t\r", b"loop"),
        ("#  label:  a  b # c", b"a  b # c"),
        ("# label:", None),
        ("# labels: x", None),
        ("# a label: x", None),
        ("# LABEL: x", None),
        ("# label : x", None),
    ],
)
def test_a_label_is_what_follows_the_word_label_in_a_comment(comment, label):
    found = parsed_labels(f"{EDGE.strip()} {comment}\n".encode())
    assert found == (None if label is None else [label])


def test_an_edge_without_label_has_an_empty_one_if_another_edge_has_one():
    labeled = EDGE.strip() + " # label: 7\n"
    assert parsed_labels(EDGE.encode()) is None
    assert parsed_labels(f"# label: 1\n{EDGE}# label: 2\n".encode()) is None
    assert parsed_labels((EDGE + labeled + EDGE + EDGE).encode()) == [b"", b"7", b"", b""]
    assert read_labels([b"", b"7"]).tolist() == [-1, 7]
    assert read_labels([b"", b"7", b"a"]).tolist() == ["", "7", "a"]


def test_labels_of_vertices_are_comments():
    text = WORLD.replace("2 3 4 -0.25\n", "2 3 4 -0.25 # label: x\n")
    assert parsed_labels(text.encode()) is None


def test_edges_in_space_and_of_other_formats_have_labels_too():
    bare = b"EDGE_SE3:QUAT 0 1 1 2 3 0 0 0 1 # label: a\n"
    full = f"EDGE_SE3:QUAT 1 2 1 2 3 0 0 0 1 {UNIT_3D} # label: b\n".encode()
    assert parsed_labels(bare + full) == [b"a", b"b"]
    assert parsed_labels(f"EDGE2 0 1 1 2 3 {UNIT_2D} # label: c\n".encode(), "isam") == [b"c"]


@pytest.mark.parametrize("text", [b'"', b'"a', b'"a" b', b"\xff\xfe", b"9" * 30])
def test_texts_that_masat_does_not_write_are_strings(text):
    assert read_labels([text]).tolist() == [text.decode("utf-8", "replace")]


@pytest.mark.skipif(not LABELED, reason="PoseGraph has no labels")
@given(st.one_of(integers, strings.filter(lambda labels: all(map(str.isprintable, labels)))))
def test_the_labels_of_a_graph_survive_a_file(tmp_path_factory, labels):
    path = tmp_path_factory.getbasetemp() / "labels.g2o"
    m = len(labels)
    graph = PoseGraph.from_arrays([(0, 1)] * m, [(1, 0, 0)] * m, labels=labels)
    write(graph, path)
    again = read(path)
    assert again.labels.dtype.kind == graph.labels.dtype.kind
    assert again.labels.tolist() == graph.labels.tolist()
    bare = PoseGraph.from_arrays([(0, 1)], [(1, 0, 0)])
    write(bare, path)
    assert read(path).labels is None
