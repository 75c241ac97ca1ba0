"""Studies: the MASAT paper's evaluation, or a design of your own, to run, resume and report."""

from __future__ import annotations

from masat.study.design import Design
from masat.study.design_file import load_design
from masat.study.names import Case, StudyError, parse_run
from masat.study.runner import run_study
from masat.study.store import Store
from masat.study.trial import Trial, run_case

__all__ = [
    "Case",
    "Design",
    "Store",
    "StudyError",
    "Trial",
    "load_design",
    "parse_run",
    "run_case",
    "run_study",
]
