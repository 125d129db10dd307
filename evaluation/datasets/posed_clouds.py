"""A recording made of one file a scan, the pose and time of each known beforehand."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import BadField
from revisit.core.geometry import se3
from revisit.core.point_columns import USUAL
from revisit.core.scan import Scan
from revisit.formats import DecodedCloud
from revisit.formats.point_times import timed

Stamps = NDArray[np.int64]
CloudReader = Callable[[Path, Collection[str]], DecodedCloud]
"""Reads a file, and those columns of its points that it has."""

GAP_NS = 1_000_000_000
GAP_PERIODS = 5
"""Poses farther apart than both, this time and so many usual distances, leave a gap..."""

STILL_M, STILL_RAD = 1.0, np.radians(5.0)
"""...where the body has moved by more than one of these: which way it took is not known."""

_WHOLE = re.compile(r"[0-9]+")
_DECIMAL = re.compile(r"[0-9]+(\.[0-9]+)?")
_TIME = re.compile(r"[0-9]{9,}\.[0-9]|[0-9]\.0[0-9]")


@dataclass(frozen=True)
class StampedPoses:
    """Poses of a body by rising time. stamps_ns (n,) int64; T_world_body (n, 4, 4) float64."""

    stamps_ns: Stamps
    T_world_body: NDArray[np.float64]

    def __post_init__(self) -> None:
        if len(self.stamps_ns) != len(self.T_world_body) or len(self.stamps_ns) == 0:
            raise BadField("poses and their times must be as many, and at least one", field="poses")
        if (np.diff(self.stamps_ns) <= 0).any():
            raise BadField("the times of the poses must rise", field="poses")

    def covered(self, stamps_ns: Stamps) -> NDArray[np.bool_]:
        """Which times lie within the first and the last pose, and in no gap in which the body moved."""
        after = np.searchsorted(self.stamps_ns, stamps_ns)
        within = (stamps_ns >= self.stamps_ns[0]) & (stamps_ns <= self.stamps_ns[-1])
        given = self.stamps_ns[np.minimum(after, len(self.stamps_ns) - 1)] == stamps_ns
        return np.asarray(within & (given | ~np.isin(after, self._gaps())))

    def _gaps(self) -> NDArray[np.int64]:
        """The poses before which there is a gap in which the body moved."""
        apart = np.diff(self.stamps_ns)
        if len(apart) == 0:
            return np.zeros(0, dtype=np.int64)
        long = np.flatnonzero(apart > max(GAP_NS, GAP_PERIODS * float(np.median(apart)))) + 1
        moved = [se3.log(se3.inverse(self.T_world_body[after - 1]) @ self.T_world_body[after]) for after in long]
        return np.array([
            after for after, way in zip(long, moved, strict=True)
            if np.linalg.norm(way[:3]) > STILL_M or np.linalg.norm(way[3:]) > STILL_RAD
        ], dtype=np.int64)  # fmt: skip

    def at(self, stamp_ns: int) -> se3.Matrix4:
        """T_world_body at a covered time, between two poses on the screw motion from one to the other."""
        after = int(np.searchsorted(self.stamps_ns, stamp_ns))
        if self.stamps_ns[after] == stamp_ns:
            return np.asarray(self.T_world_body[after])
        first, second = self.T_world_body[after - 1], self.T_world_body[after]
        # Differences of integers: nanoseconds since 1970 exceed a float64.
        elapsed = int(stamp_ns) - int(self.stamps_ns[after - 1])
        share = elapsed / (int(self.stamps_ns[after]) - int(self.stamps_ns[after - 1]))
        return se3.interpolated(first, second, share)


@dataclass(frozen=True)
class PosedClouds:
    """Cloud files, read when asked for.

    T_world_sensor (n, 4, 4), z up; stamps_ns (n,) int64; `read` gives the cloud of a file in the sensor frame;
    `origin` (3,) is where the world's origin lies in the published map frame, metres; `notes` are sentences about how
    the poses were made; `unposed` is the number of files behind these whose poses nobody made; `columns` are those of
    the points that are read.
    """

    name: str
    files: Sequence[Path]
    T_world_sensor: NDArray[np.float64]
    stamps_ns: Stamps
    read: CloudReader
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    notes: Sequence[str] = ()
    unposed: int = 0
    columns: tuple[str, ...] = USUAL

    def __post_init__(self) -> None:
        if not self.files:
            raise FileNotFoundError(f"{self.name}: no scan has a pose")
        if not len(self.files) == len(self.T_world_sensor) == len(self.stamps_ns):
            raise BadField("files, poses and times differ in number", field="poses")

    def __len__(self) -> int:
        return len(self.files)

    def pose(self, index: int) -> se3.Matrix4:
        """T_world_sensor of a scan, z up."""
        return np.asarray(self.T_world_sensor[index])

    def scan(self, index: int) -> Scan:
        """The scan with that index. Raises MalformedBody for a damaged file and as `Scan.validated` does."""
        cloud, stamp_ns = self.read(self.files[index], self.columns), int(self.stamps_ns[index])
        return Scan.validated(cloud.points, self.pose(index), stamp_ns, timed(cloud.columns, stamp_ns))

    def __iter__(self) -> Iterator[Scan]:
        return (self.scan(index) for index in range(len(self)))

    def beside(self, other: PosedClouds) -> PosedClouds:
        """The same recording in the world of `other`, a session of the same map."""
        moved = self.T_world_sensor.copy()
        moved[:, :3, 3] += np.subtract(self.origin, other.origin)
        return dataclasses.replace(self, T_world_sensor=moved, origin=other.origin)


def posed(
    name: str, files: Sequence[Path], T_map_sensor: Sequence[se3.Matrix4], stamps_ns: Stamps, read: CloudReader
) -> PosedClouds:
    """A recording in a world whose origin is its first pose; the axes stay those of the map.

    Published poses are map coordinates of millions of metres. Raises BadTransform.
    """
    if not files:
        raise FileNotFoundError(f"{name}: no scan has a pose")
    poses = np.stack([se3.validated(pose) for pose in T_map_sensor])
    x, y, z = (float(value) for value in poses[0, :3, 3])
    poses[:, :3, 3] -= (x, y, z)
    return PosedClouds(name, files, poses, stamps_ns, read, (x, y, z))


def in_number_order(files: Iterable[Path]) -> list[Path]:
    """Files by the numbers in their names: 2.pcd before 10.pcd, and 1700000000.45 before 1700000000.5.

    Two numbers with a point between are one with decimals where the name is nothing else, or where some are times
    (seconds since 1970) or have decimals that begin with 0, which no numbers of parts do.
    """
    found = list(files)
    plain = all(_DECIMAL.fullmatch(file.stem) for file in found)
    number = _DECIMAL if plain or any(_TIME.search(file.stem) for file in found) else _WHOLE
    pieces = {file: _pieces(number, file.stem) for file in found}
    return sorted(found, key=lambda file: (pieces[file], file.name))


def _pieces(number: re.Pattern[str], stem: str) -> list[str | Decimal]:
    """The text between the numbers in a name, and the numbers, by turns."""
    ends = [0, *(end for found in number.finditer(stem) for end in found.span()), len(stem)]
    parts = [stem[first:last] for first, last in pairwise(ends)]
    return [Decimal(part) if place % 2 else part for place, part in enumerate(parts)]


def named_scans(folder: Path, pattern: str, ns_per_unit: int) -> tuple[list[Path], Stamps]:
    """Files of a folder whose names are times, and these times in nanoseconds. Raises FileNotFoundError, BadField."""
    files = in_number_order(folder.glob(pattern))
    if not files:
        raise FileNotFoundError(f"no scans {pattern} in {folder}")
    unnamed = [file.name for file in files if not file.stem.isascii() or not file.stem.isdigit()]
    if unnamed:
        raise BadField(f"{unnamed[0]} is not named by its time", field="stamp_ns")
    return files, np.array([int(file.stem) * ns_per_unit for file in files], dtype=np.int64)


def interpolated(
    name: str, scans: tuple[list[Path], Stamps], poses: StampedPoses, T_body_sensor: se3.Matrix4, read: CloudReader
) -> PosedClouds:
    """The scans (files, times) for whose time there are poses; the others are left out."""
    files, stamps_ns = scans
    kept = np.flatnonzero(poses.covered(stamps_ns))
    if len(kept) == 0:
        raise FileNotFoundError(f"{name}: no scan was taken while there were poses")
    T_map_sensor = [poses.at(int(stamps_ns[index])) @ T_body_sensor for index in kept]
    return posed(name, [files[index] for index in kept], T_map_sensor, stamps_ns[kept], read)
