"""A version of a map as one file that never changes: a ZIP archive of poses, descriptors and neural maps.

manifest.json      the map in the words of VDA 5050, and the SHA-256 and size of every other member
submaps.json       name, time, frame, T_map_submap, T_odom_submap and neural map of each submap
descriptors.f32    one row a submap, little-endian float32
neural/SHA256      the neural maps, each once

Members are not compressed (neural maps are already) and have no times, so that the same version gives the same bytes,
and a reader needs only the ranges of the file that it asks for. Every member is checked when it is read.
"""

from __future__ import annotations

import hashlib
import json
import zipfile
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO, Any, Self

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import DataLoss, MalformedBody
from revisit.core.geometry.se3 import Matrix4, pose_matrix, pose_row
from revisit.formats.whole_files import written_beside

FORMAT = "revisit-map/1"

MAX_JSON_BYTES = 256 * 2**20
MAX_NEURAL_BYTES = 64 * 2**20

_MANIFEST, _SUBMAPS, _DESCRIPTORS = "manifest.json", "submaps.json", "descriptors.f32"
_EPOCH = (1980, 1, 1, 0, 0, 0)
"""Of all members: the earliest time that ZIP knows."""


@dataclass(frozen=True)
class MapDescription:
    """The manifest of a map file. mapId and mapVersion are those of VDA 5050.

    The others are needed to describe a query: model, scale and windows of the map, and its rules for loops.
    """

    map_id: str
    map_version: str
    content_hash: str
    created_at_ns: int
    model_version: str
    scene_scale: float
    tau_m: float
    stride_m: float
    loop_policy: Mapping[str, float | int | None]


@dataclass(frozen=True)
class FiledSubmap:
    """A submap of a map file: T_map_submap (4, 4) in its frame of the map, T_odom_submap (4, 4) in that of its session;
    `neural` is the SHA-256 of its neural map.
    """

    name: str
    ordinal: int
    stamp_ns: int
    frame: str
    T_map_submap: Matrix4
    T_odom_submap: Matrix4
    neural: str

    @property
    def session(self) -> str:
        """Its name, maps/{map}/sessions/{session}."""
        return self.name.partition("/submaps/")[0]


def write_map_file(
    file: Path,
    description: MapDescription,
    submaps: Iterable[tuple[FiledSubmap, NDArray[np.float32], bytes]],
) -> str:
    """As `write_map`, to a file. The SHA-256 (hex) of the file: its mapHash."""
    with written_beside(file) as part:
        with part.open("wb") as stream:
            write_map(stream, description, submaps)
        return hash_of_file(part)


def write_map(
    stream: IO[bytes],
    description: MapDescription,
    submaps: Iterable[tuple[FiledSubmap, NDArray[np.float32], bytes]],
) -> None:
    """Write a map to a stream that can be sought: submaps with their descriptors (d,) and neural maps, as they come.

    Raises ValueError where a neural map is not the one that its submap names.
    """
    rows, vectors, members = [], [], {}
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_STORED) as archive:
        for submap, vector, neural in submaps:
            if hashlib.sha256(neural).hexdigest() != submap.neural:
                raise ValueError(f"{submap.name} has another neural map")
            if (member := f"neural/{submap.neural}") not in members:
                members[member] = _add(archive, member, neural)
            rows.append(_row(submap))
            vectors.append(np.asarray(vector, dtype="<f4"))
        members[_SUBMAPS] = _add(archive, _SUBMAPS, _json_bytes(rows))
        members[_DESCRIPTORS] = _add(archive, _DESCRIPTORS, b"".join(vector.tobytes() for vector in vectors))
        manifest = {"format": FORMAT, **_camel(asdict(description)), "submaps": len(rows), "files": members}
        _add(archive, _MANIFEST, _json_bytes(manifest))


def hash_of_file(file: Path) -> str:
    """SHA-256 (hex) of a file."""
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


class MapFile:
    """A map file that is open for reading. Neural maps are read one by one, as they are asked for."""

    def __init__(self, stream: IO[bytes]) -> None:
        """`stream` can be read and sought. Raises MalformedBody for another file, DataLoss for a damaged one."""
        try:
            self._archive = zipfile.ZipFile(stream)
            manifest = _object(self._archive, _MANIFEST)
            if manifest.get("format") != FORMAT:
                raise MalformedBody(f"the file is no map of format {FORMAT}")
            self.files: dict[str, Mapping[str, Any]] = {
                str(name): _checked(entry) for name, entry in manifest["files"].items()
            }
            fields = {name: manifest[_camel_word(name)] for name in MapDescription.__dataclass_fields__}
            self.description = MapDescription(**fields)
            rows = json.loads(self._member(_SUBMAPS, MAX_JSON_BYTES))
            self.submaps = tuple(_submap(row) for row in rows)
            flat = np.frombuffer(self._member(_DESCRIPTORS, MAX_JSON_BYTES), dtype="<f4")
            self.descriptors = flat.reshape(len(self.submaps), -1) if len(self.submaps) else flat.reshape(0, 0)
        except (zipfile.BadZipFile, ArithmeticError, LookupError, TypeError, ValueError, RuntimeError) as error:
            raise MalformedBody("the file is no map, or is cut off") from error

    @classmethod
    def open(cls, file: Path) -> Self:
        """The map in a file. Raises as the constructor."""
        return cls(file.open("rb"))

    def neural_map(self, submap: FiledSubmap) -> bytes:
        """The stored neural map of a submap. Raises DataLoss where it is damaged."""
        return self._member(f"neural/{submap.neural}", MAX_NEURAL_BYTES)

    def verify(self) -> None:
        """Read and check every member. Raises DataLoss."""
        for member in self.files:
            self._member(member, MAX_JSON_BYTES)

    def close(self) -> None:
        """Let go of the file."""
        self._archive.close()

    def __enter__(self) -> Self:
        """The file itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Let go of the file."""
        self.close()

    def _member(self, name: str, limit: int) -> bytes:
        """A member that has the size and the hash that the manifest says. Raises DataLoss."""
        known = self.files[name]
        try:
            data = _read(self._archive, name, min(limit, known["bytes"]))
        except zipfile.BadZipFile as error:
            raise DataLoss(f"{name} of the map file is damaged") from error
        if hashlib.sha256(data).hexdigest() != known["sha256"]:
            raise DataLoss(f"{name} of the map file is damaged")
        return data


@dataclass(frozen=True)
class MapDifference:
    """Differences of two map files: names of submaps in one alone; how far those of both have moved, metres, where
    they are in one frame; how many bytes of the newer file the older one has already.
    """

    added: tuple[str, ...]
    removed: tuple[str, ...]
    moved_m: Mapping[str, float]
    other_frame: tuple[str, ...]
    bytes_known: int
    bytes_new: int


def difference(older: MapFile, newer: MapFile) -> MapDifference:
    """Changes from one version to another."""
    before, after = ({one.name: one for one in file.submaps} for file in (older, newer))
    both = sorted(before.keys() & after.keys())
    same_frame = [name for name in both if before[name].frame == after[name].frame]
    known = {entry["sha256"] for entry in older.files.values()}
    sizes = {bool(entry["sha256"] in known): 0 for entry in newer.files.values()}
    for entry in newer.files.values():
        sizes[entry["sha256"] in known] += entry["bytes"]
    return MapDifference(
        added=tuple(sorted(after.keys() - before.keys())),
        removed=tuple(sorted(before.keys() - after.keys())),
        moved_m={name: _gap_m(before[name].T_map_submap, after[name].T_map_submap) for name in same_frame},
        other_frame=tuple(name for name in both if before[name].frame != after[name].frame),
        bytes_known=sizes.get(True, 0),
        bytes_new=sizes.get(False, 0),
    )


def _gap_m(one: Matrix4, other: Matrix4) -> float:
    return float(np.linalg.norm(one[:3, 3] - other[:3, 3]))


def _add(archive: zipfile.ZipFile, name: str, data: bytes) -> dict[str, Any]:
    """Write a member without time and rights; its entry of the manifest."""
    info = zipfile.ZipInfo(name, _EPOCH)
    info.create_system = 3
    info.external_attr = 0o644 << 16
    archive.writestr(info, data)
    return {"bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}


def _read(archive: zipfile.ZipFile, name: str, limit: int) -> bytes:
    """A member of at most `limit` bytes, stored as it is. Raises BadZipFile."""
    info = archive.getinfo(name)
    if info.compress_type != zipfile.ZIP_STORED or info.file_size > limit:
        raise zipfile.BadZipFile(f"{name} is larger than it says")
    with archive.open(info) as member:
        return member.read(limit)


def _object(archive: zipfile.ZipFile, name: str) -> dict[str, Any]:
    found = json.loads(_read(archive, name, MAX_JSON_BYTES))
    if not isinstance(found, dict):
        raise MalformedBody("the manifest of the map file is no object")
    return found


def _checked(entry: Mapping[str, Any]) -> Mapping[str, Any]:
    """A member of the manifest: size in bytes and hash. Raises ValueError, TypeError, LookupError."""
    size, sha256 = entry["bytes"], entry["sha256"]
    if type(size) is not int or size < 0 or not isinstance(sha256, str):
        raise ValueError("a member of the map file has no size or no hash")
    return {"bytes": size, "sha256": sha256}


def _row(submap: FiledSubmap) -> dict[str, Any]:
    poses = {"T_map_submap": pose_row(submap.T_map_submap), "T_odom_submap": pose_row(submap.T_odom_submap)}
    return {**vars(submap), **poses}


def _submap(row: Mapping[str, Any]) -> FiledSubmap:
    poses = [pose_matrix(tuple(float(x) for x in row[name])) for name in ("T_map_submap", "T_odom_submap")]
    name, frame, neural = (str(row[name]) for name in ("name", "frame", "neural"))
    return FiledSubmap(name, int(row["ordinal"]), int(row["stamp_ns"]), frame, poses[0], poses[1], neural)


def _json_bytes(value: Any) -> bytes:
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


def _camel(fields: Mapping[str, Any]) -> dict[str, Any]:
    return {_camel_word(name): value for name, value in fields.items()}


def _camel_word(name: str) -> str:
    """The word mapId for map_id."""
    first, *others = name.split("_")
    return first + "".join(word.capitalize() for word in others)
