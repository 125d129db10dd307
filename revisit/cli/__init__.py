"""The `revisit` command: one module for each command or group of commands, with its options and its work.

A module imports its libraries when the command runs, so that `revisit --help` is quick, and so that commands that
only talk to a service run where the service itself is not installed.
"""

from __future__ import annotations

import sys


def main() -> None:
    """Run the command line; exit status 1 with one line where it is not installed, or Python is too old for it."""
    if sys.version_info < (3, 11):  # noqa: UP036  # the client alone runs with 3.10
        raise SystemExit("revisit: the command needs Python 3.11 or later; with 3.10 the client alone runs")
    try:
        from revisit.cli.app import run
    except ModuleNotFoundError as error:
        from revisit.cli.extras import what_is_missing

        raise SystemExit(what_is_missing("cli", error)) from error
    run()
