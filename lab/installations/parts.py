"""The load of a fleet on each part of an installation, and the number of robots at which one of a part is used up."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Part:
    """A part of an installation. `per_robot` and `capacity` have the same unit; `then` is what is added beyond."""

    name: str
    per_robot: float
    capacity: float
    unit: str
    then: str

    @property
    def robots(self) -> int:
        """How many robots one of it carries."""
        return int(self.capacity / self.per_robot)


def parts(known: dict[str, float]) -> tuple[Part, ...]:
    """The parts under robots that drive at 1 m/s."""
    scans_per_s = known["scans_per_metre"]
    submaps_per_s = 1.0 / known["metres_per_submap"]
    rows_per_s = scans_per_s + known["rows_per_submap"] * submaps_per_s
    database = scans_per_s / known["acknowledgements_per_s"] + submaps_per_s / known["jobs_per_s"]
    return (
        Part(
            "search, map of a million places", submaps_per_s, known["searches_per_s_1000000"], "searches/s", "replica"
        ),
        Part("search, map of 100,000 places", submaps_per_s, known["searches_per_s_100000"], "searches/s", "replica"),
        Part("gateway, a core", scans_per_s * known["gateway_s_per_scan"], 1.0, "CPU s/s", "gateway"),
        Part("worker, a core", submaps_per_s * known["worker_s_per_submap"], 1.0, "CPU s/s", "worker"),
        Part("database, commits", database, 1.0, "databases", "installation"),
        Part("database, rows", rows_per_s, known["rows_per_s"], "rows/s", "installation"),
    )


def bytes_a_day(known: dict[str, float], robots: int) -> tuple[float, float]:
    """Bytes kept for good, and bytes of raw scans, that a day of 24 h adds."""
    metres = 86400.0 * robots
    kept = metres / known["metres_per_submap"] * known["kept_bytes_per_submap"]
    return kept, metres * known["scans_per_metre"] * known["scan_bytes"]
