"""Views of the use cases to the fields of their messages in `proto/revisit/v1`: the only place that lists the fields.

Each function returns a dict by field name; a field that is None is absent. gRPC gives the dict to the message's
constructor, REST renders it with `json_form`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.core.geometry.se3 import Matrix4
from revisit.core.scan import CloudReport
from revisit.service.application.catalogue.maps import MapView
from revisit.service.application.catalogue.paging import Page
from revisit.service.application.catalogue.robots import RobotView
from revisit.service.application.catalogue.sessions import SessionView
from revisit.service.application.contract.map_frames import MapPose, matrix_of
from revisit.service.application.contract.records import MapMergeRecord
from revisit.service.application.contract.views import OperationFailure, OperationView, SubmapView
from revisit.service.application.contract.webhooks import DeliveryRecord
from revisit.service.application.housekeeping.system import ServiceStatus
from revisit.service.application.ingest.scans import ScanAck
from revisit.service.application.ingest.submap_posting import PostedSubmap
from revisit.service.application.mapping.corrections import CorrectionView
from revisit.service.application.mapping.loop_decisions import LoopEventView, ProposedLoop
from revisit.service.application.mapping.versions import MapVersionView, SubmapPoseView
from revisit.service.application.push.events import EventView
from revisit.service.application.push.webhooks import CreatedWebhook, WebhookView
from revisit.service.application.query.loop_keypoints import KeypointPlan, LoopKeypoints
from revisit.service.application.query.loops import LoopClosureView
from revisit.service.application.query.search_answers import Localization, LocalizedCandidate, SearchHit, SearchResult

Fields: TypeAlias = dict[str, Any]
T = TypeVar("T")


def of_map(view: MapView) -> Fields:
    """The fields of a Map."""
    return {
        "name": f"maps/{view.map_id}",
        "display_name": view.display_name,
        "tau_m": view.tau_m,
        "stride_m": view.stride_m,
        "leave_distance_m": view.leave_distance_m,
        "scene_scale": view.scene_scale,
        "session_count": view.session_count,
        "submap_count": view.submap_count,
        "created_at_ns": view.created_at_ns,
        "loop_policy": asdict(view.loop_policy),
        "map_version": view.map_version,
    }


def of_robot(view: RobotView) -> Fields:
    """The fields of a Robot."""
    return {
        "name": f"robots/{view.robot_id}",
        "display_name": view.display_name,
        "created_at_ns": view.created_at_ns,
    }


def of_session(view: SessionView) -> Fields:
    """The fields of a Session."""
    return {
        "name": view.key.name,
        "robot": None if view.robot_id is None else f"robots/{view.robot_id}",
        "state": view.state.value,
        "committed_seq": view.committed_seq,
        "travelled_m": view.travelled_m,
        "submap_count": view.submap_count,
        "created_at_ns": view.created_at_ns,
        "finished_at_ns": view.finished_at_ns,
        "committed_stamp_ns": view.committed_stamp_ns,
        "findings": [asdict(finding) for finding in view.findings],
        "no_loops": None if view.no_loops is None else asdict(view.no_loops),
        "storey": view.storey,
    }


def of_operation(view: OperationView) -> Fields:
    """The fields of an Operation."""
    return {
        "name": f"operations/{view.operation_id}",
        "kind": view.kind.value,
        "state": view.state.value,
        "subject": view.subject,
        "attempts": view.attempts,
        "result": view.result,
        "failure": _failure(view.failure),
        "created_at_ns": view.created_at_ns,
        "finished_at_ns": view.finished_at_ns,
        "progress": None if view.progress is None else asdict(view.progress),
        "cancel_requested": view.cancel_requested,
    }


def of_submap(view: SubmapView) -> Fields:
    """The fields of a Submap."""
    return {
        "name": view.key.name,
        "seq": view.seq,
        "state": view.state.value,
        "ordinal": view.ordinal,
        "t_odom_submap": _transform(view.T_odom_submap),
        "position_m": vector_fields(view.position_m),
        "stamp_ns": view.stamp_ns,
        "first_seq": view.first_seq,
        "last_seq": view.last_seq,
        "scan_count": view.scan_count,
        "point_count": view.point_count,
        "raw_bytes": view.raw_bytes,
        "neural_map_bytes": view.neural_map_bytes,
        "flags": list(view.flags),
        "model_version": view.model_version,
        "failure": _failure(view.failure),
        "operation": f"operations/{view.operation_id}",
        "created_at_ns": view.created_at_ns,
        "place_descriptor": None if view.descriptor is None else view.descriptor.tolist(),
        **_in_map("t_map_submap", view.in_map),
    }


def of_posted(posted: PostedSubmap) -> Fields:
    """The fields of a PostSubmapResponse."""
    return {
        "submap": of_submap(posted.submap),
        "operation": of_operation(posted.operation),
        "replay": posted.replay,
        "report": _report(posted.report),
    }


def of_ack(ack: ScanAck) -> Fields:
    """The fields of an AppendScanResponse."""
    return {
        "committed_seq": ack.committed_seq,
        "replay": ack.replay,
        "report": _report(ack.report),
        "submap": None if ack.submap is None else of_posted(ack.submap),
    }


def of_loop(view: LoopClosureView) -> Fields:
    """The fields of a LoopClosure."""
    return {
        "name": view.name,
        "number": view.number,
        "query": view.query.name,
        "match": view.match.name,
        "state": view.state.value,
        "reason": view.reason,
        "similarity": view.similarity,
        "score": view.score,
        "t_match_query": _transform(view.T_match_query),
        "evidence": view.evidence,
        "created_at_ns": view.created_at_ns,
        "graph_state": None if view.graph_state is None else view.graph_state.value,
        "manual": view.manual,
        **_in_map("t_map_query", None if view.in_map is None else view.in_map.query),
        "t_map_match": _transform(matrix_of(None if view.in_map is None else view.in_map.match)),
    }


def of_proposed_loop(proposed: ProposedLoop) -> Fields:
    """The fields of a CreateLoopClosureResponse."""
    return {
        "loop_closure": of_loop(proposed.loop),
        "operation": of_operation(proposed.operation),
        "replay": proposed.replay,
    }


def of_loop_keypoints(view: LoopKeypoints) -> Fields:
    """The fields of a GetLoopClosureKeypointsResponse."""
    pairs = zip(view.pairs.tolist(), view.agrees.tolist(), strict=True)
    return {
        "query": _keypoint_plan(view.query),
        "match": _keypoint_plan(view.match),
        "pairs": [{"query": query, "match": match, "agrees": agrees} for (query, match), agrees in pairs],
    }


def _keypoint_plan(plan: KeypointPlan) -> Fields:
    x, y = plan.keypoints.T.round(3).tolist()
    return {"submap": plan.submap.name, "t_submap_level": _transform(plan.T_submap_level), "x": x, "y": y}


def of_loop_event(view: LoopEventView) -> Fields:
    """The fields of a LoopClosureEvent."""
    return {
        "number": view.number,
        "kind": view.kind.value,
        "state": view.state.value,
        "reason": view.reason,
        "graph_state": None if view.graph_state is None else view.graph_state.value,
        "t_match_query": _transform(view.T_match_query),
        "actor": view.actor,
        "note": view.note,
        "map_version": view.map_version,
        "details": view.details,
        "at_ns": view.at_ns,
    }


def of_map_version(view: MapVersionView) -> Fields:
    """The fields of a MapVersion."""
    return {
        "name": f"maps/{view.map_id}/versions/{view.version}",
        "version": view.version,
        "in_force": view.in_force,
        "restored_from": view.restored_from,
        "content_hash": view.content_hash,
        "operation": None if view.operation_id is None else f"operations/{view.operation_id}",
        "created_at_ns": view.created_at_ns,
        "summary": view.summary,
    }


def _covariance(covariance: NDArray[np.float32]) -> list[float]:
    """Its numbers; none where the graph does not tell them."""
    return covariance.ravel().tolist() if np.isfinite(covariance).all() else []


def of_submap_pose(view: SubmapPoseView) -> Fields:
    """The fields of a SubmapPose."""
    return {
        "submap": view.key.name,
        "t_map_submap": _transform(view.T_map_submap),
        "frame": view.frame,
        "covariance": _covariance(view.covariance),
    }


def of_map_merge(record: MapMergeRecord) -> Fields:
    """The fields of a MapMerge."""
    return {
        "name": f"maps/{record.map_id}/merges/{record.merge_id}",
        "source": record.source,
        "version_before": record.version_before,
        "version": record.version,
        "sessions": [f"maps/{record.map_id}/sessions/{name}" for name in record.sessions],
        "report": {name: value for name, value in record.report.items() if name != "changes"},
        "changes": [_change(one) for one in record.report["changes"]],
        "created_at_ns": record.created_at_ns,
        "reverted_at_ns": record.reverted_at_ns,
    }


def _change(change: Mapping[str, Any]) -> Fields:
    """The fields of a MapChange."""
    return {**change, "centre_m": vector_fields(change["centre_m"]), "extent_m": vector_fields(change["extent_m"])}


def of_correction(view: CorrectionView) -> Fields:
    """The fields of a Correction."""
    return {
        "session": view.session.name,
        "t_map_odom": _transform(view.T_map_odom),
        "frame": view.frame,
        "map_version": view.map_version,
        "covariance": _covariance(view.covariance),
        "created_at_ns": view.created_at_ns,
        "early_loops": view.early_loops,
    }


def of_event(view: EventView) -> Fields:
    """The fields of an Event."""
    return {
        "number": view.number,
        "kind": view.kind.value,
        "map": f"maps/{view.map_id}" if view.map_id else "",
        "loop_closure": None if view.loop is None else of_loop(view.loop),
        "operation": None if view.operation is None else of_operation(view.operation),
        "map_version": None if view.map_version is None else of_map_version(view.map_version),
    }


def of_webhook(view: WebhookView) -> Fields:
    """The fields of a Webhook."""
    return {
        "name": f"webhooks/{view.webhook_id}",
        "url": view.url,
        "map": f"maps/{view.map_id}" if view.map_id else "",
        "kinds": [kind.value for kind in view.kinds],
        "state": view.state.value,
        "told": view.told,
        "failures": view.failures,
        "created_at_ns": view.created_at_ns,
    }


def of_created_webhook(created: CreatedWebhook) -> Fields:
    """The fields of a CreateWebhookResponse."""
    return {"webhook": of_webhook(created.webhook), "secret": created.secret, "replay": created.replay}


def of_delivery(record: DeliveryRecord) -> Fields:
    """The fields of a WebhookDelivery."""
    return {
        "first_event": record.first_event,
        "last_event": record.last_event,
        "events": record.events,
        "attempt": record.attempt,
        "status": record.status,
        "error": record.error,
        "took_ms": record.took_ms,
        "at_ns": record.at_ns,
    }


def of_search(result: SearchResult) -> Fields:
    """The fields of a SearchSubmapsResponse."""
    hits = [_hit(hit) for hit in result.hits]
    return {"hits": hits, "searched": result.searched, "on_other_storeys": result.on_other_storeys}


def of_localization(result: Localization) -> Fields:
    """The fields of a LocalizeResponse."""
    return {
        "best": None if result.best is None else _candidate(result.best),
        "t_odom_query": _transform(result.T_odom_query),
        "session": None if result.session is None else result.session.name,
        "candidates": [_candidate(candidate) for candidate in result.candidates],
        **_in_map("t_map_query", result.in_map),
        "on_other_storeys": result.on_other_storeys,
    }


def of_status(status: ServiceStatus) -> Fields:
    """The fields of a GetStatusResponse."""
    return {
        "version": status.version,
        "model_version": status.model_version,
        "queued_jobs": status.queued_jobs,
        "running_jobs": status.running_jobs,
        "failed_jobs": status.failed_jobs,
        "indexed_submaps": status.indexed_submaps,
        "workers": [{"worker_id": w.worker_id, "model_version": w.model_version} for w in status.workers],
    }


def of_page(collection: str, page: Page[T], of: Callable[[T], Fields]) -> Fields:
    """The fields of a List...Response that holds `collection`."""
    return {collection: [of(item) for item in page.items], "next_page_token": page.next_token}


def vector_fields(values: Iterable[float]) -> Fields:
    """The fields of a Vector3."""
    x, y, z = (float(value) for value in values)
    return {"x": x, "y": y, "z": z}


def _transform(T_target_source: Matrix4 | None) -> Fields | None:
    if T_target_source is None:
        return None
    x, y, z, w = se3.to_quaternion(np.asarray(T_target_source)).tolist()
    return {"translation": vector_fields(T_target_source[:3, 3]), "rotation": {"x": x, "y": y, "z": z, "w": w}}


def _in_map(field: str, pose: MapPose | None) -> Fields:
    """A pose in the map as the fields that tell of it; None where there is none."""
    if pose is None:
        return {field: None, "frame": None, "map_version": None}
    return {field: _transform(matrix_of(pose)), "frame": pose.frame, "map_version": pose.map_version}


def _failure(failure: OperationFailure | None) -> Fields | None:
    return None if failure is None else {"reason": failure.code, "message": failure.message}


def _report(report: CloudReport | None) -> Fields | None:
    if report is None:
        return None
    return {"dropped_nonfinite": report.dropped_nonfinite, "degenerate_plane": report.degenerate_plane}


def _hit(hit: SearchHit) -> Fields:
    return {
        "submap": hit.submap.name,
        "similarity": hit.similarity,
        "position_m": vector_fields(hit.position_m),
        **_in_map("t_map_submap", hit.in_map),
    }


def _candidate(candidate: LocalizedCandidate) -> Fields:
    return {
        "submap": candidate.submap.name,
        "accepted": candidate.accepted,
        "reason": candidate.reason,
        "similarity": candidate.similarity,
        "score": candidate.score,
        "t_match_query": _transform(candidate.T_match_query),
        "evidence": candidate.evidence,
    }
