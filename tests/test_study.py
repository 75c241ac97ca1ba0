import math
import threading
import time
import warnings
from concurrent.futures import ThreadPoolExecutor

import pytest
from studies import SMALL, WORLD, keys, run_all, trial, wanted

import masat
from masat.study import Case, Design, Store, StudyError, run_case, run_study
from masat.study import runner as runner_module
from masat.study.cluster import on_cluster
from masat.study.design import INITS
from masat.study.trial import initial_guess, instance
from masat.study.worlds import GROUND_TRUTH
from masat.worlds import add_fixes, add_landmarks, manhattan, perturb

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
def test_a_real_graph_has_converged_where_chi2_changes_by_rounding_only(chi2, iteration):
    assert trial(chi2).convergence() == iteration


# Running


def test_a_study_runs_once_and_any_run_can_be_repeated(tmp_path):
    with Store(tmp_path, SMALL) as store:
        counted = []
        run_all(store, progress=counted.append)
        assert keys(store) == wanted(SMALL)
        assert sum(counted) == len(wanted(SMALL))
        for kept in store.trials():
            (again,) = run_case(kept.case, (kept.init,), 50)
            assert again.chi2 == kept.chi2
            assert kept.init_seconds > 0


def test_the_truth_converges_to_what_its_noise_allows(tmp_path):
    with Store(tmp_path, SMALL) as store:
        run_all(store)
        for kept in store.trials():
            if kept.init == "ground_truth":
                reduced = kept.chi2[kept.success()] / kept.degrees_of_freedom
                assert abs(reduced - 1) < 5 * math.sqrt(2 / kept.degrees_of_freedom)


def test_a_stopped_study_goes_on_where_it_was(tmp_path):
    started = []

    def count(case, inits, limit):
        started.append(case)
        if len(started) == 4:
            raise KeyboardInterrupt
        return run_case(case, inits, limit)

    with Store(tmp_path, SMALL) as store, ThreadPoolExecutor(1) as executor:
        with pytest.raises(KeyboardInterrupt):
            run_study(store, executor, run=count)
        kept = {t.case for t in store.trials()}
    assert 0 < len(kept) < 6
    again = []

    def note(case, inits, limit):
        again.append(case)
        return run_case(case, inits, limit)

    with Store(tmp_path, SMALL) as store:
        run_all(store, run=note)
        assert not kept & set(again)
        assert keys(store) == wanted(SMALL)


def test_one_failing_run_is_recorded_and_stops_nothing(tmp_path, monkeypatch):
    from masat.study import trial as trial_module

    honest = trial_module.initial_guess

    def fails(graph, init):
        if init == "masat":
            raise RuntimeError("no luck")
        return honest(graph, init)

    monkeypatch.setattr(trial_module, "initial_guess", fails)
    with Store(tmp_path, SMALL) as store:
        run_all(store)
        failed = [t for t in store.trials() if t.error]
        assert {t.init for t in failed} == {"masat"}
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

    monkeypatch.setattr("masat.datasets.fetch", gone)
    failed = run_case(Case("MIT", (), 0), ("odometry", "masat"), 50)
    assert [t.error for t in failed] == ["OSError: gone"] * 2


@pytest.mark.filterwarnings("ignore")
def test_a_cluster_that_loses_a_worker_loses_and_doubles_nothing(tmp_path):
    distributed = pytest.importorskip("distributed")
    design = Design(
        worlds=(WORLD,), sigmas=((0.2, 0.2, 0.2),), instances=60, inits=("odometry", "masat")
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
            assert run_case(kept.case, (kept.init,), 50)[0].chi2 == kept.chi2


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


def test_a_study_neither_warns_nor_touches_the_filters_of_warnings(tmp_path, monkeypatch):
    # Filters belong to the process: pool threads that change them change each other's.
    unit = "1 0 0 1 0 1"
    file = tmp_path / "graph.g2o"
    file.write_text(
        f"UNKNOWN 1\nEDGE_SE2 0 1 1 0 0 {unit}\nEDGE_SE2 2 3 1 0 0 {unit}\n"
        f"EDGE_SE2 0 3 1 0 0 {unit}\nEDGE_SE2 1 3 0 1 0 {unit}\n"
    )
    monkeypatch.setattr("masat.datasets.fetch", lambda name: file)

    def forbidden(*arguments, **options):
        raise AssertionError("a study must not warn, or change who warns")

    design = Design((), (), 1, INITS, graphs=("MIT",))
    case = Case("MIT", (), 0)
    # Pytest itself uses the filters after the test.
    with monkeypatch.context() as patched:
        for name in ("warn", "catch_warnings", "simplefilter", "filterwarnings"):
            patched.setattr(warnings, name, forbidden)
        graph = instance(case)
        guess = initial_guess(graph, "odometry")
        trials = run_case(case, design.columns_of(case), 5)
    assert graph.notes
    assert set(guess.notes) > set(graph.notes)
    assert [t.error for t in trials] == [""] * (len(INITS) - 1)


def with_fixes_and_landmarks(folder):
    """Write a graph with fixes in a frame of their own and with landmarks; return it and its file.

    Its poses are the truth.
    """
    world = perturb(manhattan(150, 250, seed=1), (0.02, 0.02, 0.01), seed=1)
    world, _ = add_fixes(world, 0.2, 0.5, frame=(500, -200, 2.0), seed=1)
    world = add_landmarks(world, 10, seed=1)
    masat.write(world, folder / "fixes.g2o")
    return world, str(folder / "fixes.g2o")


def test_fixes_and_landmarks_count_from_each_initial_guess(tmp_path):
    world, path = with_fixes_and_landmarks(tmp_path)
    best = masat.solve(world)
    for one in run_case(Case(path, (), 0), ("odometry", "masat", "auto", GROUND_TRUTH), 50):
        assert one.error == ""
        assert one.chi2[-1] == pytest.approx(best.chi2, rel=1e-6)
        assert one.degrees_of_freedom == best.degrees_of_freedom


def test_false_closures_are_studied_beside_fixes_and_landmarks(tmp_path):
    _, path = with_fixes_and_landmarks(tmp_path)
    case = Case(path, (), 0, "random", 0.3)
    trials = run_case(case, ("robust", "geman_mcclure_refit"), 50)
    for one in trials:
        assert one.error == ""
        assert one.scores.false_kept == 0
        assert one.scores.cost_ratio == pytest.approx(1, abs=0.05)
        assert one.scores.rmse < 0.1
