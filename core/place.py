"""Place: what is kept of a submap for verification, in some tens of kilobytes."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import VerificationConfig
from revisit.core.container import Container
from revisit.core.descriptor.vlad import Codebooks, project_locally
from revisit.core.errors import BadTransform, DataLoss
from revisit.core.geometry import octahedral
from revisit.core.geometry.level_frame import LevelFrame
from revisit.core.geometry.voxel_keys import voxel_keys
from revisit.core.kept import Keeping
from revisit.core.stages import stage

if TYPE_CHECKING:  # a place is read where nothing is described, without the libraries that this needs
    from revisit.core.bev import BevFeatures
    from revisit.core.clusters import Clusters
    from revisit.core.surface import Surface

Array = NDArray[np.float32]

CONTAINER = Container(b"RVPS\x01", "stored place", level=9, max_body_bytes=4_000_000, digest_bytes=16, body_length=True)
CENTIMETRE = 0.01
_NORMAL_STEPS = 127
_MAX_ROWS = 100_000


@dataclass(frozen=True)
class Place(Keeping):
    """Keypoints and surface of a submap as stored for verification, in the level frame.

    keypoints (n, 2) float32; orientations (n,) float32 radians in [0, pi); descriptors (n, l) float32 unit vectors;
    parity (l,) float32 +-1, their signs under a turn by 180 degrees; points (m, 3) float32 and normals (m, 3) float32
    unit, the first `standing_count` of them off the ground; model is the digest of the codebook of the descriptors;
    frame relates the level frame to that of the submap. Lengths are metres divided by the scene scale. All values but
    those of frame are the stored, quantised ones, so that parsing a blob gives the same place; frame survives within
    rounding.
    """

    keypoints: Array
    orientations: Array
    descriptors: Array
    parity: Array
    points: Array
    normals: Array
    standing_count: int
    model: str
    frame: LevelFrame = field(default_factory=LevelFrame)

    @cached_property
    def content_digest(self) -> bytes:
        """A SHA-256 of where the surface and the keypoints lie, in centimetres of the level frame.

        It depends on nothing but the stored geometry: not on the session, the codebook or how the blob is compressed.
        """
        levels = _centimetres(self.points).tobytes() + _centimetres(self.keypoints).tobytes()
        return hashlib.sha256(levels).digest()

    def to_blob(self) -> bytes:
        """The place as bytes: magic, header, zstd body, truncated SHA-256 over all of it."""
        sections = [_encode_keypoints(self), _encode_descriptors(self), _encode_points(self)]
        header = {
            "keypoints": len(self.keypoints), "size": int(self.parity.shape[0]), "points": len(self.points),
            "standing": self.standing_count, "model": self.model,
            "T_level_submap": np.linalg.inv(self.frame.similarity)[:3].tolist(),
        }  # fmt: skip
        return CONTAINER.pack(header, b"".join(sections))

    @classmethod
    def from_blob(cls, blob: bytes) -> Place:
        """The inverse of `to_blob`. Raises DataLoss for anything that `to_blob` did not write."""
        header, body = CONTAINER.unpack(blob)
        count, size, rows, standing = (_bounded(header, name) for name in ("keypoints", "size", "points", "standing"))
        lengths = [6 * count, size + count * size, 8 * rows]
        model = header.get("model")
        if len(body) != sum(lengths) or standing > rows or not isinstance(model, str):
            raise DataLoss("the place's sections do not have the announced sizes")
        ends = np.cumsum(lengths)
        keypoints, orientations = _decode_keypoints(body[: ends[0]], count)
        parity, descriptors = _decode_descriptors(body[ends[0] : ends[1]], count, size)
        points, normals = _decode_points(body[ends[1] :], rows)
        return cls(keypoints, orientations, descriptors, parity, points, normals, standing, model, _frame(header))


@stage("place")
def extract_place(
    surface: Surface,
    clusters: Clusters,
    bev: BevFeatures,
    codebooks: Codebooks,
    config: VerificationConfig,
) -> Place:
    """The place of a submap: its keypoints, and a thinned, evenly spread copy of its surface."""
    standing = _spread_rows(surface.vertices, ~clusters.ground, config.spacing, config.standing_points)
    ground = _spread_rows(surface.vertices, clusters.ground, 2.0 * config.spacing, config.ground_points)
    rows = np.concatenate([standing, ground])
    place = Place(
        bev.keypoints, bev.orientations, project_locally(bev.descriptors, codebooks), codebooks.local_parity,
        surface.vertices[rows], surface.normals[rows], len(standing), patch_model(codebooks),
    )  # fmt: skip
    return Place.from_blob(place.to_blob())


def patch_model(codebooks: Codebooks) -> str:
    """A digest of the basis that keypoint descriptors are projected on: only those of one basis are comparable."""
    return hashlib.sha256(np.ascontiguousarray(codebooks.local_basis).tobytes()).hexdigest()[:16]


def _spread_rows(points: Array, chosen: NDArray[np.bool_], spacing: float, limit: int) -> NDArray[np.int64]:
    """One row for each cube of edge `spacing` among the chosen points; where still too many, every k-th of them."""
    rows = np.flatnonzero(chosen)
    near = rows[np.abs(points[rows]).max(axis=1) < 300.0]
    cubes = np.floor(points[near] / spacing).astype(np.int64)
    _, first = np.unique(voxel_keys(cubes), return_index=True)
    spread = near[first]
    if len(spread) <= limit:
        return np.asarray(spread)
    return np.asarray(spread[np.linspace(0, len(spread) - 1, limit).astype(np.int64)])


def _encode_keypoints(place: Place) -> bytes:
    angles = np.rint(place.orientations / np.pi * 65536.0).astype(np.int64) % 65536
    return bytes(_centimetres(place.keypoints).T.tobytes() + angles.astype("<u2").tobytes())


def _decode_keypoints(data: bytes, count: int) -> tuple[Array, Array]:
    positions = np.frombuffer(data, "<i2", 2 * count).reshape(2, count).T
    angles = np.frombuffer(data, "<u2", count, 4 * count)
    return _metres(positions), (angles * (np.pi / 65536.0)).astype(np.float32)


def _encode_descriptors(place: Place) -> bytes:
    # a unit vector keeps its direction when its largest component becomes +-127
    largest = np.maximum(np.abs(place.descriptors).max(axis=1, initial=0.0, keepdims=True), 1e-12)
    levels = np.rint(place.descriptors / largest * 127.0).astype(np.int8)
    return bytes(place.parity.astype(np.int8).tobytes() + levels.T.tobytes())


def _decode_descriptors(data: bytes, count: int, size: int) -> tuple[Array, Array]:
    parity = np.frombuffer(data, np.int8, size).astype(np.float32)
    levels = np.frombuffer(data, np.int8, count * size, size).reshape(size, count).T.astype(np.float32)
    return parity, levels / np.maximum(np.linalg.norm(levels, axis=1, keepdims=True), 1e-12)


def _encode_points(place: Place) -> bytes:
    levels = _centimetres(place.points)
    differences = np.diff(levels, axis=0, prepend=np.zeros((1, 3), levels.dtype))  # wraps, and so does the sum
    return bytes(differences.T.tobytes() + octahedral.encode(place.normals, _NORMAL_STEPS).T.tobytes())


def _decode_points(data: bytes, rows: int) -> tuple[Array, Array]:
    differences = np.frombuffer(data, "<i2", 3 * rows).reshape(3, rows).T
    codes = np.frombuffer(data, np.uint8, 2 * rows, 6 * rows).reshape(2, rows).T
    normals = octahedral.decode(codes, _NORMAL_STEPS).astype(np.float32)
    return _metres(np.cumsum(differences, axis=0, dtype=np.int16)), normals


def _centimetres(positions: Array) -> NDArray[np.int16]:
    return np.asarray(np.clip(np.rint(positions / CENTIMETRE), -32767, 32767), dtype="<i2")


def _metres(levels: NDArray[np.int16]) -> Array:
    return np.asarray(levels * np.float32(CENTIMETRE), dtype=np.float32)


def _frame(header: dict[str, object]) -> LevelFrame:
    try:
        level_submap = np.vstack([np.asarray(header.get("T_level_submap"), dtype=np.float64), [0.0, 0.0, 0.0, 1.0]])
        return LevelFrame.from_similarity(np.linalg.inv(level_submap))
    except (BadTransform, TypeError, ValueError) as error:
        raise DataLoss("the level frame of the place is no similarity") from error


def _bounded(header: dict[str, object], name: str) -> int:
    value = header.get(name)
    if type(value) is not int or not 0 <= value <= _MAX_ROWS:
        raise DataLoss(f"the place's {name} is unusable")
    return value
