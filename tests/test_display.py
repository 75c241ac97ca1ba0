import base64
import re
from html.parser import HTMLParser
from types import SimpleNamespace

import numpy as np
import pytest
from random_graphs import random_graph

import masat
from masat import PoseGraph, display
from masat.display import certificate_html, diagnosis_html, graph_html, result_html
from masat.viewing.payload import unpack
from masat.worlds import manhattan, perturb


class _Page(HTMLParser):
    """Collects the rows of the table and the pictures, and checks that all elements are closed."""

    def __init__(self, html):
        super().__init__()
        self.rows, self.pictures, self.pages, self._open = [], [], [], []
        self.feed(html)
        assert self._open == []

    def handle_starttag(self, tag, attributes):
        assert tag in {"div", "b", "span", "table", "tr", "td", "th", "iframe"}
        if tag == "iframe":
            self.pages.append(dict(attributes)["srcdoc"])
        self._open.append(tag)
        if tag == "tr":
            self.rows.append([])

    def handle_startendtag(self, tag, attributes):
        assert tag == "img"
        source = dict(attributes)["src"]
        kind, data = source.split(",")
        assert kind == "data:image/png;base64"
        self.pictures.append(base64.b64decode(data, validate=True))

    def handle_endtag(self, tag):
        assert self._open.pop() == tag

    def handle_data(self, data):
        if "tr" in self._open:
            self.rows[-1].append(data)
        else:
            self.rows.append([data])


def page(html):
    read = _Page(html)
    return {row[0]: "".join(row[1:]) for row in read.rows}, read.pictures


def certificate(**changes):
    values = {
        "status": "optimal", "certified": True, "message": "no poses have a lower chi2",
        "chi2": 2.5, "bound": 2.25, "gap": 0.25, "better": None,
    }  # fmt: skip
    return SimpleNamespace(**(values | changes))


RING = PoseGraph.from_arrays(
    [(0, 1), (1, 2), (2, 0)], [(1, 0, 0), (1, 0, 0), (0, 0, 0)],
    poses=[(0, 0, 0), (1, 0, 0), (2, 0, 0)],
)  # fmt: skip


@pytest.mark.parametrize("graph", [RING, random_graph(3, 20, 10, seed=1)])
def test_a_graph_is_shown_with_its_sizes_and_a_picture(graph):
    rows, (picture,) = page(graph_html(graph))
    assert rows["dimension"] == f"{graph.dimension}D"
    assert rows["nodes"].startswith(f"{len(graph.ids)}, ids 0 to")
    assert picture.startswith(b"\x89PNG")
    assert len(picture) < 200_000


def test_the_rows_of_a_graph():
    rows, _ = page(graph_html(RING))
    assert rows["edges"] == "3: 2 odometry, 1 loop closures"
    assert (rows["fixed"], rows["gauge"], rows["chi2"]) == ("no node", "0", "4")


def test_a_graph_without_poses_is_shown_without_a_picture():
    rows, pictures = page(graph_html(PoseGraph.from_arrays([(0, 1)], [(1, 0, 0)])))
    assert pictures == []
    assert rows["picture"].startswith("none: the graph has no poses")


def test_a_graph_that_takes_long_to_draw_is_shown_without_a_picture(monkeypatch):
    monkeypatch.setattr(display, "_MAX_DRAWN_EDGES", 2)
    rows, pictures = page(graph_html(RING))
    assert pictures == []
    assert rows["picture"] == "none: more than 2 edges, masat.plot draws them"


def test_many_fixed_nodes_are_cut_short():
    graph = manhattan(100, 150, extent=6)
    fixed = PoseGraph.from_arrays(
        graph.edges, graph.measurements, poses=graph.poses, fixed=range(100)
    )
    assert page(graph_html(fixed))[0]["fixed"] == "0, 1, 2, 3, 4 and 95 more"


def test_a_result_is_shown():
    result = masat.optimize(
        masat.initialize(perturb(manhattan(100, 150, extent=6), (0.1,) * 3), "masat")
    )
    rows, pictures = page(result_html(result))
    assert rows["chi2"] == f"{result.initial_chi2:.6g} → {result.chi2:.6g}"
    assert (rows["converged"], rows["stopped"]) == ("yes", result.message)
    assert rows["iterations"] == str(result.iterations)
    # The map is the interactive page, and no picture repeats it.
    (shown,) = _Page(result_html(result)).pages
    header, arrays = unpack(re.search(r'text/plain">(.*?)</', shown)[1])
    assert header["chi2"] == [pytest.approx(result.chi2)]
    assert len(arrays["ends"]) == len(result.graph.edges)
    assert pictures == []


def test_a_large_result_is_shown_with_a_picture(monkeypatch):
    monkeypatch.setattr(display, "_MAX_VIEWED_EDGES", 2)
    result = masat.optimize(RING)
    read = _Page(result_html(result))
    assert read.pages == []
    assert read.pictures[0].startswith(b"\x89PNG")


def test_a_comparison_is_a_table():
    found = masat.compare(RING)
    read = _Page(found._repr_html_())
    head, *rows = read.rows[: len(found.runs) + 1]
    assert tuple(head) == found.columns
    assert [row[0] for row in rows] == [run.init for run in found.runs]
    assert found.best.result.chi2 == min(run.result.chi2 for run in found.runs)
    assert [row[-1] for row in rows if row[0] == found.best.init] == ["best"]
    assert repr(found).startswith(f"Comparison({len(found.runs)} runs, best chi2 ")


def test_a_comparison_says_what_fails_and_shows_its_maps():
    graph = random_graph(3, 20, 10, seed=1, noise=0.01)
    found = masat.compare(graph.without_edges([]))
    assert "lago" in found.failures
    assert "lago fails: lago is for planar graphs only" in found._repr_html_()
    header, _ = unpack(re.search(r'text/plain">(.*?)</', found.view().html)[1])
    assert len(header["states"]) == len(found.runs)
    assert header["chi2"][-1] == pytest.approx(found.best.result.chi2)


def test_a_graph_that_no_initial_guess_can_do_is_refused(monkeypatch):
    monkeypatch.setattr("masat.comparison.INITIALIZERS", {"given": None})
    with pytest.raises(masat.InitializationError, match="no initial guess leads anywhere: "):
        masat.compare(PoseGraph.from_arrays([(0, 1)], [(1, 0, 0)]))


def test_sentences_in_a_table_are_to_the_left_and_wrapped():
    html = display.table_html(
        ("name", "meaning"), [("a", "a sentence that has more than forty characters")]
    )
    assert 'max-width:40em">meaning</th>' in html
    assert html.count("nowrap") == 2  # the first column


def test_tables_escape_text():
    assert display.table_html(("a", "<b>"), [("x", "&")], ["<i>"]) == (
        '<div><table><tr><th style="text-align:left;white-space:nowrap">a</th><th style="'
        'text-align:right;white-space:nowrap">&lt;b&gt;</th></tr><tr><td style="text-align:left;'
        'white-space:nowrap">x</td><td style="text-align:right;white-space:nowrap">&amp;</td></tr>'
        "</table><div>&lt;i&gt;</div></div>"
    )


def test_jupyter_shows_a_diagnosis():
    formatters = pytest.importorskip("IPython.core.formatters")
    diagnosis = masat.diagnose(RING)
    html = formatters.HTMLFormatter()(diagnosis)
    assert html == diagnosis_html(diagnosis)
    rows, pictures = page(html)
    assert rows["edges"] == "3: 2 odometry, 1 loop closures"
    assert rows["largest chi2"] == "2 → 0 (4), 0 → 1 (0), 1 → 2 (0)"
    assert pictures == []


def test_a_diagnosis_lists_its_issues():
    diagnosis = masat.diagnose(PoseGraph.from_arrays([(0, 1)], [(1, 0, 0)]))
    rows, _ = page(diagnosis_html(diagnosis))
    assert [rows["issue"]] == list(diagnosis.issues)


@pytest.mark.parametrize("status", ["optimal", "refuted", "undecided", "new"])
def test_a_certificate_is_shown_with_its_status(status):
    html = certificate_html(certificate(status=status))
    rows, pictures = page(html)
    assert status in rows
    assert (rows["chi2"], rows["lower bound"], rows["gap"]) == ("2.5", "2.25", "0.25")
    assert pictures == []


def test_only_what_is_proven_is_green():
    colors = {
        s: certificate_html(certificate(status=s)).split("background:")[1][:7]
        for s in ("optimal", "refuted", "undecided")
    }
    assert len(set(colors.values())) == 3


def test_a_certificate_shows_better_poses():
    rows, (picture,) = page(certificate_html(certificate(status="refuted", better=RING)))
    assert rows["better poses"] == "chi2 4, in the picture"
    assert picture.startswith(b"\x89PNG")


def test_text_is_escaped():
    evil = "<script>alert('x & y')</script>"
    graph = PoseGraph.from_arrays([(0, 1)], [(1, 0, 0)], notes=[evil])
    shown = [
        (graph_html(graph), "note"),
        (diagnosis_html(masat.diagnose(PoseGraph.from_arrays(
            [(0, 1), (1, 2), (2, 0)], [(1, 0, 0)] * 3, notes=[evil]))), "issue"),
        (certificate_html(certificate(message=evil, status=evil)), "meaning"),
        (result_html(SimpleNamespace(message=evil)), "stopped"),
    ]  # fmt: skip
    for html, row in shown:
        assert "<script" not in html
        assert page(html)[0][row] == evil


class _Broken:
    def __getattribute__(self, name):
        raise RuntimeError("<broken>")


@pytest.mark.parametrize("make", [graph_html, result_html, diagnosis_html, certificate_html])
@pytest.mark.parametrize("kind", [_Broken, SimpleNamespace, int])
def test_nothing_raises(make, kind):
    thing = kind()
    assert "not available" in make(thing)
    page(make(thing))


def test_a_picture_that_fails_leaves_the_table(monkeypatch):
    def fail(*_, **__):
        raise MemoryError("no <memory>")

    monkeypatch.setattr("masat.plotting.plot", fail)
    rows, pictures = page(graph_html(RING))
    assert pictures == []
    assert rows["picture"] == "none: no <memory>"
    assert rows["chi2"] == "4"


def test_a_graph_without_edges_is_shown():
    graph = PoseGraph.from_arrays(np.empty((0, 2), int), [], ids=[7], poses=[(1, 2, 3)])
    rows, (picture,) = page(graph_html(graph))
    assert rows["nodes"] == "1, ids 7 to 7"
    assert picture.startswith(b"\x89PNG")
