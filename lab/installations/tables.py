"""The tables of the page on fleets beyond one database."""

from __future__ import annotations

from collections.abc import Iterable

from lab.installations.affinity import COLD_S, Claim, simulated
from lab.installations.directory import as_they_come, by_directory, by_hash, divided, site_sizes
from lab.installations.parts import fleet, parts
from lab.installations.queueing import waits
from revisit.cli.sizing import need_of

FLEET = 10_000
ROBOTS = (400, 600, 800, 850)
BUSY = (0.7, 0.9)
"""Shares of their time in which the workers of an installation work."""

INSTALLATIONS = (12, 14, 16, 20)

WORKERS = 16
"""As many as maps, where it is asked who takes a job."""

LOADS = (0.5, 0.8)
"""Shares of their time in which they would work if they had read all places."""


def parts_table() -> str:
    """The robots that one of each part carries, and how many a fleet needs."""
    rows = (
        (part.name, f"{FLEET * part.per_robot:,.0f} {part.unit}", f"{part.robots:,}", part.then) for part in parts()
    )
    return _table(("part", "load of 10,000 robots", "one carries, robots", "then add a"), rows)


def waits_table() -> str:
    """Times until acknowledgements and loops, by robots of an installation and load of its workers."""
    need = need_of(fleet(1)).worker_cores
    rows = []
    for robots in ROBOTS:
        for busy in BUSY:
            workers = round(robots * need / busy)
            told = waits(robots, workers).row()
            rows.append((str(robots), str(workers), *(f"{1000 * s:,.0f}" for s in told)))
    columns = ("robots", "worker cores", "acknowledged, p50 ms", "p99", "loops known, p50 ms", "p99")
    return _table(columns, rows)


def fleet_table() -> str:
    """The fullest installation by number of installations and way of choosing."""
    ends = min(part.robots for part in parts() if part.then == "installation")
    sizes = divided(site_sizes(FLEET), ends)
    rows = []
    for count in INSTALLATIONS:
        loads = (
            by_hash(sizes, count),
            by_directory(sizes, count, as_they_come(len(sizes))),
            by_directory(sizes, count, range(len(sizes))),
        )
        rows.append((str(count), *(f"{100 * max(load) / ends:.0f} %" for load in loads)))
    columns = ("installations", "fullest database, sites by hash", "by directory as they come", "largest first")
    return _table(columns, rows)


def affinity_table() -> str:
    """Places that a job's worker had not read, and waits, by the rule of claiming and load."""
    rows = []
    for busy in LOADS:
        for claim in Claim:
            cold, mean_s, most_s = simulated(claim, WORKERS, WORKERS, busy).row()
            figures = f"{cold:.1f}", f"{1000 * COLD_S * cold:.0f}", f"{1000 * mean_s:,.0f}", f"{1000 * most_s:,.0f}"
            rows.append((f"{100 * busy:.0f} %", claim, *figures))
    columns = ("busy", "who takes a job", "places read anew, of 10", "CPU ms for them", "waits, mean ms", "p99")
    return _table(columns, rows)


def _table(columns: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    lines = [" | ".join(row) for row in (columns, ("---",) * len(columns), *rows)]
    return "\n".join(f"| {line} |" for line in lines)
