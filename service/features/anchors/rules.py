"""Anchors as clients send them: their bounds, and where the drive was at their time."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import BadField
from revisit.core.geometry import se3
from revisit.core.geometry.se3 import Matrix4, pose_matrix, pose_row
from revisit.service.domain import limits
from revisit.service.domain.identity import SessionKey, TenantId, content_hash, validated_detail, validated_id
from revisit.service.domain.records import AnchorRecord
from revisit.service.domain.states import AnchorFrame, AnchorKind

Array64 = NDArray[np.float64]


@dataclass(frozen=True)
class NewAnchor:
    """An anchor to post (see `AnchorRecord`); T_odom_sensor (4, 4) is None where the stored scans tell it.

    A fiducial has its `tag`, the frame TAG, and no position.
    """

    anchor_id: str
    kind: AnchorKind
    frame: AnchorFrame
    stamp_ns: int
    position: tuple[float, float, float]
    covariance: tuple[float, ...]
    offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    T_odom_sensor: Matrix4 | None = None
    heading_rad: float | None = None
    heading_sigma_rad: float | None = None
    tag: str | None = None

    def validated(self) -> NewAnchor:
        """The same. Raises BadField."""
        validated_id(self.anchor_id, "anchor_id")
        limits.STAMP_NS.validated(self.stamp_ns, "stamp_ns")
        self._require_tag()
        bounds = limits.GEODETIC if self.frame is AnchorFrame.WGS84 else limits.LOCAL
        for (field, bound), value in zip(bounds.items(), self.position, strict=True):
            bound.validated(value, field)
        for value in self.offset_m:
            limits.ANCHOR_OFFSET_M.validated(value, "offset_m")
        _require_covariance(self.covariance)
        self._require_heading()
        return self

    def _require_tag(self) -> None:
        is_tag = self.kind is AnchorKind.FIDUCIAL
        if {self.tag is not None, self.frame is AnchorFrame.TAG} != {is_tag}:
            raise BadField("a FIDUCIAL needs its tag and has no place, others have a place and no tag", field="tag")
        validated_detail(self.tag, "tag")

    def _require_heading(self) -> None:
        told = {self.heading_rad is not None, self.heading_sigma_rad is not None}
        if told != {self.kind is AnchorKind.KNOWN_POSE}:
            raise BadField(
                "a KNOWN_POSE needs heading_rad and heading_sigma_rad, others have none", field="heading_rad"
            )
        if self.heading_rad is not None and self.heading_sigma_rad is not None:
            limits.HEADING_RAD.validated(self.heading_rad, "heading_rad")
            limits.HEADING_SIGMA_RAD.validated(self.heading_sigma_rad, "heading_sigma_rad")

    def record(self, tenant: TenantId, key: SessionKey, T_odom_sensor: Matrix4, now_ns: int) -> AnchorRecord:
        """The row, with the pose of the sensor in the odometry frame of the session."""
        given = None if self.T_odom_sensor is None else self.T_odom_sensor.astype("<f8").tobytes()
        told = ((name, value) for name, value in vars(self).items() if name != "tag" or value is not None)
        content = [given if name == "T_odom_sensor" else value for name, value in told]
        return AnchorRecord(
            tenant=tenant,
            map_id=key.map_id,
            session_id=key.session_id,
            anchor_id=self.anchor_id,
            content_hash=content_hash(content),
            kind=self.kind.value,
            frame=self.frame.value,
            stamp_ns=self.stamp_ns,
            position=self.position,
            covariance=self.covariance,
            offset_m=self.offset_m,
            T_odom_sensor=pose_row(T_odom_sensor),
            heading_rad=self.heading_rad,
            heading_sigma_rad=self.heading_sigma_rad,
            created_at_ns=now_ns,
            tag=self.tag,
        )


@dataclass(frozen=True)
class AnchorQuestion:
    """The question of what anchors would do to a map: the payload of a job."""

    map_id: str
    anchors: tuple[AnchorRecord, ...]

    def payload(self) -> dict[str, Any]:
        """As JSON."""
        return {"map_id": self.map_id, "anchors": [_as_json(one) for one in self.anchors]}

    @classmethod
    def of(cls, payload: dict[str, Any]) -> AnchorQuestion:
        """The inverse of `payload`."""
        return cls(str(payload["map_id"]), tuple(_from_json(one) for one in payload["anchors"]))


def _as_json(record: AnchorRecord) -> dict[str, Any]:
    return {name: list(value) if isinstance(value, tuple) else value for name, value in vars(record).items()}


def _from_json(fields: dict[str, Any]) -> AnchorRecord:
    values: dict[str, Any] = {name: tuple(it) if isinstance(it, list) else it for name, it in fields.items()}
    return AnchorRecord(**values)


def _require_covariance(numbers: Sequence[float]) -> None:
    """Raises BadField where 9 numbers are no covariance of a place."""
    field = "covariance_enu"
    if len(numbers) != 9 or not np.isfinite(numbers).all():
        raise BadField("covariance_enu must hold 9 finite numbers: 3 x 3, row by row", field=field)
    matrix = np.reshape(numbers, (3, 3))
    scale = np.abs(matrix).max()
    if np.abs(matrix - matrix.T).max() > 1e-6 * scale or np.linalg.eigvalsh(matrix)[0] <= 0.0:
        raise BadField("covariance_enu must be symmetric and positive definite", field=field)
    for variance in np.diag(matrix):
        limits.PLACE_VARIANCE_M2.validated(float(variance), field)


@dataclass(frozen=True)
class DrivePoses:
    """Poses of a drive by their times, in order."""

    stamps_ns: Sequence[int]
    T_odom: Sequence[tuple[float, ...]]

    def at(self, stamp_ns: int) -> Matrix4 | None:
        """The pose (4, 4) at a time, on the way between the two around it; None where it is before or behind all."""
        after = bisect_left(self.stamps_ns, stamp_ns)
        if after < len(self.stamps_ns) and self.stamps_ns[after] == stamp_ns:
            return pose_matrix(self.T_odom[after])
        if not 0 < after < len(self.stamps_ns):
            return None
        first, last = self.stamps_ns[after - 1], self.stamps_ns[after]
        T_first, T_last = pose_matrix(self.T_odom[after - 1]), pose_matrix(self.T_odom[after])
        return se3.interpolated(T_first, T_last, (stamp_ns - first) / (last - first))
