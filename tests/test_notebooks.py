"""What notebooks show: results, graphs, tables, pictures and progress.

The tests with a kernel are skipped without nbclient and ipykernel; `make test-bridges` installs
them.
"""

import re

import numpy as np
import pytest

import masat
from masat.notebook import Progress
from masat.optimizers import Iteration
from masat.progress import Stage
from masat.worlds import manhattan, perturb

GRAPH = perturb(manhattan(100, 160, extent=6, seed=0), (0.1, 0.1, 0.05), seed=0)


def executed(*cells):
    """Run cells in a kernel of their own; return their outputs."""
    nbformat = pytest.importorskip("nbformat")
    client = pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(c) for c in cells])
    # A kernel of this interpreter, whatever kernels are installed on the machine.
    notebook.metadata["kernelspec"] = {"name": "python3", "display_name": "", "language": "python"}
    client.NotebookClient(notebook, timeout=120).execute()
    return [cell.outputs for cell in notebook.cells]


@pytest.mark.filterwarnings("ignore")
def test_a_notebook_shows_everything(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    masat.write(GRAPH, "graph.g2o")
    prepared, graph, result, view, picture, table, study, progress = executed(
        "import masat\nfrom masat.notebook import Progress\ngraph = masat.read('graph.g2o')\n"
        "result = masat.solve(graph)",
        "graph",
        "result",
        "masat.view(result, before=graph)",
        "masat.plot(result)",
        "masat.compare(graph)",
        "from masat.study.report.document import Table\nTable('rates', ('a', 'b'), (('1', '2'),))",
        "show = Progress('solving')\n"
        "again = masat.solve(graph, init='odometry', report=show, report_stage=show)",
    )
    assert prepared == []
    assert "<b>PoseGraph</b>" in graph[0].data["text/html"]
    for shown in (result, view):
        assert "<iframe srcdoc=" in shown[0].data["text/html"]
    assert "image/png" in picture[0].data
    assert "<table>" in table[0].data["text/html"]
    assert "<table>" in study[0].data["text/html"]
    # One line, which was updated until the end: no output a step.
    (line,) = progress
    assert line.output_type == "display_data"
    assert re.search(r"solving .*iteration \d+ .*chi2 \d", line.data["text/html"])


def test_progress_tells_stages_iterations_and_warnings():
    show = Progress("a <map>")
    show(Stage("searching in 3 parts", None, 0.0))
    assert "a &lt;map&gt; \u00b7 searching in 3 parts \u00b7 " in show.html
    show(Iteration(12.5, 0.1, 0.0, 0.0))
    show(Iteration(11.25, 0.1, 0.0, 0.0))
    assert "iteration 2 \u00b7 chi2 11.25" in show.html
    show(Stage("edge 1 -> 2 looks wrong", None, 0.0, True))
    assert "<div>note: edge 1 -&gt; 2 looks wrong</div>" in show.html
    assert "searching in 3 parts" in show.html


def test_progress_counts_steps():
    show = Progress("runs", total=40)
    show.advance(10)
    show.advance()
    assert '<progress value="11" max="40">' in show.html
    assert "11 of 40" in show.html
    assert "iteration" not in show.html


def test_progress_shows_nothing_outside_of_a_notebook(capsys):
    show = Progress("solving")
    result = masat.solve(GRAPH, init="odometry", report=show, report_stage=show)
    assert f"iteration {result.iterations} " in show.html
    assert capsys.readouterr() == ("", "")


def test_progress_stops_no_optimizer():
    """A report that returns something true would."""
    show = Progress()
    assert show(Iteration(1.0, 0.1, 0.0, 0.0)) is None
    plain = masat.optimize(masat.initialize(GRAPH, "odometry"))
    shown = masat.optimize(masat.initialize(GRAPH, "odometry"), report=show)
    assert np.array_equal(plain.poses, shown.poses)
