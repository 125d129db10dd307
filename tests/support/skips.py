"""Skips in continuous integration: a skipped test proves nothing, so it fails there unless its reason is known."""

from __future__ import annotations

import os
from typing import TypeVar

import pytest

Report = TypeVar("Report", pytest.TestReport, pytest.CollectReport)

IN_CI = os.environ.get("CI") == "true"
"""Whether this run decides on a change; `.ci/run` says so."""

ALLOWED = (
    "REVISIT_DATA names no folder of real data",  # recordings are no part of the repository
    "map_closures is not installed",  # a baseline; its pins contradict this project's
    "no second host can be made here",  # root and namespaces, which a container may not have
    "of SQLite: ",  # in a run whose state is in PostgreSQL: the subject is SQLite's file
)
"""Beginnings of the reasons for which a test may be skipped even there."""


def judged(report: Report, in_ci: bool = IN_CI) -> Report:
    """The report of a test or a file, failed where it was skipped in continuous integration for another reason."""
    if not (in_ci and report.skipped) or hasattr(report, "wasxfail"):
        return report
    reason = _reason(report)
    if not reason.startswith(ALLOWED):
        report.outcome = "failed"
        report.longrepr = (
            f"skipped in continuous integration, which tests every promise: {reason}\n"
            "Let scripts/test_tools.sh install what is missing, or name the reason in tests/support/skips.py."
        )
    return report


def _reason(report: pytest.TestReport | pytest.CollectReport) -> str:
    said = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
    return said.removeprefix("Skipped: ")
