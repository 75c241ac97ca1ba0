"""The report of a study: tables, tests, figures, as Markdown, HTML and CSV."""

from __future__ import annotations

from masat.study.report.build import build_report

__all__ = ["build_report"]
