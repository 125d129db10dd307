"""The service `add_anchor`: a person or a detector says where a point that the robot sees lies, or which tag it is."""

from __future__ import annotations

import math
from typing import Any

from revisit.core.errors import BadField
from revisit.core.geometry import se3
from revisit.sdk.anchors import NewAnchor
from revisit_bridge.messages import frame, stamp_ns
from revisit_bridge.sightings import Place, Sighting


def sighting_of(request: Any, last_scan_ns: int) -> Sighting:
    """The sighting in a revisit_msgs/AddAnchor request; without a time it is that of the last scan. Raises BadField."""
    at_ns = stamp_ns(request.point.header) or last_scan_ns
    anchor_id = request.anchor_id or f"point-{at_ns}"
    sigmas_m = _three(request.sigma_m, "sigma_m")
    if min(sigmas_m) <= 0.0:
        raise BadField("sigma_m must hold three positive standard deviations, metres", field="sigma_m")
    heading = (float(request.heading_rad), float(request.heading_sigma_rad)) if _has_heading(request) else None
    geodetic, local_m = (None, None) if request.tag else _place(request)
    kind = "FIDUCIAL" if request.tag else "CONTROL_POINT" if heading is None else "KNOWN_POSE"

    def made(T_odom_sensor: se3.Matrix4, offset_m: Place) -> NewAnchor:
        return NewAnchor(
            anchor_id, kind, at_ns, sigmas_m, tag=request.tag or None,
            geodetic=geodetic, local_m=local_m, offset_m=offset_m, T_odom_sensor=T_odom_sensor,
            heading_rad=heading and heading[0], heading_sigma_rad=heading and heading[1],
        )  # fmt: skip

    return Sighting(at_ns, frame(request.point.header.frame_id), made, _three(request.point.point, "point"))


def _has_heading(request: Any) -> bool:
    return not request.tag and request.heading_sigma_rad != 0.0


def _place(request: Any) -> tuple[Place | None, Place | None]:
    """Where the point lies: on earth, or in the metres of the map."""
    if not request.on_earth:
        return None, _three(request.local_m, "local_m")
    told = (float(request.latitude_deg), float(request.longitude_deg), float(request.altitude_m))
    if not all(map(math.isfinite, told)):
        raise BadField("latitude_deg, longitude_deg and altitude_m must be finite", field="latitude_deg")
    return told, None


def _three(vector: Any, name: str) -> Place:
    told = (float(vector.x), float(vector.y), float(vector.z))
    if not all(map(math.isfinite, told)):
        raise BadField(f"{name} must be finite", field=name)
    return told
