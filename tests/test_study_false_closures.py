"""Studies of false loop closures: cases, scores, store and report."""

import csv
import json
import re
import sqlite3
from dataclasses import replace

import numpy as np
import pytest
from studies import keys, run_all, wanted
from test_study_cli import call

import masat
from masat import PoseGraph
from masat.study import Case, ClosureTrial, Design, Store, StudyError, load_design, parse_run
from masat.study.cases import run_case
from masat.study.closure_trial import spoiled
from masat.study.report import build_report
from masat.study.robust_methods import METHODS
from masat.study.scores import Scores, score
from masat.study.trial import instance

TINY = Design(
    worlds=("manhattan:60:100", "grid:27"),
    sigmas=((0.05, 0.05, 0.02), (0.05, 0.02)),
    instances=2,
    kinds=("random", "alias"),
    fractions=(0.25, 0.5),
    methods=("robust", "plain", "gnc_tls"),
    title="Lies",
)
CASE = Case("manhattan:60:100", (0.05, 0.05, 0.02), 0, "alias", 0.5)
GOOD = """\
worlds = ["manhattan:60:100"]
sigmas = [[0.05, 0.05, 0.02]]
instances = 2
kinds = ["random", "alias"]
fractions = [0.25, 0.5]
methods = ["robust", "plain"]
"""
SCORES = Scores(10, 9, 5, 1, 1.01, 1.2, 0.25)


# Scores


def line(*closures):
    """Four nodes a meter apart and loop closures (a, b, x), at the exact poses of the line."""
    edges = [(0, 1), (1, 2), (2, 3), *((a, b) for a, b, _ in closures)]
    measured = [(1, 0, 0)] * 3 + [(x, 0, 0) for _, _, x in closures]
    poses = [(k, 0, 0) for k in range(4)]
    return PoseGraph.from_arrays(edges, measured, np.diag([100.0, 100, 400]), poses=poses)


@pytest.mark.parametrize("dimension", [2, 3])
def test_positions_on_one_line_have_a_distance(dimension):
    # They determine no rotation about the line, and none is needed for the distance.
    size = 3 if dimension == 2 else 7
    poses = np.tile(masat.lie.identity(dimension), (4, 1))
    poses[:, 0] = range(4)
    steps = np.tile(masat.lie.identity(dimension), (4, 1))
    steps[:, 0] = [1, 1, 1, 2.1]
    edges = [(0, 1), (1, 2), (2, 3), (0, 2)]
    graph = PoseGraph.from_arrays(edges, steps, poses=poses)
    moved = np.zeros((4, size))
    moved[:, 2:] = poses[:, 2:]
    moved[:, 1] = 2.0 * np.arange(4)  # along y, and twice as long
    found = score(graph, graph, np.zeros(4, bool), np.ones(4, bool), moved)
    # Off by -1.5, -.5, .5 and 1.5 along the line.
    assert found.rmse == pytest.approx(np.sqrt(1.25))
    same = score(
        graph.with_poses(0 * poses + masat.lie.identity(dimension)),
        graph,
        np.zeros(4, bool),
        np.ones(4, bool),
        moved,
    )
    assert same.rmse == pytest.approx(np.sqrt(5))


def test_scores_of_a_map_that_is_known():
    # At the clean map each true loop closure has a chi2 of 100 * .1^2 = 1, odometry one of 0.
    graph = line((0, 2, 2.1), (0, 3, -1.0), (1, 3, 2.1))
    is_false = np.array([False] * 4 + [True, False])
    clean = graph.without_edges(is_false)
    kept = np.array([True] * 5 + [False])
    moved = graph.poses.copy()
    moved[3, 0] += 1
    found = score(clean, graph, is_false, kept, moved)
    assert (found.true_closures, found.true_kept) == (2, 1)
    assert (found.false_closures, found.false_kept) == (1, 1)
    # The last odometry has 100, the first true loop closure 1, the second .9 m and 81, or its gate.
    assert found.chi2_ratio == pytest.approx((100 + 1 + 81) / 2)
    assert found.cost_ratio == pytest.approx((100 + 1 + 16.27) / 2)
    # The best translation moves the map back by 1/4 m.
    assert found.rmse == pytest.approx(np.sqrt((0.75**2 + 3 * 0.25**2) / 4))
    assert (found.precision, found.recall) == (0.5, 0.5)
    assert not found.success


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_error_does_not_depend_on_where_the_map_lies(dimension):
    world = masat.worlds.manhattan(40, 60) if dimension == 2 else masat.worlds.grid(27)
    graph = masat.worlds.perturb(world, [0.05] * masat.lie.DOF[dimension], seed=1)
    moved = (0.3, 2.0, -0.7) if dimension == 2 else (4.0, 5.0, 6.0, 0.5, 0.5, -0.5, 0.5)
    poses = masat.lie.compose(np.array([moved]), graph.poses)
    everything = np.ones(len(graph.edges), np.bool_)
    found = score(graph, graph, ~everything, everything, poses)
    assert found.rmse < 1e-12
    assert found.cost_ratio == pytest.approx(1)
    assert (found.precision, found.recall) == (1, 1)


def test_without_loop_closures_precision_and_recall_are_not_defined():
    graph = line()
    kept = np.zeros(3, np.bool_)
    found = score(graph, graph, kept, kept, graph.poses)
    assert (found.precision, found.recall) == (None, None)


@pytest.mark.parametrize(("ratio", "success"), [(1.05, True), (1.0500001, False)])
def test_a_map_succeeds_up_to_1_05_of_the_clean_one(ratio, success):
    assert replace(SCORES, cost_ratio=ratio).success == success
    assert replace(SCORES, chi2_ratio=ratio).strict_success == success


# Cases


def test_kinds_and_fractions_spoil_the_same_clean_graph():
    one = spoiled(CASE, 100)
    other = spoiled(replace(CASE, kind="random", fraction=0.25), 100)
    for name in ("edges", "measurements", "information"):
        assert np.array_equal(getattr(one.clean, name), getattr(other.clean, name))
    assert len(instance(CASE.clean).edges) == len(one.clean.edges)
    closures = len(one.clean.edges) - (len(one.clean) - 1)
    assert one.is_false.sum() == closures
    assert other.is_false.sum() == round(closures / 3)
    assert one.graph.poses is None
    again = spoiled(CASE, 100)
    assert np.array_equal(one.graph.measurements, again.graph.measurements)
    assert np.isclose(one.clean.chi2, 3 * closures, rtol=1e-6)


def test_instances_of_a_real_graph_differ_in_their_false_loop_closures(tmp_path):
    path = tmp_path / "map.g2o"
    masat.write(replace(instance(CASE.clean), poses=None), path)
    first, second = (spoiled(Case(str(path), (), k, "random", 0.5), 100) for k in (0, 1))
    assert np.array_equal(first.clean.edges, second.clean.edges)
    assert not np.array_equal(first.graph.edges, second.graph.edges)


@pytest.mark.parametrize("method", METHODS)
def test_each_method_answers(method):
    (trial,) = run_case(CASE, (method,), 100)
    assert trial.error == ""
    assert trial.seconds > 0
    assert trial.plain_seconds > 0
    scores = trial.scores
    assert scores.true_closures == scores.false_closures == 41
    # `plain` believes everything, the robust decision finds out.
    if method == "plain":
        assert (scores.true_kept, scores.false_kept) == (41, 41)
        assert not trial.succeeded
        assert scores.rmse > 0.5
    if method == "robust":
        assert (scores.true_kept, scores.false_kept) == (41, 0)
        assert trial.succeeded
        assert scores.rmse < 1e-6


def test_a_method_that_fails_is_recorded_and_stops_nothing(monkeypatch):
    def fails(graph, max_iterations):
        raise RuntimeError("no luck")

    monkeypatch.setitem(METHODS, "plain", fails)
    failed, fine = run_case(CASE, ("plain", "gnc_tls"), 100)
    assert failed.error == "RuntimeError: no luck"
    assert failed.scores is None
    assert not failed.succeeded
    assert fine.error == ""


def test_a_graph_that_cannot_be_spoiled_fails_with_its_reason(tmp_path):
    path = tmp_path / "chain.g2o"
    masat.write(line(), path)
    trials = run_case(Case(str(path), (), 0, "random", 0.5), ("robust", "plain"), 100)
    assert len(trials) == 2
    assert all(trial.error.startswith("GraphError: ") for trial in trials)


@pytest.mark.parametrize(
    "name",
    ["City10k/.35,.35,.35/alias:.5/17", "./a/map.g2o//random:.05/3", "sphere/.1,.05/local:0/0"],
)
def test_names_of_cases_with_false_loop_closures_lead_back_to_them(name):
    case, method = parse_run(f"{name}/robust")
    assert method == "robust"
    assert case.name == name
    assert case.kind


@pytest.mark.parametrize("name", ["a//x:y:z/0/robust", "a//x:many/0/robust", "x:.5/0/robust"])
def test_what_names_no_run_is_refused(name):
    with pytest.raises(StudyError, match="names no run"):
        parse_run(name)


# Designs


def test_the_shipped_design_has_the_kinds_and_methods():
    design = load_design("false_closures")
    assert set(design.kinds) == set(masat.worlds.false_closures.KINDS)
    assert set(design.methods) < set(METHODS)
    assert design.runs() == sum(len(design.columns_of(case)) for case in design.cases())


def test_every_graph_has_every_kind_fraction_and_instance():
    cases = TINY.cases()
    assert len(cases) == len(set(cases)) == 2 * 2 * 2 * 2
    assert TINY.runs() == 3 * len(cases)
    assert len({case.seed for case in cases}) == len(cases)
    real = replace(TINY, worlds=(), sigmas=(), graphs=("MIT",))
    assert real.runs() == 3 * len(real.cases()) == 3 * 2 * 2 * 2


@pytest.mark.parametrize(
    ("old", "new", "line", "said"),
    [
        ('"alias"', '"ghost"', 4, "unknown kind of false loop closures 'ghost'; known: random"),
        ('"plain"', '"magic"', 6, "unknown method 'magic'; known: robust, plain"),
        ('"plain"', '"robust"', 6, "named twice in methods"),
        ("0.25", "1", 5, "at least 0 and below 1, got 1"),
        ("0.25", "-0.5", 5, "at least 0 and below 1, got -0.5"),
        ("0.25", "nan", 5, "at least 0 and below 1, got nan"),
        ("0.25", '"half"', 5, "must be a number"),
        ("0.25", "true", 5, "must be a number"),
        ("0.25", "0.25000001", 5, "at most six digits, since it names the runs: write 0.25 for"),
        ("0.25", "0.5", 5, "the fraction 0.5 is given twice"),
        ("[0.25, 0.5]", "0.5", 5, "fractions must be a list of numbers"),
        ("[0.25, 0.5]", "[]", 5, "fractions is missing or empty: a study of false loop closures"),
        ("methods", 'inits = ["masat"]\nmethods', 6, "either inits or methods"),
        ('methods = ["robust", "plain"]', 'inits = ["masat"]', None, "methods is missing or empty"),
        ("instances = 2", "instances = 900_000", 3, "at most 1,000,000 are possible"),
        ("instances = 2", 'instances = 2\ngraphs = ["map.g2o"]', 4, "has a slash, such as"),
    ],
)
def test_a_bad_design_is_refused_with_the_line(old, new, line, said, tmp_path):
    path = tmp_path / "design.toml"
    assert old in GOOD
    path.write_text(GOOD.replace(old, new))
    with pytest.raises(StudyError) as error:
        load_design(str(path))
    assert said in str(error.value)
    assert str(error.value).startswith(f"{path}:" + (f"{line}: " if line else " "))


# Running, storing, reporting


def test_a_study_runs_once_is_stored_and_reported(tmp_path):
    with Store(tmp_path / "store", TINY) as store:
        counted = []
        run_all(store, progress=counted.append)
        assert keys(store) == wanted(TINY)
        assert sum(counted) == TINY.runs()
        trials = list(store.trials())
        assert not any(trial.error for trial in trials)
        for kept in trials[::7]:
            (again,) = run_case(kept.case, (kept.method,), TINY.max_iterations)
            assert again.scores == kept.scores
        build_report(store, tmp_path / "report", views=True)
    with Store(tmp_path / "store") as store:
        assert store.design == TINY
        assert list(store.trials()) == trials
    folder = tmp_path / "report"
    text = (folder / "report.md").read_text()
    assert text.startswith("# Lies\n")
    assert f"{TINY.runs()} of {TINY.runs()} runs" in text
    for name in ("rates.svg", "rates.pdf", "times.svg", "times.pdf"):
        assert (folder / name).exists()
    # One map of each world, at the largest fraction.
    views = {re.search(r"_(\w+)_\d", path.name)[1] for path in folder.glob("map_*.html")}
    assert len(views) == len(TINY.worlds)
    for table in ("success", "strict_success", "precision", "recall", "error", "time"):
        head, *rows = csv.reader((folder / f"{table}.csv").read_text().splitlines())
        assert head == ["graph", "noise", "kind", "fraction", *TINY.methods]
        assert len(rows) == 8
    success = list(csv.DictReader((folder / "success.csv").read_text().splitlines()))
    assert {row["robust"] for row in success} == {"1.00 [0.34, 1.00]"}
    assert {row["plain"] for row in success} == {"0.00 [0.00, 0.66]"}


def test_a_stopped_study_goes_on_where_it_was(tmp_path):
    started = []

    def stops(case, methods, limit):
        started.append(case)
        if len(started) > 5:
            raise KeyboardInterrupt
        return run_case(case, methods, limit)

    design = replace(TINY, methods=("plain",))
    with Store(tmp_path, design) as store:
        with pytest.raises(KeyboardInterrupt):
            run_all(store, run=stops)
        done = {trial.case for trial in store.trials()}
        assert 0 < len(done) < len(design.cases())
    again = []

    def notes(case, methods, limit):
        again.append(case)
        return run_case(case, methods, limit)

    with Store(tmp_path, design) as store:
        run_all(store, run=notes)
        assert not done & set(again)
        assert keys(store) == wanted(design)


def test_failed_runs_are_stored_reported_and_forgotten(tmp_path):
    failed = [
        ClosureTrial(case, method, None, 0.0, 0.0, "RuntimeError: no luck")
        for case in TINY.cases()
        for method in TINY.methods
    ]
    with Store(tmp_path / "store", TINY) as store:
        store.add(failed)
        assert sorted(store.trials(), key=str) == sorted(failed, key=str)
        build_report(store, tmp_path / "report")
        assert store.forget_failed() == len(failed)
        assert store.done() == set()
        build_report(store, tmp_path / "begun")
    rows = (tmp_path / "report" / "recall.csv").read_text().splitlines()
    assert rows[1].endswith("failed,failed,failed")
    assert "48 runs failed" in (tmp_path / "report" / "report.md").read_text()
    assert "0 of 48 runs" in (tmp_path / "begun" / "report.md").read_text()


def test_tables_hold_the_sums_and_medians_of_their_runs(tmp_path):
    one = TINY.cases()[0]
    other = replace(one, instance=1)
    runs = [
        ClosureTrial(one, "plain", SCORES, 2.0, 0.5),
        ClosureTrial(other, "plain", replace(SCORES, true_kept=10, rmse=0.75), 3.0, 0.5),
    ]
    with Store(tmp_path / "store", TINY) as store:
        store.add(runs)
        build_report(store, tmp_path / "report")

    def cells(name):
        lines = (tmp_path / "report" / f"{name}.csv").read_text().splitlines()
        assert len(lines) == 2
        return list(csv.reader(lines))[1][4:]

    assert cells("precision") == ["-", "0.9048 (2)", "-"]  # 19 of 21
    assert cells("recall") == ["-", "0.950", "-"]
    assert cells("error") == ["-", "0.5 / 0.75", "-"]
    assert cells("time") == ["-", "2.5 / 5", "-"]
    assert cells("success") == ["-", "1.00 [0.34, 1.00]", "-"]
    assert cells("strict_success") == ["-", "0.00 [0.00, 0.66]", "-"]


@pytest.mark.parametrize("scores", ["[1, 2", "7", '{"rmse": 1}', '{"rmse": "x"}', '[["rmse", 1]]'])
def test_a_damaged_store_is_refused_in_one_line(scores, tmp_path):
    with Store(tmp_path, TINY) as store:
        store.add([ClosureTrial(TINY.cases()[0], "plain", SCORES, 2.0, 0.5)])
    db = sqlite3.connect(tmp_path / "study.sqlite")
    db.execute("UPDATE closure_trial SET scores = ?", (scores,))
    db.commit()
    db.close()
    refused = pytest.raises(StudyError, match="not a readable store")
    with refused as error, Store(tmp_path) as store:
        list(store.trials())
    assert "\n" not in str(error.value)


def test_a_file_that_is_missing_ends_the_study_before_it_begins(tmp_path):
    design = replace(TINY, graphs=(f"{tmp_path}/gone.g2o",))
    with Store(tmp_path, design) as store:
        with pytest.raises(StudyError, match=r"gone\.g2o: there is no such file"):
            run_all(store)
        assert keys(store) == []


# The command line


def test_a_study_from_the_command_line(tmp_path):
    design, store, report = (tmp_path / name for name in ("design.toml", "store", "report"))
    design.write_text(GOOD)
    told = call("run", design, "--store", store, "--workers", 2)
    assert told.returncode == 0, told.stderr
    assert "16 of 16 runs done, 8 succeeded, 0 failed" in told.stdout
    status = json.loads(call("status", store, "--json").stdout)
    assert (status["done"], status["succeeded"]) == (16, 8)
    assert call("report", store, "-o", report).returncode == 0
    assert (report / "report.html").exists()
    name = "manhattan:60:100/.05,.05,.02/alias:.5/1"
    told = call("run", design, "--only", f"{name}/robust")
    assert told.returncode == 0, told.stderr
    said = json.loads(told.stdout)
    assert said["success"]
    assert said["recall"] == 1
    assert call("run", design, "--only", f"{name}/plain").returncode == 1


@pytest.mark.parametrize(
    ("run", "said"),
    [
        ("manhattan:60:100/.05,.05,.02/alias:.5/1/masat", "unknown method 'masat'; known: robust"),
        ("manhattan:60:100/.05,.05,.02/ghost:.5/1/plain", "there is no kind 'ghost'"),
        ("manhattan:60:100/.05,.05,.02/alias:2/1/plain", "below 1, got 2.0"),
    ],
)
def test_bad_usage_is_code_2_and_one_line(run, said):
    told = call("run", "quick", "--only", run)
    assert told.returncode == 2
    assert said in told.stderr
    assert told.stderr.count("\n") == 1
