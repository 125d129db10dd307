"""Anchors of sessions."""

from __future__ import annotations

from typing import Any

from revisit.core.errors import BadField
from revisit.service.calls.operations import asked_fields
from revisit.service.domain.identity import TenantId
from revisit.service.domain.states import AnchorFrame, AnchorKind
from revisit.service.features.anchors.calls import AnchorView
from revisit.service.features.anchors.rules import NewAnchor
from revisit.service.use_cases import UseCases
from revisit.service.wire import names, requests
from revisit.service.wire.fields import Fields, fields_of, geodetic_fields, vector_fields
from revisit.service.wire.rendering import Answer
from revisit.v1 import anchor_pb2 as pb


async def post_anchors(cases: UseCases, tenant: TenantId, request: pb.PostAnchorsRequest) -> Answer:
    """New anchors of a session."""
    posted = await cases.anchors.post(
        tenant, names.session_key(request.parent, "parent"), [*map(_anchor, request.anchors)]
    )
    return {"anchors": [anchor_fields(one) for one in posted]}


async def preview_anchors(cases: UseCases, tenant: TenantId, request: pb.PreviewAnchorsRequest) -> Answer:
    """The operation that says what anchors would do."""
    key = names.session_key(request.parent, "parent")
    return asked_fields(await cases.anchors.preview(tenant, key, [*map(_anchor, request.anchors)]))


def _anchor(sent: pb.NewAnchor) -> NewAnchor:
    """Raises BadField, BadTransform."""
    kind = requests.state_of(AnchorKind, pb.Anchor.Kind, sent.kind)
    if kind is None:
        raise BadField("an anchor needs a kind", field="kind")
    frame, position = _place(sent, kind)
    return NewAnchor(
        sent.anchor_id,
        kind,
        frame,
        sent.stamp_ns,
        position,
        tuple(sent.covariance_enu),
        (sent.offset_m.x, sent.offset_m.y, sent.offset_m.z),
        requests.optional_pose(sent, "t_odom_sensor"),
        **requests.present(sent, "heading_rad", "heading_sigma_rad", "tag"),
    )


def _place(sent: pb.NewAnchor, kind: AnchorKind) -> tuple[AnchorFrame, tuple[float, float, float]]:
    """Raises BadField where an anchor has no place, or two. A fiducial has none."""
    if kind is AnchorKind.FIDUCIAL and not sent.HasField("geodetic") and not sent.HasField("local_m"):
        return AnchorFrame.TAG, (0.0, 0.0, 0.0)
    if sent.HasField("geodetic") == sent.HasField("local_m"):
        raise BadField("an anchor needs one place: geodetic or local_m", field="geodetic")
    if sent.HasField("geodetic"):
        at: Any = sent.geodetic
        return AnchorFrame.WGS84, (at.latitude_deg, at.longitude_deg, at.altitude_m)
    return AnchorFrame.LOCAL, (sent.local_m.x, sent.local_m.y, sent.local_m.z)


def anchor_fields(view: AnchorView) -> Fields:
    """The fields of an Anchor."""
    record = view.record
    return fields_of(
        pb.Anchor,
        record,
        geodetic=geodetic_fields(record.position) if record.frame == AnchorFrame.WGS84 else None,
        covariance_enu=list(record.covariance),
        local_m=vector_fields(record.position) if record.frame == AnchorFrame.LOCAL else None,
        state=None if view.state is None else view.state.value,
        reason=None if view.reason is None else view.reason.value,
        residual_m=None if view.residual_m is None else vector_fields(view.residual_m),
    )
