"""The store of a study: one SQLite file that no crash leaves damaged."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from masat.study.cases import AnyTrial
from masat.study.design import Design
from masat.study.design_keys import check_design
from masat.study.names import Case, StudyError
from masat.study.tables import CLOSURE_TRIALS, INIT_TRIALS, TrialTable
from masat.study.toml_lines import TomlText

_FILE = "study.sqlite"

# Raised whenever the tables change.
_VERSION = 2

_NEW = f"""
BEGIN;
CREATE TABLE design (text TEXT NOT NULL);
PRAGMA user_version = {_VERSION};
COMMIT;
"""


class Store:
    """Trials in `DIR/study.sqlite`, each stored once; every `add` is a transaction.

    Parameters
    ----------
    folder : Path
        Made if it does not exist.
    design : Design, optional
        The design of the study. Default: the one that the folder holds.

    Attributes
    ----------
    path : Path
        The SQLite file.
    design : Design
        The design of the study.

    Raises
    ------
    StudyError
        If the folder holds no study, one of another design, one that another version of masat
        has written, or a damaged file.
    """

    def __init__(self, folder: Path, design: Design | None = None) -> None:
        self.path = folder / _FILE
        if design is None and not self.path.is_file():
            raise StudyError(f"{folder}: holds no study; begin one with `masat study run`")
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StudyError(f"{folder}: cannot be made: {error.strerror or error}") from None
        with self._readable():
            self._db = sqlite3.connect(self.path, isolation_level=None)
        try:
            with self._readable():
                self._check_version()
                self.design = self._stored_design(design)
                self._table: TrialTable = CLOSURE_TRIALS if self.design.methods else INIT_TRIALS
                self._db.execute(self._table.sql())
        except BaseException:
            self._db.close()
            raise

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *_: object) -> None:
        self._db.close()

    def add(self, trials: Iterable[AnyTrial]) -> None:
        """Store trials, all or none; a run that is stored already is not changed."""
        rows = [self._table.row(trial) for trial in trials]
        marks = ", ".join("?" * len(self._table.columns))
        try:
            with closing(self._db.cursor()) as cursor:
                cursor.execute("BEGIN IMMEDIATE")
                try:
                    cursor.executemany(
                        f"INSERT OR IGNORE INTO {self._table.name} VALUES ({marks})", rows
                    )
                except BaseException:
                    cursor.execute("ROLLBACK")
                    raise
                cursor.execute("COMMIT")
        except sqlite3.Error as error:
            raise StudyError(
                f"{self.path}: cannot be written ({error}); what it holds is safe: run the same "
                "command again to continue"
            ) from None

    def forget_failed(self) -> int:
        """Delete the failed trials, so that they run again; return their number."""
        with self._readable():
            return self._db.execute(f"DELETE FROM {self._table.name} WHERE error != ''").rowcount

    def done(self) -> set[tuple[Case, str]]:
        """Return the runs that are stored, failed ones included."""
        with self._readable():
            key = ", ".join(self._table.key)
            rows = self._db.execute(f"SELECT {key} FROM {self._table.name}").fetchall()
            return {self._table.named(row) for row in rows}

    def trials(self) -> Iterator[AnyTrial]:
        """Iterate over the trials in the order of their names."""
        with self._readable():
            for row in self._db.execute(f"SELECT * FROM {self._table.name}"):
                yield self._table.trial(row)

    @contextmanager
    def _readable(self) -> Iterator[None]:
        """Turn errors about the content of the file into a StudyError that names it."""
        try:
            yield
        except (sqlite3.Error, ValueError, TypeError, OverflowError, RecursionError) as error:
            if isinstance(error, StudyError):
                raise
            if "locked" in str(error):
                raise StudyError(
                    f"{self.path}: another process is writing to it; wait until that has ended"
                ) from None
            raise StudyError(
                f"{self.path}: not a readable store of a study ({error}); choose another folder, "
                "or delete this one and run the study again"
            ) from None

    def _check_version(self) -> None:
        """Make the table of the design in a new file, and refuse tables of another version."""
        (version,) = self._db.execute("PRAGMA user_version").fetchone()
        if version == _VERSION:
            return
        (tables,) = self._db.execute("SELECT count(*) FROM sqlite_master").fetchone()
        if version or tables:
            raise StudyError(
                f"{self.path}: was written by another version of masat or another program; choose "
                "another folder, or delete this one and run the study again"
            )
        self._db.executescript(_NEW)

    def _stored_design(self, wanted: Design | None) -> Design:
        """Return the design of the file; a new file gets the one that is wanted."""
        source = TomlText(str(self.path), "")
        if wanted is not None:
            check_design(wanted.to_table(), TomlText("design", ""))
        row = self._db.execute("SELECT text FROM design").fetchone()
        if row is None:
            if wanted is None:
                raise StudyError(f"{self.path}: holds no design; begin one with `masat study run`")
            self._db.execute("INSERT INTO design VALUES (?)", (json.dumps(wanted.to_table()),))
            return wanted
        table: Any = json.loads(row[0])
        if not isinstance(table, dict):
            raise StudyError(f"{self.path}: holds no design")
        stored = check_design(table, source)
        if wanted is None or wanted == stored:
            return stored
        if wanted != replace(stored, title=wanted.title):
            raise StudyError(
                f"{self.path}: belongs to a study of another design; choose another folder"
            )
        self._db.execute("UPDATE design SET text = ?", (json.dumps(wanted.to_table()),))
        return wanted
