import json
import math
import sqlite3
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from masat.study import (
    Case,
    Design,
    Store,
    StudyError,
    Trial,
    load_design,
    parse_run,
    run_case,
    run_study,
)
from masat.study import runner as runner_module
from masat.study.cluster import on_cluster

WORLD = "manhattan:150:230"
SMALL = Design(
    worlds=(WORLD,),
    sigmas=((0.1, 0.1, 0.1), (0.2, 0.2, 0.2)),
    instances=3,
    starts=("spanning_tree", "masat", "ground_truth"),
)
CASE = Case(WORLD, (0.1, 0.1, 0.1), 0)


def trial(chi2, case=CASE, start="masat"):
    return Trial(case, start, tuple(chi2), 10, 0.001, 0.01)


def keys(store):
    return sorted((t.case.name, t.start) for t in store.trials())


def wanted(design):
    return sorted((c.name, s) for c in design.cases() for s in design.starts_of(c))


def run_all(store, **more):
    with ThreadPoolExecutor(2) as executor:
        run_study(store, executor, **more)


# Designs


def test_the_papers_design_has_1200_instances_and_4800_runs():
    design = load_design("paper")
    noisy = [c for c in design.cases() if c.sigma]
    assert len(noisy) == len(set(noisy)) == 1200
    assert sum(len(design.starts_of(c)) for c in noisy) == 4800
    assert len(design.graphs) == 36


def test_the_quick_design_is_shipped():
    assert load_design("quick").instances > 0


GOOD = """\
worlds = ["manhattan:100:150"]
sigmas = [[0.1, 0.1, 0.1],
          [0.2, 0.2, 0.3]]
instances = 2
starts = ["masat"]
"""


@pytest.mark.parametrize(
    ("old", "new", "line", "said"),
    [
        ("manhattan:100:150", "Atlantis", 1, "unknown world 'Atlantis'"),
        ("manhattan:100:150", "manhattan:x:9", 1, "unknown world"),
        ('"masat"', '"masat", "magic"', 5, "unknown start 'magic'"),
        ('"masat"', '"masat", "masat"', 5, "named twice"),
        ("0.3", "-0.3", 3, "not negative, got -0.3"),
        ("0.3", "nan", 3, "not negative, got nan"),
        ("0.3", '"loud"', 3, "must be a number"),
        ("[0.2, 0.2, 0.3]", "[0.2, 0.2]", 2, "sigmas of x, y and theta"),
        ("instances = 2", "instances = 0", 4, "positive integer"),
        ("instances = 2", "instances = 1.5", 4, "positive integer"),
        ("instances = 2", "repeats = 2", 4, "unknown key 'repeats'"),
        ("instances = 2", "", None, "instances must be"),
        ("worlds = ", "worlds = [[[", None, "line 2"),
    ],
)
def test_a_bad_design_is_refused_with_the_line(old, new, line, said, tmp_path):
    path = tmp_path / "design.toml"
    path.write_text(GOOD.replace(old, new))
    with pytest.raises(StudyError) as error:
        load_design(str(path))
    assert said in str(error.value)
    if line is not None:
        assert f"design.toml:{line}: " in str(error.value)


def test_an_unknown_design_names_those_that_are_shipped():
    with pytest.raises(StudyError, match="shipped: paper, quick"):
        load_design("grand")


def test_the_name_of_a_run_leads_back_to_it():
    case = Case("City10k", (0.35, 0.35, 0.35), 17)
    assert case.name == "City10k/.35,.35,.35/17"
    assert parse_run(case.name + "/masat") == (case, "masat")
    for name in ("City10k", "City10k/x,y,z/17/masat", "City10k/.1,.1,.1/one/masat"):
        with pytest.raises(StudyError, match="names no run"):
            parse_run(name)


def test_each_case_has_a_seed_of_its_own_that_never_changes():
    seeds = {c.seed for c in load_design("paper").cases()}
    assert len(seeds) == 1236
    assert Case("City10k", (0.35, 0.35, 0.35), 17).seed == 13394451965791113973


# Success


@pytest.mark.parametrize(
    ("chi2", "relative", "absolute"),
    [
        ([100, 50, 50], 2, 2),
        ([1e6, 1e6 - 0.5], 1, None),
        ([100, 50, 49, 48.99999], 3, None),
        ([100, 100 + 1e-7], None, 1),
        ([100, 100 + 2e-11], 1, 1),
        ([100, 200, 300], None, None),
        ([0, 0], 1, 1),
        ([5], None, None),
        ([], None, None),
    ],
)
def test_success_by_either_threshold(chi2, relative, absolute):
    assert trial(chi2).success() == relative
    assert trial(chi2).success(relative=False) == absolute


@pytest.mark.parametrize(
    ("chi2", "iteration"),
    [([100, 50, 50 + 1e-9], 2), ([1e-8, 3e-9], 1), ([100, 99], None), ([5], None)],
)
def test_a_real_graph_has_settled_where_chi2_only_flickers(chi2, iteration):
    assert trial(chi2).settled() == iteration


# Running


def test_a_study_runs_once_and_any_run_can_be_repeated(tmp_path):
    with Store(tmp_path, SMALL) as store:
        counted = []
        run_all(store, progress=counted.append)
        assert keys(store) == wanted(SMALL)
        assert sum(counted) == len(wanted(SMALL))
        for kept in store.trials():
            (again,) = run_case(kept.case, (kept.start,), 50)
            assert again.chi2 == kept.chi2
            assert kept.start_seconds > 0


def test_the_truth_converges_to_what_its_noise_allows(tmp_path):
    with Store(tmp_path, SMALL) as store:
        run_all(store)
        for kept in store.trials():
            if kept.start == "ground_truth":
                reduced = kept.chi2[kept.success()] / kept.degrees_of_freedom
                assert abs(reduced - 1) < 5 * math.sqrt(2 / kept.degrees_of_freedom)


def test_a_stopped_study_goes_on_where_it_was(tmp_path):
    started = []

    def count(case, starts, limit):
        started.append(case)
        if len(started) == 4:
            raise KeyboardInterrupt
        return run_case(case, starts, limit)

    with Store(tmp_path, SMALL) as store, ThreadPoolExecutor(1) as executor:
        with pytest.raises(KeyboardInterrupt):
            run_study(store, executor, run=count)
        kept = {t.case for t in store.trials()}
    assert 0 < len(kept) < 6
    again = []

    def note(case, starts, limit):
        again.append(case)
        return run_case(case, starts, limit)

    with Store(tmp_path, SMALL) as store:
        run_all(store, run=note)
        assert not kept & set(again)
        assert keys(store) == wanted(SMALL)


def test_one_failing_run_is_recorded_and_stops_nothing(tmp_path, monkeypatch):
    from masat.study import trial as trial_module

    honest = trial_module.guess_of

    def fails(graph, start):
        if start == "masat":
            raise RuntimeError("no luck")
        return honest(graph, start)

    monkeypatch.setattr(trial_module, "guess_of", fails)
    with Store(tmp_path, SMALL) as store:
        run_all(store)
        failed = [t for t in store.trials() if t.error]
        assert {t.start for t in failed} == {"masat"}
        assert failed[0].error == "RuntimeError: no luck"
        assert failed[0].success() is None
        assert keys(store) == wanted(SMALL)
        monkeypatch.undo()
        assert store.forget_failed() == 6
        run_all(store)
        assert not any(t.error for t in store.trials())


def test_a_world_that_cannot_be_had_ends_the_study_before_it_begins(tmp_path, monkeypatch):
    def missing(name):
        raise StudyError("no such file")

    monkeypatch.setattr(runner_module, "load_world", missing)
    with Store(tmp_path, SMALL) as store:
        with pytest.raises(StudyError, match="no such file"):
            run_all(store)
        assert keys(store) == []


def test_a_real_graph_that_is_missing_fails_alone(monkeypatch):
    def gone(name, **options):
        raise OSError("gone")

    monkeypatch.setattr("masat.datasets.load", gone)
    failed = run_case(Case("MIT", (), 0), ("odometry", "masat"), 50)
    assert [t.error for t in failed] == ["OSError: gone"] * 2


# The store


def test_a_run_is_kept_once(tmp_path):
    with Store(tmp_path, SMALL) as store:
        store.add([trial([3, 2, 2])])
        store.add([trial([9, 9, 9])])
        assert [t.chi2 for t in store.trials()] == [(3, 2, 2)]


def test_a_store_of_another_design_or_of_none_is_refused(tmp_path):
    with pytest.raises(StudyError, match="holds no study"):
        Store(tmp_path)
    with Store(tmp_path, SMALL):
        pass
    with pytest.raises(StudyError, match="another design"):
        Store(tmp_path, load_design("quick"))
    with Store(tmp_path) as store:
        assert store.design == SMALL
    (tmp_path / "bad").mkdir()
    (tmp_path / "bad" / "study.sqlite").write_text("this is no database, but long enough " * 100)
    with pytest.raises(StudyError, match="not a readable store"):
        Store(tmp_path / "bad")


def test_a_full_disk_loses_nothing_that_was_kept(tmp_path):
    with Store(tmp_path, SMALL) as store:
        store.add([trial([3, 2, 2])])
        pages = store._db.execute("PRAGMA page_count").fetchone()[0]
        store._db.execute(f"PRAGMA max_page_count = {pages}")
        many = [trial([1.0] * 50, Case(WORLD, (0.1, 0.1, 0.1), k)) for k in range(1, 500)]
        with pytest.raises(StudyError, match="what it holds is safe"):
            store.add(many)
        assert [t.chi2 for t in store.trials()] == [(3, 2, 2)]
    with Store(tmp_path) as store:
        assert len(list(store.trials())) == 1


def test_a_killed_process_leaves_the_store_readable(tmp_path):
    script = f"""
import sys
from concurrent.futures import ThreadPoolExecutor
from masat.study import Design, Store, run_study
design = Design(worlds=({WORLD!r},), sigmas=((0.2, 0.2, 0.2),), instances=4000, starts=("masat",))
with Store(__import__("pathlib").Path({str(tmp_path)!r}), design) as store:
    with ThreadPoolExecutor(2) as executor:
        run_study(store, executor, progress=lambda n: print(n, flush=True))
"""
    process = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE)
    for _ in range(20):
        process.stdout.readline()
    process.kill()
    process.wait()
    process.stdout.close()
    with Store(tmp_path) as store:
        kept = list(store.trials())
        assert 19 <= len(kept) < 4000
        assert all(t.chi2 and not t.error for t in kept)
    check = sqlite3.connect(tmp_path / "study.sqlite")
    assert check.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    check.close()


@pytest.mark.filterwarnings("ignore")
def test_a_cluster_that_loses_a_worker_loses_and_doubles_nothing(tmp_path):
    distributed = pytest.importorskip("distributed")
    design = Design(
        worlds=(WORLD,), sigmas=((0.2, 0.2, 0.2),), instances=60, starts=("odometry", "masat")
    )
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
        ) as cluster,
        distributed.Client(cluster) as client,
        Store(tmp_path, design) as store,
    ):
        victim = next(iter(client.run(__import__("os").getpid).values()))
        came_in = []

        def kill_one(runs):
            came_in.append(runs)
            if len(came_in) == 6:
                __import__("os").kill(victim, 9)

        with ThreadPoolExecutor(4) as executor:
            run_study(store, executor, progress=kill_one, run=on_cluster(client))
        assert keys(store) == wanted(design)
        assert sum(came_in) == len(wanted(design))
        for kept in list(store.trials())[::17]:
            assert run_case(kept.case, (kept.start,), 50)[0].chi2 == kept.chi2


def test_threads_share_the_machine():
    # The core releases the interpreter's lock: another thread runs while it works.
    case = Case("manhattan:3000:4600", (0.1, 0.1, 0.1), 0)
    run_case(case, ("masat",), 1)
    ticks, stop = [], threading.Event()

    def tick():
        while not stop.is_set():
            ticks.append(time.perf_counter())
            time.sleep(0.0005)

    thread = threading.Thread(target=tick)
    thread.start()
    run_case(case, ("odometry",), 50)
    stop.set()
    thread.join()
    assert len(ticks) > 10


# Statistics


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("study")
    with Store(folder, SMALL) as store:
        run_all(store)
    return folder


def test_the_report_holds_tables_figures_and_one_page(finished, tmp_path):
    from masat.study.report import build_report

    with Store(finished) as store:
        build_report(store, tmp_path)
    text = (tmp_path / "report.md").read_text()
    assert "18 of 18 runs" in text
    assert "| manhattan:150:230 | (.1,.1,.1) |" in text
    page = (tmp_path / "report.html").read_text()
    assert page.count("data:image/png;base64,") == 2
    assert "http" not in page
    rates = (tmp_path / "table1_relative.csv").read_text().splitlines()
    assert len(rates) == 3
    assert rates[0].startswith("world,noise,spanning_tree,paper,masat,paper,ground_truth")


def test_a_study_of_the_papers_cells_may_do_without_masat(tmp_path):
    from masat.study.report import build_report

    case = Case("City10k", (0.35, 0.35, 0.35), 0)
    design = Design(worlds=("City10k",), sigmas=(case.sigma,), instances=1, starts=("chordal",))
    with Store(tmp_path / "store", design) as store:
        store.add([trial([5.0, 4.0, 4.0], case, "chordal")])
        build_report(store, tmp_path / "report")
    rates = (tmp_path / "report" / "table1_relative.csv").read_text().splitlines()
    assert rates[0] == "world,noise,chordal"
    assert not (tmp_path / "report" / "agreement.csv").exists()


def test_cells_outside_the_papers_interval_are_named():
    from masat.study.report.cells import cells_of
    from masat.study.report.tables import outside, success_table

    def fifty(successes):
        sigma = (0.35, 0.35, 0.35)
        good, bad = [5.0, 4.0, 4.0], [4.0, 5.0, 6.0]
        return cells_of(
            [trial(good if k < successes else bad, Case("City10k", sigma, k)) for k in range(50)]
        )

    # The paper has .18.
    assert outside(fifty(9), "masat") == []
    (named,) = outside(fifty(30), "masat")
    assert named.startswith("City10k (.35,.35,.35): 0.60 in [0.46, 0.72], paper 0.18")
    (row,) = success_table(fifty(30), ("masat",), relative=True).rows
    assert row[-1] == "0.18 *"


def call(*arguments):
    command = [sys.executable, "-m", "masat", "study", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True)


def test_a_study_from_the_command_line(tmp_path):
    design = tmp_path / "design.toml"
    design.write_text(GOOD)
    store, report = tmp_path / "store", tmp_path / "report"
    told = call("run", design, "--store", store, "--workers", 2)
    assert told.returncode == 0, told.stderr
    assert "4 of 4 runs done" in told.stdout
    assert json.loads(call("status", store, "--json").stdout)["done"] == 4
    assert call("report", store, "-o", report).returncode == 0
    assert (report / "report.html").exists()
    name = "manhattan:100:150/.1,.1,.1/1/masat"
    said = json.loads(call("run", design, "--only", name).stdout)
    with Store(store) as kept:
        (same,) = [t for t in kept.trials() if f"{t.case.name}/{t.start}" == name]
    assert tuple(said["chi2"]) == same.chi2


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["run", "grand", "--store", "s"], "no such design"),
        (["run", "quick"], "--store"),
        (["run", "quick", "--only", "nonsense"], "names no run"),
        (["run", "quick", "--only", "manhattan:100:150/.1,.1,.1/0/magic"], "unknown start"),
        (["status", "nowhere"], "holds no study"),
        (["report", "nowhere", "-o", "r"], "holds no study"),
    ],
)
def test_bad_usage_is_code_2_and_one_line(arguments, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    told = call(*arguments)
    assert told.returncode == 2
    assert said in told.stderr
    assert "Traceback" not in told.stderr
