"""What a fleet takes: cores, memory, disk, rows and network, from measured constants, and where each choice ends.

`sizing.json` has each constant with its unit, command, date and machine. Scans of other beams than 16, 32 and 64 are in
proportion to the nearest of them.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

from revisit.core.config import PipelineConfig
from revisit.core.scan_marks import ScanMarks
from revisit.service.domain.retention import KeptScans, RetentionPolicy

MEASURED_BEAMS = (16, 32, 64)

INSTALLATIONS = "several installations, a site in each"
SEARCHES = "searches/s, maps of 100,000 places"


@dataclass(frozen=True)
class Fleet:
    """A fleet at work: `robots` drive at `speed_m_s` for `hours_a_day`, each sending `hz` scans of `beams` a second.

    The store is looked at after `days`, kept by `retention`.
    """

    robots: int
    beams: int = 64
    hz: float = 10.0
    speed_m_s: float = 1.0
    hours_a_day: float = 24.0
    days: float = 30.0
    retention: RetentionPolicy = RetentionPolicy()


@dataclass(frozen=True)
class Need:
    """What a fleet takes. Rates are those while it drives; `disk_bytes` is what lies there after the days, by part."""

    submaps_s: float
    scans_s: float
    worker_cores: float
    gateway_cores: float
    memory_mib: float
    row_writes_s: float
    network_mbit_s: float
    disk_bytes_a_day: float
    disk_bytes: dict[str, float]


@dataclass(frozen=True)
class Limit:
    """Where a choice ends: `load` of `most` in a unit, and what is added then."""

    choice: str
    load: float
    most: float
    unit: str
    then: str

    @property
    def holds(self) -> bool:
        """Whether the fleet stays below it."""
        return self.load <= self.most


@cache
def constants() -> dict[str, dict[str, Any]]:
    """The measured constants, each with value, unit, command, date and machine."""
    found: dict[str, dict[str, Any]] = json.loads((files("revisit.cli") / "sizing.json").read_text())
    return found


def value(name: str) -> float:
    """A constant."""
    return float(constants()[name]["value"])


def of_beams(name: str, beams: int) -> float:
    """A constant of scans with so many beams."""
    nearest = min(MEASURED_BEAMS, key=lambda known: abs(known - beams))
    return value(f"{name}_{nearest}") * beams / nearest


def need_of(fleet: Fleet) -> Need:
    """What a fleet takes."""
    stride_m = PipelineConfig().submap.stride
    submaps_s, scans_s = fleet.robots * fleet.speed_m_s / stride_m, fleet.robots * fleet.hz
    gateway_ms = value("gateway_cpu_ms_a_scan")
    gateway_ms += value("gateway_cpu_ms_a_100k_returns") * of_beams("returns", fleet.beams) / 1e5
    workers, gateways = submaps_s * value("worker_cpu_s_a_submap"), scans_s * gateway_ms / 1e3
    disk = dict(_disk(fleet, submaps_s, scans_s))
    a_day = sum(dict(_disk_of_days(fleet, submaps_s, scans_s, 1.0)).values())
    return Need(
        submaps_s=submaps_s,
        scans_s=scans_s,
        worker_cores=workers,
        gateway_cores=gateways,
        memory_mib=_memory_mib(fleet, submaps_s, workers),
        row_writes_s=_row_writes_s(submaps_s, scans_s),
        network_mbit_s=8e-6 * scans_s * of_beams("scan_bytes", fleet.beams),
        disk_bytes_a_day=a_day,
        disk_bytes=disk,
    )


def _row_writes_s(submaps_s: float, scans_s: float) -> float:
    a_submap = value("row_writes_a_submap") + value("pairs_a_submap") * value("row_writes_a_pair")
    return scans_s * value("row_writes_a_scan") + submaps_s * a_submap


def _memory_mib(fleet: Fleet, submaps_s: float, workers: float) -> float:
    submaps = submaps_s * 3600 * fleet.hours_a_day * _days(fleet.days, fleet.retention.session_days)
    index = submaps * value("index_bytes_a_submap") / 2**20
    return value("gateway_mib") + max(1.0, workers) * value("worker_mib") + index


def _disk(fleet: Fleet, submaps_s: float, scans_s: float) -> Iterator[tuple[str, float]]:
    """Bytes on the disk after the days, by part, as the policy leaves them."""
    kept, policy = dict(_disk_of_days(fleet, submaps_s, scans_s, fleet.days)), fleet.retention
    share = kept_share(fleet)
    waiting_days = fleet.days if share == 1.0 else min(fleet.days, _waiting_days(fleet))
    for part in ("scans", "rows of scans"):
        settled = share * (fleet.days - waiting_days)
        yield part, kept[part] * (waiting_days + settled) / fleet.days
    yield "pairs", kept["pairs"] * _days(fleet.days, policy.rejected_days) / fleet.days
    for part in ("neural maps", "places", "rows of submaps"):
        # An aged session that the map rests on keeps its neural maps; then this is a lower bound.
        yield part, kept[part] * _days(fleet.days, policy.session_days) / fleet.days


def _waiting_days(fleet: Fleet) -> float:
    """So many driven days of scans wait to be removed: hours pass by day and night."""
    hours = fleet.retention.scans_after_hours
    return min(hours / 24.0, fleet.days) if hours >= 24.0 else min(hours / fleet.hours_a_day, 1.0)


def _days(days: float, kept: float | None) -> float:
    return days if kept is None else min(days, kept)


def kept_share(fleet: Fleet) -> float:
    """The share of the scans that stay once the policy has done its work."""
    policy = fleet.retention
    if policy.keep_scans is KeptScans.ALL:
        return 1.0
    if policy.keep_scans is KeptScans.NONE:
        return 0.0
    return min(1.0, described_hz(fleet.beams, fleet.speed_m_s) / fleet.hz)


def described_hz(beams: int, speed_m_s: float) -> float:
    """Scans a second that descriptions are made of, which is what the SDK sends."""
    marks = ScanMarks.of(PipelineConfig().submap)
    return speed_m_s / marks.spacing_m(round(of_beams("returns", beams)))


def _disk_of_days(fleet: Fleet, submaps_s: float, scans_s: float, days: float) -> Iterator[tuple[str, float]]:
    """Bytes on the disk of so many days by part, nothing removed."""
    seconds = 3600.0 * fleet.hours_a_day * days
    scans, submaps = scans_s * seconds, submaps_s * seconds
    yield "scans", scans * of_beams("scan_bytes", fleet.beams) * value("disk_a_coded_byte")
    yield "rows of scans", scans * value("scan_row_bytes")
    yield "neural maps", submaps * value("neural_map_disk_bytes")
    yield "places", submaps * value("place_disk_bytes")
    yield "rows of submaps", submaps * value("submap_row_bytes")
    yield "pairs", submaps * value("pairs_a_submap") * value("pair_row_bytes")


def limits_of(need: Need, cores: int, disk_tb: float) -> list[Limit]:
    """Where each choice ends for a fleet, on machines of so many cores and terabytes."""
    disk, used = 1e-12 * sum(need.disk_bytes.values()), need.worker_cores + need.gateway_cores
    return [
        Limit("one machine", used, cores, "cores", "workers on further machines: PostgreSQL and S3"),
        Limit("one gateway", need.gateway_cores, 1.0, "cores", "fewer scans a metre; several gateways on PostgreSQL"),
        Limit("SQLite", need.scans_s, value("acknowledgements_s_sqlite"), "acknowledgements/s", "PostgreSQL"),
        Limit("one disk", disk, disk_tb, "TB", "a policy of retention; blobs in S3"),
        Limit("one PostgreSQL, rows", need.row_writes_s, value("row_writes_s_postgres"), "row writes/s", INSTALLATIONS),
        Limit("one PostgreSQL, commits", databases_of(need), 1.0, "databases", INSTALLATIONS),
        Limit("searches in the workers", need.submaps_s, value("searches_s_a_core"), SEARCHES, "search processes"),
    ]


def databases_of(need: Need) -> float:
    """How many PostgreSQL databases the commits of acknowledgements and of jobs keep busy."""
    return need.scans_s / value("acknowledgements_s_postgres") + need.submaps_s / value("jobs_s_postgres")
