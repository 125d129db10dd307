"""Policies of retention."""

from __future__ import annotations

from typing import Any

from revisit.service.domain.identity import TenantId
from revisit.service.domain.retention import KeptScans, RetentionPolicy
from revisit.service.features.retention.reports import MapRetention, RetentionReport
from revisit.service.use_cases import UseCases
from revisit.service.wire import names, requests
from revisit.service.wire.fields import Fields, fields_of
from revisit.service.wire.rendering import Answer
from revisit.v1 import retention_pb2

_NUMBERS = ("best_submaps", "session_days", "dropped_session_days", "rejected_days", "retired_days")


async def get_retention(cases: UseCases, tenant: TenantId, request: retention_pb2.GetRetentionRequest) -> Answer:
    """The policy of a map."""
    return {"retention": retention_fields(await cases.retention.get(tenant, names.map_id(request.name)))}


async def set_retention(cases: UseCases, tenant: TenantId, request: retention_pb2.SetRetentionRequest) -> Answer:
    """The policy of a map from now on."""
    kept = await cases.retention.set(tenant, names.map_id(request.name), _policy(request))
    return {"retention": retention_fields(kept)}


async def preview_retention(
    cases: UseCases, tenant: TenantId, request: retention_pb2.PreviewRetentionRequest
) -> Answer:
    """What a policy would remove."""
    report = await cases.retention.preview(tenant, names.map_id(request.name), _policy(request))
    return {"report": report_fields(report)}


def _policy(request: Any) -> RetentionPolicy | None:
    """The policy of a request, None where it is absent. Raises BadField."""
    if not request.HasField("policy"):
        return None
    sent = request.policy
    kept = requests.state_of(KeptScans, retention_pb2.RetentionPolicy.Scans, sent.keep_scans)
    return RetentionPolicy(
        kept or KeptScans.ALL, sent.scans_after_hours, **requests.present(sent, *_NUMBERS)
    ).validated()


def retention_fields(view: MapRetention) -> Fields:
    """The fields of a MapRetention."""
    last = None if view.last_run is None else report_fields(view.last_run)
    return fields_of(retention_pb2.MapRetention, view, map=f"maps/{view.map_id}", last_run=last)


def report_fields(view: RetentionReport) -> Fields:
    """The fields of a RetentionReport."""
    return fields_of(retention_pb2.RetentionReport, view)
