"""The store of a study: one SQLite file, whole after any crash."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import closing
from pathlib import Path

from masat.study.design import Design
from masat.study.names import Case, StudyError
from masat.study.trial import Trial

_FILE = "study.sqlite"
_TABLES = """
CREATE TABLE IF NOT EXISTS design (text TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS trial (
    world TEXT NOT NULL, sigma TEXT NOT NULL, instance INTEGER NOT NULL, start TEXT NOT NULL,
    chi2 TEXT NOT NULL, degrees_of_freedom INTEGER NOT NULL,
    start_seconds REAL NOT NULL, solve_seconds REAL NOT NULL, error TEXT NOT NULL,
    PRIMARY KEY (world, sigma, instance, start)
) WITHOUT ROWID;
"""


class Store:
    """Trials in `DIR/study.sqlite`, each kept once; every `add` is a transaction.

    Parameters
    ----------
    folder : Path
        Made if it does not exist.
    design : Design, optional
        That of the study. Default: the one that the folder holds.
    """

    def __init__(self, folder: Path, design: Design | None = None) -> None:
        self.path = folder / _FILE
        if design is None and not self.path.is_file():
            raise StudyError(f"{folder}: holds no study; begin one with `masat study run`")
        folder.mkdir(parents=True, exist_ok=True)
        try:
            self._db = sqlite3.connect(self.path, isolation_level=None)
            self._db.executescript(_TABLES)
            self.design = self._settle(design)
        except sqlite3.Error as error:
            raise StudyError(f"{self.path}: not a readable store: {error}") from None

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *_: object) -> None:
        self._db.close()

    def add(self, trials: Iterable[Trial]) -> None:
        """Keep trials, all or none; a run that is there already stays as it was."""
        rows = [
            (
                t.case.world,
                json.dumps(t.case.sigma),
                t.case.instance,
                t.start,
                json.dumps(t.chi2),
                t.degrees_of_freedom,
                t.start_seconds,
                t.solve_seconds,
                t.error,
            )
            for t in trials
        ]
        try:
            with closing(self._db.cursor()) as cursor:
                cursor.execute("BEGIN IMMEDIATE")
                try:
                    cursor.executemany(
                        "INSERT OR IGNORE INTO trial VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)", rows
                    )
                except BaseException:
                    cursor.execute("ROLLBACK")
                    raise
                cursor.execute("COMMIT")
        except sqlite3.Error as error:
            raise StudyError(
                f"{self.path}: cannot be written ({error}); what it holds is safe: run the same "
                "command again to go on"
            ) from None

    def forget_failed(self) -> int:
        """Drop the failed trials, so that they run again; return how many."""
        return self._db.execute("DELETE FROM trial WHERE error != ''").rowcount

    def done(self) -> set[tuple[Case, str]]:
        """Return the runs that are there, failed ones included."""
        rows = self._db.execute("SELECT world, sigma, instance, start FROM trial")
        return {(_case(world, sigma, k), start) for world, sigma, k, start in rows}

    def trials(self) -> Iterator[Trial]:
        """Iterate over the trials in the order of their names."""
        for world, sigma, k, start, chi2, *figures in self._db.execute("SELECT * FROM trial"):
            yield Trial(_case(world, sigma, k), start, tuple(json.loads(chi2)), *figures)

    def _settle(self, design: Design | None) -> Design:
        row = self._db.execute("SELECT text FROM design").fetchone()
        if row is None:
            if design is None:
                raise StudyError(f"{self.path}: holds no design")
            self._db.execute("INSERT INTO design VALUES (?)", (design.to_json(),))
            return design
        if design is not None and row[0] != design.to_json():
            raise StudyError(
                f"{self.path}: belongs to a study of another design; choose another folder"
            )
        return Design.from_json(row[0])


def _case(world: str, sigma: str, instance: int) -> Case:
    return Case(world, tuple(json.loads(sigma)), instance)
