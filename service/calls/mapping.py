"""One map out of many sessions: versions of its poses, merges, corrections."""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping
from typing import Any

from revisit.service.calls.operations import asked_fields
from revisit.service.domain.identity import TenantId
from revisit.service.domain.records import MapMergeRecord
from revisit.service.features.changes.calls import MapChangeView
from revisit.service.features.corrections.calls import CorrectionView
from revisit.service.features.events.calls import DriveChangesView
from revisit.service.features.merging.calls import MergeMap
from revisit.service.features.optimisation.calls import MapVersionView, SubmapPoseView
from revisit.service.ports.map_optimiser import GEOREFERENCES, SESSIONS
from revisit.service.use_cases import UseCases
from revisit.service.wire import names, requests
from revisit.service.wire.fields import (
    Fields,
    covariance_numbers,
    fields_of,
    resource_name,
    transform_fields,
    vector_fields,
)
from revisit.service.wire.rendering import Answer
from revisit.v1 import mapping_pb2 as pb


async def merge_map(cases: UseCases, tenant: TenantId, request: pb.MergeMapRequest) -> Answer:
    """The operation that merges another map, or a session of it, into a map."""
    command = MergeMap(
        names.map_id(request.name),
        *names.merge_source(request.source),
        request.validate_only,
        requests.optional_pose(request, "t_map_source"),
        requests.optional(request, "radius_m"),
    )
    return asked_fields(await cases.map_merges.merge(tenant, command))


async def watch_corrections(
    cases: UseCases, tenant: TenantId, request: pb.WatchCorrectionsRequest
) -> AsyncIterator[Fields]:
    """The corrections of a map, those to come too."""
    map_id = names.map_id(request.parent, "parent")
    session_id = names.session_id_in(request.parent, request.session, "session")
    async for view in cases.corrections.watch(tenant, map_id, request.after, session_id):
        yield {"correction": correction_fields(view)}


def drive_changes_fields(view: DriveChangesView) -> Fields:
    """The fields of a DriveChanges."""
    version = f"maps/{view.session.map_id}/versions/{view.found.version}"
    return fields_of(pb.DriveChanges, view.found, session=view.session.name, map_version=version)


def version_fields(view: MapVersionView) -> Fields:
    """The fields of a MapVersion."""
    name, operation = f"maps/{view.map_id}/versions/{view.version}", resource_name("operations", view.operation_id)
    return fields_of(pb.MapVersion, view, name=name, operation=operation, summary=_summary_fields(view.summary))


def _summary_fields(summary: Mapping[str, Any]) -> Fields:
    """The fields of a MapVersionSummary."""
    frames = [{**one, "t_enu_map": transform_fields(one["T_enu_map"])} for one in summary.get(GEOREFERENCES, ())]
    for frame in frames:
        del frame["T_enu_map"]
        told = frame.get(SESSIONS, ())
        frame[SESSIONS] = [{**one, "offset_m": vector_fields(one["offset_m"])} for one in told]
    # Of a map that a known pose alone held, -1 was stored once.
    degrees = max(0, summary["degrees_of_freedom"])
    return {**summary, "degrees_of_freedom": degrees, GEOREFERENCES: frames}


def submap_pose_fields(view: SubmapPoseView) -> Fields:
    """The fields of a SubmapPose."""
    covariance = covariance_numbers(view.covariance)
    return fields_of(pb.SubmapPose, view, submap=view.key.name, covariance=covariance)


def merge_fields(record: MapMergeRecord) -> Fields:
    """The fields of a MapMerge."""
    return fields_of(
        pb.MapMerge,
        record,
        name=f"maps/{record.map_id}/merges/{record.merge_id}",
        sessions=[f"maps/{record.map_id}/sessions/{name}" for name in record.sessions],
        report={name: value for name, value in record.report.items() if name != "changes"},
        changes=[_change_fields(one) for one in record.report["changes"]],
    )


def _change_fields(change: Mapping[str, Any]) -> Fields:
    """The fields of a MapChange; those that are None are left out."""
    places = ("centre_m", "extent_m", "moved_from_m")
    known = {name: its for name, its in change.items() if its is not None}
    return {name: vector_fields(its) if name in places else its for name, its in known.items()}


def change_fields(view: MapChangeView) -> Fields:
    """The fields of a MapChange between the drives of a map."""
    return _change_fields({**vars(view.change), "session": view.session.name})


def correction_fields(view: CorrectionView) -> Fields:
    """The fields of a Correction."""
    covariance = covariance_numbers(view.covariance)
    return fields_of(pb.Correction, view, session=view.session.name, covariance=covariance)
