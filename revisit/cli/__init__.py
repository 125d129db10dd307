"""The `revisit` command. Modules are imported when their command runs, so that `revisit --help` is quick."""

from __future__ import annotations


def main() -> None:
    """Run the command line."""
    from revisit.cli.app import run

    run()
