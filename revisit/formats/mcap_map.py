"""A map as an MCAP file, which Foxglove and its like draw: poses, the cloud and the frames; written only.

Channels, in JSON by Foxglove's well-known schemas: /map/poses/SESSION (PosesInFrame), /map/cloud (PointCloud),
/map/sessions (SceneUpdate: a line for each session).
"""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import BadField
from revisit.core.geometry import se3
from revisit.core.geometry.se3 import Matrix4
from revisit.core.point_columns import NONE, Columns
from revisit.formats.cloud import kinds_of, records_for_writing

MEDIA_TYPE = "application/x-mcap"

_TYPES = {"u1": 1, "i1": 2, "u2": 3, "i2": 4, "u4": 5, "i4": 6, "f4": 7, "f8": 8}
"""Of the fields of a foxglove.PointCloud, by numpy code."""
_LINE_STRIP = 0
_COLOURS = (
    (0.27, 0.47, 0.67),
    (0.93, 0.4, 0.47),
    (0.13, 0.53, 0.2),
    (0.8, 0.73, 0.27),
    (0.4, 0.8, 0.93),
    (0.67, 0.2, 0.47),
)
"""Of the sessions, in turn: Paul Tol's bright scheme."""

_ANYTHING: dict[str, Any] = {"type": "object"}


@dataclass(frozen=True)
class DrivenPoses:
    """The poses of a session in the map: times (n,) nanoseconds since 1970, T_map_submap (n, 4, 4)."""

    stamps_ns: NDArray[np.int64]
    T_map_submap: NDArray[np.float64]


def encode(
    sessions: Mapping[str, DrivenPoses],
    points: NDArray[np.floating],
    frame: str = "map",
    columns: Columns = NONE,
) -> bytes:
    """An MCAP file of the poses of `sessions` by name, and of the cloud (n, 3) in metres with its columns, in `frame`.

    Needs the package `mcap`. Raises BadField for other shapes and for numbers that are not finite.
    """
    from mcap.writer import CompressionType, Writer

    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise BadField("points must be (n, 3) and finite", field="points")
    stream = io.BytesIO()
    writer = Writer(stream, compression=CompressionType.ZSTD)
    writer.start(profile="", library="revisit")
    begun_ns = min((int(one.stamps_ns[0]) for one in sessions.values() if len(one.stamps_ns)), default=0)
    for name, one in sessions.items():
        _write(writer, "foxglove.PosesInFrame", f"/map/poses/{name}", _first(one), _poses(one, frame))
    _write(writer, "foxglove.PointCloud", "/map/cloud", begun_ns, _cloud(points, columns, begun_ns, frame))
    _write(writer, "foxglove.SceneUpdate", "/map/sessions", begun_ns, _scene(sessions, begun_ns, frame))
    writer.finish()  # type: ignore[no-untyped-call]  # the package leaves its types out here
    return stream.getvalue()


def _write(writer: Any, schema: str, topic: str, stamp_ns: int, message: dict[str, Any]) -> None:
    """A channel of its own with one message."""
    known = writer.register_schema(name=schema, encoding="jsonschema", data=json.dumps(_ANYTHING).encode())
    channel = writer.register_channel(topic=topic, message_encoding="json", schema_id=known)
    data = json.dumps(message, allow_nan=False).encode()
    writer.add_message(channel_id=channel, log_time=stamp_ns, publish_time=stamp_ns, data=data)


def _first(one: DrivenPoses) -> int:
    return int(one.stamps_ns[0]) if len(one.stamps_ns) else 0


def _poses(one: DrivenPoses, frame: str) -> dict[str, Any]:
    poses = [_pose(T) for T in one.T_map_submap]
    return {"timestamp": _time(_first(one)), "frame_id": frame, "poses": poses}


def _cloud(points: NDArray[np.floating], columns: Columns, stamp_ns: int, frame: str) -> dict[str, Any]:
    """The points from the first one's whole metres, which the pose leads to, so that float32 holds them in UTM, too."""
    origin = np.rint(np.asarray(points[:1], np.float64).sum(axis=0))
    records = records_for_writing((points - origin).astype(np.float32), columns)
    places = {name: place for name, (_, place, *_) in (records.dtype.fields or {}).items()}
    fields = [
        {"name": name, "offset": places[name], "type": _TYPES[kind[1:]]} for name, kind in kinds_of(records).items()
    ]
    data = base64.b64encode(records.tobytes()).decode()
    pose = _pose(se3.from_yaw(0.0, origin))
    head = {"timestamp": _time(stamp_ns), "frame_id": frame, "pose": pose, "point_stride": records.itemsize}
    return {**head, "fields": fields, "data": data}


def _scene(sessions: Mapping[str, DrivenPoses], stamp_ns: int, frame: str) -> dict[str, Any]:
    entities = [
        {
            "timestamp": _time(stamp_ns),
            "frame_id": frame,
            "id": name,
            "lifetime": {"sec": 0, "nsec": 0},
            "frame_locked": True,
            "lines": [_line(one.T_map_submap, _COLOURS[number % len(_COLOURS)])],
        }
        for number, (name, one) in enumerate(sessions.items())
    ]
    return {"deletions": [], "entities": entities}


def _line(T_map_submap: NDArray[np.float64], colour: tuple[float, float, float]) -> dict[str, Any]:
    points = [_vector(T[:3, 3]) for T in T_map_submap]
    red, green, blue = colour
    return {
        "type": _LINE_STRIP,
        "pose": _pose(np.eye(4)),
        "thickness": 2.0,
        "scale_invariant": True,
        "points": points,
        "color": {"r": red, "g": green, "b": blue, "a": 1.0},
        "colors": [],
        "indices": [],
    }


def _pose(T: Matrix4) -> dict[str, Any]:
    orientation = dict(zip("xyzw", se3.to_quaternion(np.asarray(T)).tolist(), strict=True))
    return {"position": _vector(T[:3, 3]), "orientation": orientation}


def _vector(position: NDArray[np.float64]) -> dict[str, float]:
    return dict(zip("xyz", position.tolist(), strict=True))


def _time(stamp_ns: int) -> dict[str, int]:
    return {"sec": stamp_ns // 10**9, "nsec": stamp_ns % 10**9}
