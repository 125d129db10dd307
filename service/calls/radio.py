"""Readings of radio."""

from __future__ import annotations

from revisit.service.domain.identity import TenantId
from revisit.service.features.radio.calls import RadioReading
from revisit.service.use_cases import UseCases
from revisit.service.wire import names
from revisit.service.wire.rendering import Answer
from revisit.v1 import radio_pb2 as pb


async def post_radio(cases: UseCases, tenant: TenantId, request: pb.PostRadioRequest) -> Answer:
    """New readings of a session."""
    readings = [
        RadioReading(one.stamp_ns, tuple(one.access_points), tuple(one.strengths_dbm)) for one in request.readings
    ]
    return {"stored": await cases.radio.post(tenant, names.session_key(request.parent, "parent"), readings)}
