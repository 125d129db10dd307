"""`python -m lab.installations`: where each part of an installation ends, and a fleet over several (a model)."""

from __future__ import annotations

from lab.command_line import run
from revisit.cli.output import say


def tables() -> None:
    """Print the tables of docs/explanation/beyond-one-database.md."""
    from lab.installations.tables import affinity_table, fleet_table, parts_table, waits_table

    for table in (parts_table(), waits_table(), fleet_table(), affinity_table()):
        say(table)


if __name__ == "__main__":
    run(tables)
