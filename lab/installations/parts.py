"""The load of a fleet on each part of an installation, and the number of robots at which one of a part is used up."""

from __future__ import annotations

from dataclasses import dataclass

from revisit.cli.sizing import Fleet, databases_of, need_of, value

SCANS_S = 1.0
"""A robot at 1 m/s sends a scan a metre, of 64 beams."""


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


def fleet(robots: int) -> Fleet:
    """Robots at work all day, for one day."""
    return Fleet(robots, hz=SCANS_S, days=1.0)


def parts() -> tuple[Part, ...]:
    """The parts of an installation."""
    need = need_of(fleet(1))
    million, hundred_thousand = value("searches_s_a_core_at_a_million"), value("searches_s_a_core")
    return (
        Part("search, map of a million places", need.submaps_s, million, "searches/s", "replica"),
        Part("search, map of 100,000 places", need.submaps_s, hundred_thousand, "searches/s", "replica"),
        Part("gateway, a core", need.gateway_cores, 1.0, "cores", "gateway"),
        Part("worker, a core", need.worker_cores, 1.0, "cores", "worker"),
        Part("database, commits", databases_of(need), 1.0, "databases", "installation"),
        Part("database, rows", need.row_writes_s, value("row_writes_s_postgres"), "rows/s", "installation"),
    )


def commit_s() -> float:
    """Time of a database that an acknowledgement takes, seconds."""
    return 1.0 / value("acknowledgements_s_postgres")


def job_s() -> float:
    """Time of a database that a job takes, seconds."""
    return 1.0 / value("jobs_s_postgres")


def bytes_a_day(robots: int) -> tuple[float, float]:
    """Bytes of maps, and bytes of raw scans, that a day of 24 h adds."""
    stored = need_of(fleet(robots)).disk_bytes
    scans = stored["scans"] + stored["rows of scans"]
    return sum(stored.values()) - scans, scans
