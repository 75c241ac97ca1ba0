"""The report of a study: tables, tests, figures, as Markdown, HTML, CSV and LaTeX."""

from __future__ import annotations

from masat.study.report.build import Report, build_report

__all__ = ["Report", "build_report"]
