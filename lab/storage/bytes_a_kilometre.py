"""Bytes a kilometre of travel, by sensor: scans, and the stored forms of each submap."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from revisit.core.config import PipelineConfig, SubmapConfig
from revisit.core.model_bundle import load_packaged_models
from revisit.core.pipeline import describe
from revisit.core.scan import Scan
from revisit.core.submap import Submap, SubmapBuilder
from revisit.evaluation.perturbations import Perturbation
from revisit.evaluation.real_data import has_real_data, real_recording
from revisit.evaluation.simulator import (
    HDL64,
    LidarModel,
    StreetGrid,
    Trajectory,
    build_city,
    drive,
    grid_drive,
    simulate,
)  # fmt: skip
from revisit.evaluation.simulator.sensors import HDL32, VLP16
from revisit.evaluation.surfaces.scenes import TOWN_SEED
from revisit.formats import quantised

SCANS = 26
"""Scans of each drive, a metre apart where it is simulated."""
_THIN = Perturbation(keep_points=0.06)
_THIN_16 = Perturbation(keep_beams=16, keep_points=0.06)
_LONG = SubmapConfig(tau=20.0)  # as in the documents on thin scans


@dataclass(frozen=True)
class StoredBytes:
    """Means over one drive: returns of a scan; bytes of a scan as the SDK sends it and the service stores it, and of
    the neural map, the place and the descriptor of a submap; metres between two submaps.
    """

    sensor: str
    returns: float
    scan: float
    neural_map: float
    place: float
    descriptor: float
    stride_m: float

    def megabytes_a_km(self, scans_a_metre: float) -> tuple[float, float]:
        """Megabytes a kilometre of scans, and of all that is kept of submaps."""
        submap = self.neural_map + self.place + self.descriptor
        return 1e-3 * self.scan * scans_a_metre, 1e-3 * submap / self.stride_m


def drives(folder: Path) -> Iterator[tuple[str, list[Scan], SubmapConfig]]:
    """Name, scans and windows of each drive: simulated sensors, and a real one where REVISIT_DATA is set."""
    simulated = ((HDL64, "64"), (HDL32, "32"), (VLP16, "16"))
    for sensor, beams in simulated:
        yield f"{beams} beams (simulated)", simulated_scans(sensor), SubmapConfig()
    yield "16 beams, thin (simulated)", thinned(simulated_scans(VLP16), _THIN), _LONG
    if not has_real_data():
        return
    street = real_recording("kitti00_head", folder)
    real = [street.scan(index) for index in range(SCANS)]
    yield "64 beams (real, HDL-64)", real, SubmapConfig()
    yield "16 of its beams", thinned(real, Perturbation(keep_beams=16)), SubmapConfig()
    yield "16 of its beams, thin", thinned(real, _THIN_16), _LONG


def simulated_scans(sensor: LidarModel) -> list[Scan]:
    """Scans a metre apart along a street."""
    grid = StreetGrid.random(3, 3, TOWN_SEED)
    world = build_city(grid.streets(), TOWN_SEED)
    whole = drive(grid_drive(grid, [(0, 0), (1, 0)]), world.ground, lane_m=1.8, spacing_m=1.0)
    part = slice(20, 20 + SCANS)
    seen = simulate(world, Trajectory(whole.T_world_sensor[part], whole.stamps_ns[part]), sensor, TOWN_SEED)
    return [Scan.validated(scan.points, scan.T_world_sensor, scan.stamp_ns) for scan in seen]


def thinned(scans: Iterable[Scan], perturbation: Perturbation) -> list[Scan]:
    """The scans with fewer returns."""
    return [
        Scan.validated(perturbation.thin(scan.points, index), scan.T_odom_sensor, scan.stamp_ns)
        for index, scan in enumerate(scans)
    ]


def stored_bytes(sensor: str, scans: Sequence[Scan], config: SubmapConfig) -> StoredBytes:
    """Describe the submaps of a drive and weigh their stored forms."""
    models, builder = load_packaged_models(), SubmapBuilder(config)
    windows = [window for scan in scans if (window := builder.add(scan)) is not None]
    sizes = []
    for window in windows:
        described = describe(Submap.from_scans(window, config), models, PipelineConfig())
        vector = described.descriptor.vector.astype("<f4")
        sizes.append((len(described.neural_map.to_blob()), len(described.place.to_blob()), vector.nbytes))
    neural_map, place, descriptor = (float(mean) for mean in np.mean(sizes, axis=0))
    sent = float(np.mean([len(quantised.encode(scan.points)) for scan in scans]))
    returns = float(np.mean([len(scan.points) for scan in scans]))
    return StoredBytes(sensor, returns, sent, neural_map, place, descriptor, config.stride)


def storage_table(rows: Iterable[StoredBytes]) -> str:
    """The rows as a table in Markdown; a kilometre is of a scan a metre, or ten scans a second at 1.5 m/s."""
    head = (
        "| sensor | returns a scan | scan | neural map | place | descriptor | scans a km, at 1 / 6.7 a metre "
        "| submaps a km |\n|---|---|---|---|---|---|---|---|\n"
    )
    return head + "".join(_line(row) for row in rows)


def _line(row: StoredBytes) -> str:
    (slow, submaps), (fast, _) = row.megabytes_a_km(1.0), row.megabytes_a_km(10.0 / 1.5)
    sizes = " | ".join(f"{size / 1e3:.1f} kB" for size in (row.scan, row.neural_map, row.place, row.descriptor))
    return f"| {row.sensor} | {row.returns:,.0f} | {sizes} | {slow:.0f} / {fast:.0f} MB | {submaps:.1f} MB |\n"
