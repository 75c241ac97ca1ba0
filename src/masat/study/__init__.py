"""Studies of initial guesses and of false loop closures, to run, resume and report."""

from __future__ import annotations

from masat.study.cases import run_case
from masat.study.closure_trial import ClosureTrial
from masat.study.design import Design
from masat.study.design_file import load_design
from masat.study.names import Case, StudyError, parse_run
from masat.study.runner import run_study
from masat.study.store import Store
from masat.study.trial import Trial

__all__ = [
    "Case",
    "ClosureTrial",
    "Design",
    "Store",
    "StudyError",
    "Trial",
    "load_design",
    "parse_run",
    "run_case",
    "run_study",
]
