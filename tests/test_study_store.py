import sqlite3
import subprocess
import sys
from dataclasses import replace

import pytest
from studies import SMALL, WORLD, trial

from masat.study import Case, Store, StudyError, load_design


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
design = Design(worlds=({WORLD!r},), sigmas=((0.2, 0.2, 0.2),), instances=4000, inits=("masat",))
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


def damage(folder, *statements):
    db = sqlite3.connect(folder / "study.sqlite")
    for statement in statements:
        db.execute(statement)
    db.commit()
    db.close()


@pytest.mark.parametrize(
    ("statement", "said"),
    [
        ("UPDATE design SET text = '{not json'", "not a readable store"),
        ("UPDATE design SET text = '[1, 2]'", "holds no design"),
        ("UPDATE design SET text = '{}'", "worlds is missing or empty"),
        ("DELETE FROM design", "holds no design"),
        ("DROP TABLE design", "not a readable store"),
        ("UPDATE trial SET chi2 = '[1, 2'", "not a readable store"),
        ("UPDATE trial SET chi2 = '7'", "not a readable store"),
        ("UPDATE trial SET chi2 = '[null]'", "not a readable store"),
        ("UPDATE trial SET sigma = 'x'", "not a readable store"),
        ("UPDATE trial SET degrees_of_freedom = 'many'", "not a readable store"),
        ("PRAGMA user_version = 7", "another version of masat"),
    ],
)
def test_a_damaged_store_is_refused_in_one_line(statement, said, tmp_path):
    with Store(tmp_path, SMALL) as store:
        store.add([trial([3, 2, 2])])
    damage(tmp_path, statement)
    with pytest.raises(StudyError, match=said) as error, Store(tmp_path) as store:
        list(store.trials())
    assert str(error.value).startswith(f"{tmp_path / 'study.sqlite'}: ")
    assert "\n" not in str(error.value)


def test_a_store_of_an_earlier_version_is_refused_with_what_to_do(tmp_path):
    damage(
        tmp_path,
        "CREATE TABLE design (text TEXT NOT NULL)",
        "CREATE TABLE trial (world TEXT, sigma TEXT, instance INTEGER, start TEXT)",
    )
    with pytest.raises(StudyError, match=r"another version of masat .* run the study again"):
        Store(tmp_path, SMALL)


def test_pages_that_are_overwritten_are_one_clear_error(tmp_path):
    with Store(tmp_path, SMALL) as store:
        store.add([trial([1.0] * 50, Case(WORLD, (0.1, 0.1, 0.1), k)) for k in range(200)])
    path = tmp_path / "study.sqlite"
    data = bytearray(path.read_bytes())
    data[8192:] = b"\xff" * (len(data) - 8192)
    path.write_bytes(data)
    for read in (Store.done, lambda store: list(store.trials())):
        with pytest.raises(StudyError, match="not a readable store"), Store(tmp_path) as store:
            read(store)


def test_a_new_title_goes_into_the_store_and_changes_nothing_else(tmp_path):
    with Store(tmp_path, SMALL) as store:
        store.add([trial([3, 2, 2])])
    with Store(tmp_path, replace(SMALL, title="Walks")) as store:
        assert len(list(store.trials())) == 1
    with Store(tmp_path) as store:
        assert store.design.title == "Walks"


def test_a_design_that_cannot_be_read_again_is_not_stored(tmp_path):
    with pytest.raises(StudyError, match="unknown initial guess 'magic'"):
        Store(tmp_path, replace(SMALL, inits=("magic",)))


def test_a_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StudyError, match="file: cannot be made"):
        Store(tmp_path / "file", SMALL)


def test_a_store_that_another_process_writes_to_says_so(tmp_path, monkeypatch):
    with Store(tmp_path, SMALL):
        pass
    other = sqlite3.connect(tmp_path / "study.sqlite", isolation_level=None)
    other.execute("BEGIN EXCLUSIVE")
    connect = sqlite3.connect
    monkeypatch.setattr(sqlite3, "connect", lambda path, **more: connect(path, timeout=0, **more))
    with pytest.raises(StudyError, match="another process is writing to it"):
        Store(tmp_path)
    other.close()
