import csv
import re
from dataclasses import replace

import numpy as np
import pytest
from studies import SMALL, WORLD, run_all, trial

from masat.initializers import INITIALIZERS
from masat.study import Case, Design, Store
from masat.study.report import build_report
from masat.study.report.cells import cells_of
from masat.study.report.document import Table, markdown
from masat.study.report.figures import _COLORS, _MARKERS
from masat.study.report.glossary import MEANINGS, spoken_world
from masat.study.report.latex import latex
from masat.study.report.paper import Published, outside, published
from masat.study.report.paper_figures import paper_figures
from masat.study.report.tables import success_table
from masat.study.robust_methods import METHODS
from masat.study.worlds import GROUND_TRUTH
from masat.viewing.payload import unpack
from masat.worlds.false_closures import KINDS

NOISE_2D, NOISE_3D, NOISE_SIX = (0.1, 0.1, 0.1), (0.05, 0.02), (0.05, 0.05, 0.1, 0.02, 0.02, 0.03)
MIXED = Design(
    worlds=("manhattan:40:55", "sphere:40:70", "garage:40:60"),
    sigmas=(NOISE_2D, NOISE_3D, NOISE_SIX),
    instances=2,
    inits=("lago", "masat", "ground_truth"),
    title="Plane and space",
)


def report_of(design, folder, *, run=True, trials=()):
    with Store(folder / "store", design) as store:
        store.add(trials)
        if run:
            run_all(store)
        build_report(store, folder / "report")
    return (folder / "report" / "report.md").read_text()


def rows_of(folder, table):
    return (folder / "report" / f"{table}.csv").read_text().splitlines()


def test_the_report_holds_tables_figures_and_one_page(tmp_path):
    text = report_of(SMALL, tmp_path)
    assert "18 of 18 runs" in text
    assert "| manhattan:150:230 | (.1,.1,.1) |" in text
    page = (tmp_path / "report" / "report.html").read_text()
    assert page.count("data:image/svg+xml;base64,") == 2
    assert "http" not in page
    rates = rows_of(tmp_path, "success_relative")
    assert len(rates) == 3
    assert rates[0] == "world,noise,spanning_tree,masat,ground_truth"


def test_a_study_in_2d_and_3d_runs_and_is_reported(tmp_path):
    text = report_of(MIXED, tmp_path)
    assert text.startswith("# Plane and space\n")
    assert "30 of 30 runs" in text
    rows = list(csv.reader(rows_of(tmp_path, "success_relative")))[1:]
    levels = ["(.05,.02)", "(.05,.05,.1,.02,.02,.03)"]
    assert [row[1] for row in rows] == ["(.1,.1,.1)", *levels, *levels]
    assert all(rate.startswith("1.00") for row in rows for rate in row[3:])
    # LAGO is for 2D alone: its runs in 3D fail and say why, and stop nothing.
    assert [row[2] for row in rows] == ["1.00 [0.34, 1.00]", *["failed"] * 4]
    assert "8 runs failed, the first for this reason: sphere:40:70/.05,.02/0/lago: " in text
    assert "(x, y, theta) in 2D and (translation, rotation) or" in text


def test_reduced_chi2_in_3d_is_what_the_noise_allows(tmp_path):
    design = replace(MIXED, worlds=("sphere:200:600",), sigmas=(NOISE_3D,), inits=("ground_truth",))
    with Store(tmp_path, design) as store:
        run_all(store)
        for kept in store.trials():
            assert kept.degrees_of_freedom == 6 * (600 - 200 + 1)
            reduced = kept.reduced_chi2(kept.success())
            assert abs(reduced - 1) < 5 * np.sqrt(2 / kept.degrees_of_freedom)


def test_worlds_whose_runs_all_failed_are_reported(tmp_path):
    design = replace(SMALL, inits=("masat", "ground_truth"))
    failed = [
        replace(trial((), case, init), error="RuntimeError: no | luck\nat all")
        for case in design.cases()
        for init in design.inits
    ]
    text = report_of(design, tmp_path, run=False, trials=failed)
    assert "12 runs failed" in text
    assert rows_of(tmp_path, "success_relative")[1].endswith("failed,failed")
    assert rows_of(tmp_path, "minima")[1].endswith("0.00,0.00")


@pytest.mark.parametrize(
    "inits", [("chordal",), ("ground_truth",), ("masat",), ("odometry", "chordal")]
)
def test_any_choice_of_initial_guesses_is_reported(inits, tmp_path):
    text = report_of(replace(SMALL, inits=inits, instances=1), tmp_path)
    assert ("against" in text) == (len(inits) > 1)
    assert "paper" not in text


def test_a_study_that_has_just_begun_is_reported(tmp_path):
    text = report_of(SMALL, tmp_path, run=False)
    assert "0 of 18 runs" in text
    one = [trial([3.0, 2.0, 2.0])]
    (tmp_path / "begun").mkdir()
    text = report_of(SMALL, tmp_path / "begun", run=False, trials=one)
    assert "1 of 18 runs" in text


def test_real_graphs_alone_are_reported(tmp_path):
    design = Design((), (), 1, ("masat", "ground_truth"), graphs=("MIT", "sphere2500"))
    runs = [
        trial([5.0, 4.0, 4.0], Case("MIT", (), 0)),
        replace(trial((), Case("sphere2500", (), 0)), error="OSError: gone"),
    ]
    text = report_of(design, tmp_path, run=False, trials=runs)
    assert "2 of 2 runs" in text
    assert "noise" not in text
    assert "| MIT | masat | 5 | 4 | 2 |" in text
    assert "| failed: OSError: gone |" in text
    assert not (tmp_path / "report" / "rates.svg").exists()


def test_real_graphs_in_2d_and_3d_run(tmp_path, monkeypatch, data_dir):
    monkeypatch.setenv("MASAT_DATASETS", str(data_dir))
    # The information of cubicle is not positive semidefinite: a note of the reader, and no warning.
    design = Design((), (), 1, ("odometry",), graphs=("MIT", "tinyGrid3D"), max_iterations=2)
    text = report_of(design, tmp_path)
    assert "2 of 2 runs" in text
    assert "failed" not in text


# The paper's figures and columns


def fifty(successes, cell=("City10k", (0.35, 0.35, 0.35))):
    good, bad = [5.0, 4.0, 4.0], [4.0, 5.0, 6.0]
    return cells_of([trial(good if k < successes else bad, Case(*cell, k)) for k in range(50)])


PAPER = Design(("City10k", WORLD), ((0.35, 0.35, 0.35),), 50, ("masat",))


def test_cells_outside_the_papers_interval_are_named():
    paper = published(PAPER)
    # The paper has .18.
    assert outside(fifty(9), "masat", paper) == []
    (named,) = outside(fifty(30), "masat", paper)
    assert named.startswith("City10k (.35,.35,.35): 0.60 in [0.46, 0.72], paper 0.18")
    table = success_table(fifty(30), ("masat",), paper, relative=True)
    assert table.columns == ("world", "noise", "masat", "masat (paper)")
    assert table.rows[0][-1] == "0.18 *"


@pytest.mark.parametrize("other", [{"instances": 49}, {"max_iterations": 100}])
def test_other_instances_and_iterations_are_not_compared_with_the_paper(other):
    assert published(replace(PAPER, instances=200)).rates
    paper = published(replace(PAPER, **other))
    assert paper == Published()
    assert success_table(fifty(30), ("masat",), paper, relative=True).columns[-1] == "masat"


@pytest.mark.parametrize("cell", [("City10k", (0.3, 0.3, 0.35)), (WORLD, (0.35, 0.35, 0.35))])
def test_other_worlds_and_levels_are_not_compared_with_the_paper(cell, tmp_path):
    inits = ("odometry", "spanning_tree", "masat", "ground_truth")
    cells, paper = fifty(30, cell), published(PAPER)
    assert paper.inits(cells, inits) == set()
    assert outside(cells, "masat", paper) == []
    assert paper_figures(cells, inits, paper, tmp_path, 50) == []


def test_a_study_of_the_papers_cells_may_do_without_masat(tmp_path):
    case = Case("City10k", (0.35, 0.35, 0.35), 0)
    design = replace(PAPER, worlds=("City10k",), inits=("chordal",))
    report_of(design, tmp_path, run=False, trials=[trial([5.0, 4.0, 4.0], case, "chordal")])
    assert rows_of(tmp_path, "success_relative")[0] == "world,noise,chordal"
    assert not (tmp_path / "report" / "agreement.csv").exists()


def test_a_study_like_the_papers_has_its_columns_and_its_test(tmp_path):
    case = Case("City10k", (0.35, 0.35, 0.35), 0)
    text = report_of(PAPER, tmp_path, run=False, trials=[trial([5.0, 4.0, 4.0], case)])
    assert "(the paper's Table 1)" in text
    assert rows_of(tmp_path, "agreement")[1].startswith("City10k,")


# The document


def test_a_cell_of_a_markdown_table_stays_one_cell():
    text = markdown([Table("t", ("a",), (("x | y\nz",),))])
    assert text.splitlines()[-1] == "| x \\| y z |"
    assert len(re.findall(r"\n", text)) == 3


def test_a_table_for_latex_has_no_commands_of_its_own():
    table = Table("by_init", ("world", "ground_truth"), (("a & b_1", r"50 % ~ #1 {x} \y^2 <1"),))
    text = latex(table, "Rates of $x$")
    assert r"\caption{Rates of \$x\$}" in text
    assert r"\label{tab:by-init}" in text
    assert r"\begin{tabular}{lr}" in text
    sentences = Table(
        "t", ("name", "meaning"), (("p", "a sentence that has more than forty characters"),)
    )
    assert r"\begin{tabular}{lp{0.6\linewidth}}" in latex(sentences, "")
    assert (
        r"    a \& b\_1 & 50 \% \textasciitilde{} \#1 \{x\} \textbackslash{}y"
        r"\textasciicircum{}2 \textless{}1 \\"
    ) in text


def test_a_report_for_a_paper_has_vectors_and_latex(tmp_path):
    with Store(tmp_path / "store", replace(SMALL, title="Two levels")) as store:
        run_all(store)
        made = build_report(store, tmp_path / "report", latex=True)
        again = build_report(store, tmp_path / "again")
    names = {path.name for path in (tmp_path / "report").iterdir()}
    assert {"rates.pdf", "rates.svg", "times.pdf", "times.svg", "success_relative.tex"} <= names
    for table in made.tables:
        caption = (tmp_path / "report" / f"{table}.tex").read_text()
        assert r"\caption{Two levels. " in caption
    assert not list((tmp_path / "again").glob("*.tex"))
    # The same study gives the same figures, byte for byte.
    for name in ("rates.pdf", "rates.svg", "times.pdf", "times.svg"):
        one, two = (tmp_path / folder / name for folder in ("report", "again"))
        assert one.read_bytes() == two.read_bytes()
    assert made.html == again.html
    assert "Two levels: success rates" in made.html


def test_each_name_in_a_report_is_explained(tmp_path):
    with Store(tmp_path / "one", SMALL) as store:
        run_all(store)
        table = build_report(store, tmp_path / "made").tables["abbreviations"]
    names = [name for name, _ in table.rows]
    assert names == ["masat", "spanning_tree", "ground_truth", "chi2", "p", "ms", "s"]
    for name in (*INITIALIZERS, *METHODS, *KINDS, GROUND_TRUTH):
        assert name in MEANINGS or name == "given", name


def test_no_two_of_what_is_compared_look_alike():
    looks = {
        (_MARKERS[i % len(_MARKERS)], _COLORS[i % len(_COLORS)], i % 2)
        for i in range(len(_MARKERS) * len(_COLORS))
    }
    assert len(looks) == 77
    assert len({_MARKERS[i % len(_MARKERS)] for i in range(11)}) == 11


def test_worlds_are_spelled_out():
    assert spoken_world("manhattan:1000:1550") == "manhattan, 1,000 nodes, 1,550 edges"
    assert spoken_world("sphere:500") == "sphere, 500 nodes"
    assert spoken_world("City10k") == "City10k"
    assert spoken_world("./a:b.g2o (.1)") == "./a:b.g2o (.1)"


def test_a_report_holds_views_on_request(tmp_path):
    with Store(tmp_path / "store", replace(SMALL, instances=1)) as store:
        run_all(store)
        made = build_report(store, tmp_path / "report", views=True)
    (page,) = (tmp_path / "report").glob("map_*.html")
    assert page.name == "map_manhattan_150_230_2_2_2_0.html"
    assert made.html.count("<iframe srcdoc=") == 1
    header, arrays = unpack(re.search(r'text/plain">(.*?)</', page.read_text())[1])
    assert header["title"].startswith("manhattan:150:230/.2,.2,.2/0, best from ")
    assert len(header["states"]) == len(arrays["chi2"]) == len(SMALL.inits)
    assert min(header["chi2"]) == header["chi2"][-1]
    assert f"]({page.name})" in (tmp_path / "report" / "report.md").read_text()
    assert "<iframe" in made._repr_html_()
