"""One wire form: what REST renders from a view is the JSON that protobuf defines for the message of gRPC."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from google.protobuf.json_format import MessageToDict, ParseDict
from google.protobuf.struct_pb2 import Struct

from revisit.core.geometry.se3 import pose_row
from revisit.core.pose_graph.graph import GraphState
from revisit.core.scan import CloudReport
from revisit.sdk import json_answers
from revisit.service.calls import catalogue, ingest, loops, mapping, operations, search
from revisit.service.domain.identity import SubmapKey
from revisit.service.domain.loop_policy import LoopPolicy
from revisit.service.features.catalogue.maps import MapView
from revisit.service.features.catalogue.sessions import SessionView
from revisit.service.features.corrections.calls import CorrectionView
from revisit.service.features.graph.map_frames import LoopInMap, MapPose
from revisit.service.features.index.answers import Localization, LocalizedCandidate, SearchHit, SearchResult
from revisit.service.features.ingest.appending import ScanAck
from revisit.service.features.ingest.posting import PostedSubmap
from revisit.service.features.loops.calls import LoopClosureView
from revisit.service.features.optimisation.calls import MapVersionView, SubmapPoseView
from revisit.service.features.resources.paging import Page
from revisit.service.features.resources.views import SubmapView
from revisit.service.wire import openapi
from revisit.service.wire.json_form import json_form
from revisit.service.wire.rendering import Listed
from revisit.v1 import (
    ingest_pb2,
    loop_closure_pb2,
    map_pb2,
    mapping_pb2,
    operation_pb2,
    robot_pb2,
    session_pb2,
    submap_pb2,
)
from tests.support.records import a_job, a_loop, a_map, a_robot, a_session, a_submap

SUBMAP_KEY, LARGE = SubmapKey("town", "monday", "a"), 2**62 + 1
EVIDENCE = {
    "rmse_m": 0.1,
    "inliers": 12,
    "covariance": [[1e-3, 0.0], [0.0, 2.5]],
    "nested": {"yes": True, "none": None},
}
FAILURE = {"failure_code": "UNUSABLE_CLOUD", "failure_message": "one line"}
POSE = np.array([[0.0, -1, 0, 1.5], [1, 0, 0, -2], [0, 0, 1, 0.25], [0, 0, 0, 1]])
MAP = MapView(**vars(a_map()), session_count=3, submap_count=70_000, loop_policy=LoopPolicy(5, 0.5, 0.25, 0.0))
IN_MAP = MapPose(pose_row(POSE), "frame-1", LARGE)
NEW = SessionView(**vars(a_session("new")), submap_count=0, committed_stamp_ns=None)
SESSION = replace(NEW, robot_id="rover", state="FINISHED", committed_seq=LARGE, finished_at_ns=LARGE, submap_count=2)
QUEUED = a_job()
FAILED = a_job(kind="LOCALIZE", state="FAILED", attempts=3, result={}, finished_at_ns=LARGE, **FAILURE)
DONE = a_job(kind="SEARCH_CLOUD", state="DONE", result=EVIDENCE, progress={"stage": "COMMIT", "done": 1, "total": 2})
RUNNING = replace(DONE, state="RUNNING", result=None)
SCANNED = SubmapView(
    **vars(a_submap(first_seq=1, last_seq=LARGE, T_odom_submap=pose_row(POSE), neural_map_bytes=900, number=LARGE)),
    place_descriptor=np.array([0.5, -0.25], dtype=np.float32),
)
UNDESCRIBED = SubmapView.of(a_submap(state="FAILED", **FAILURE))
POSTED = PostedSubmap(SCANNED, QUEUED, False, CloudReport(4, True))
ACCEPTED = LocalizedCandidate(SUBMAP_KEY, True, None, 0.9, 0.8, POSE, EVIDENCE)
REJECTED = LocalizedCandidate(SUBMAP_KEY, False, "LOW_SCORE", -0.5, 0.0, None, {})
LOOP = LoopClosureView.of(a_loop(1, 2))
PLACED_LOOP = replace(LOOP, graph_state=GraphState.IN_MAP, manual=True, in_map=LoopInMap(IN_MAP, IN_MAP))
SUMMARY = {
    "sessions": 2, "submaps": 60, "frames": 1, "loops_in_map": 10, "loops_set_aside": 4, "loops_unconnected": 0,
    "chi2": 61.5, "degrees_of_freedom": 60, "mean_change_m": 0.0, "max_change_m": None,
    "refused_joins": [{
        "sessions": ["maps/town/sessions/a"], "other_sessions": ["maps/town/sessions/b", "maps/town/sessions/c"],
        "reason": "OVERLAP_TOO_SMALL", "loops": 3, "common_points": 0, "seen_through_share": 0.0,
        "worst_stretch_share": 0.0,
    }],
}  # fmt: skip
COVARIANCE = (np.arange(36, dtype=np.float32) / 4).reshape(6, 6)


def of_page(collection, page, of):
    return Listed(collection, page, of).fields()


ANSWERS = {
    "a map": (map_pb2.Map, catalogue.map_fields(MAP)),
    "a robot": (robot_pb2.Robot, catalogue.robot_fields(a_robot())),
    "a finished session": (session_pb2.Session, catalogue.session_fields(SESSION)),
    "a new session": (session_pb2.Session, catalogue.session_fields(NEW)),
    "an operation that runs": (operation_pb2.Operation, operations.operation_fields(RUNNING)),
    "an operation that waits": (operation_pb2.Operation, operations.operation_fields(QUEUED)),
    "an operation that failed": (operation_pb2.Operation, operations.operation_fields(FAILED)),
    "an operation that is done": (operation_pb2.Operation, operations.operation_fields(DONE)),
    "a described submap of scans": (submap_pb2.Submap, catalogue.submap_fields(SCANNED)),
    "a submap that failed": (submap_pb2.Submap, catalogue.submap_fields(UNDESCRIBED)),
    "a post": (submap_pb2.PostSubmapResponse, ingest.posted_fields(POSTED)),
    "a scan that completed a submap": (
        ingest_pb2.AppendScanResponse,
        ingest.ack_fields(ScanAck(LARGE, False, CloudReport(0, False), POSTED)),
    ),
    "a scan again": (ingest_pb2.AppendScanResponse, ingest.ack_fields(ScanAck(3, True, None, None))),
    "hits": (
        loop_closure_pb2.SearchSubmapsResponse,
        search.search_fields(SearchResult((SearchHit(SUBMAP_KEY, 0.75, (1.0, 2.0, 3.0)),), 9)),
    ),
    "a hit in the map": (
        loop_closure_pb2.SearchSubmapsResponse,
        search.search_fields(SearchResult((SearchHit(SUBMAP_KEY, 0.75, (1.0, 2.0, 3.0), IN_MAP),), 9)),
    ),
    "a submap in the map": (submap_pb2.Submap, catalogue.submap_fields(replace(SCANNED, in_map=IN_MAP))),
    "a place in the map": (
        loop_closure_pb2.LocalizeResponse,
        search.localization_fields(Localization(ACCEPTED, POSE, (ACCEPTED,), IN_MAP)),
    ),
    "a loop": (loop_closure_pb2.LoopClosure, loops.loop_fields(LOOP)),
    "a loop in the map": (loop_closure_pb2.LoopClosure, loops.loop_fields(PLACED_LOOP)),
    "a version of a map": (
        mapping_pb2.MapVersion,
        mapping.version_fields(MapVersionView("town", 4, True, None, "hash", "op-1", SUMMARY, LARGE, 1)),
    ),
    "a version that came back": (
        mapping_pb2.MapVersion,
        mapping.version_fields(MapVersionView("town", 5, False, 3, "hash", None, SUMMARY, LARGE, 1)),
    ),
    "a correction": (
        mapping_pb2.Correction,
        mapping.correction_fields(CorrectionView(SUBMAP_KEY.session, POSE, "frame-1", 4, COVARIANCE, LARGE)),
    ),
    "poses": (
        mapping_pb2.ListSubmapPosesResponse,
        of_page(
            "submap_poses",
            Page((SubmapPoseView(SUBMAP_KEY, POSE, "frame-1", COVARIANCE, 1),), ""),
            mapping.submap_pose_fields,
        ),
    ),
    "no hits": (loop_closure_pb2.SearchSubmapsResponse, search.search_fields(SearchResult((), 0))),
    "a known place": (
        loop_closure_pb2.LocalizeResponse,
        search.localization_fields(Localization(ACCEPTED, POSE, (REJECTED, ACCEPTED))),
    ),
    "an unknown place": (
        loop_closure_pb2.LocalizeResponse,
        search.localization_fields(Localization(None, None, (REJECTED,))),
    ),
    "a page": (
        loop_closure_pb2.ListLoopClosuresResponse,
        of_page("loop_closures", Page((LOOP, LOOP), "next"), loops.loop_fields),
    ),
    "an empty page": (map_pb2.ListMapsResponse, of_page("maps", Page((), ""), catalogue.map_fields)),
}


@pytest.mark.parametrize("case", ANSWERS)
def test_the_json_of_an_answer_is_the_json_of_its_message(case):
    kind, fields = ANSWERS[case]
    message, rendered = kind(**fields), json.loads(json.dumps(json_form(kind, fields)))
    assert ParseDict(rendered, kind()) == message
    assert rendered == MessageToDict(
        message, preserving_proto_field_name=True, always_print_fields_with_no_presence=True
    )


@pytest.mark.parametrize("case", ANSWERS)
def test_the_client_reads_the_json_of_an_answer_as_the_reference_does(case, monkeypatch):
    kind, fields = ANSWERS[case]
    rendered = json.loads(json.dumps(json_form(kind, fields)))
    monkeypatch.setattr(json_answers, "ParseDict", parse_of_struct_alone)
    assert json_answers.message_of(kind, rendered) == ParseDict(rendered, kind())


def parse_of_struct_alone(value, message):
    assert isinstance(message, Struct), "read by the reference itself"
    return ParseDict(value, message)


@pytest.mark.parametrize("case", ANSWERS)
def test_an_answer_names_every_field_of_its_message(case):
    kind, fields = ANSWERS[case]
    assert fields.keys() == {field.name for field in kind.DESCRIPTOR.fields}


def test_64_bit_integers_are_text_and_absent_fields_are_left_out():
    rendered = json_form(session_pb2.Session, {"name": "s", "committed_seq": 2**63 - 1, "submap_count": 2**31})
    assert (rendered["committed_seq"], rendered["submap_count"]) == ("9223372036854775807", 2**31)
    assert (rendered["created_at_ns"], rendered["robot"], rendered["state"]) == ("0", "", "STATE_UNSPECIFIED")
    assert not {"finished_at_ns", "committed_stamp_ns"} & rendered.keys()


@pytest.mark.parametrize(("number", "text"), [(math.nan, "NaN"), (math.inf, "Infinity"), (-math.inf, "-Infinity")])
def test_numbers_that_json_lacks_are_text(number, text):
    rendered = json_form(loop_closure_pb2.LoopClosure, {"score": number})
    assert rendered["score"] == MessageToDict(loop_closure_pb2.LoopClosure(score=number))["score"] == text


def test_a_field_that_the_message_does_not_have_is_a_defect():
    with pytest.raises(KeyError, match=r"revisit\.v1\.Robot has no field colour"):
        json_form(robot_pb2.Robot, {"colour": "red"})


def test_openapi_requires_what_is_always_there_and_describes_it_with_the_comments_of_the_proto():
    described = openapi.schemas([submap_pb2.PostSubmapResponse])
    assert described.keys() == {
        "CloudReport", "Failure", "Operation", "OperationProgress", "PostSubmapResponse", "Quaternion", "Submap",
        "Transform", "Vector3",
    }  # fmt: skip
    submap = described["Submap"]
    assert {"name", "flags", "model_version"} <= set(submap["required"])
    assert not {"first_seq", "failure", "t_odom_submap"} & set(submap["required"])
    assert submap["properties"]["seq"]["type"] == "string"
    assert submap["properties"]["state"]["enum"] == ["QUEUED", "DESCRIBED", "FAILED", "RETIRED"]
    assert submap["properties"]["ordinal"]["description"] == "Counts the submaps of its session from 0."


def test_a_version_that_was_stored_with_less_than_no_degrees_of_freedom_is_read():
    """A map of one drive that a known pose held had -1."""
    view = MapVersionView("town", 4, True, None, "hash", "op-1", SUMMARY | {"degrees_of_freedom": -1}, LARGE, 1)
    read = ParseDict(json_form(mapping_pb2.MapVersion, mapping.version_fields(view)), mapping_pb2.MapVersion())
    assert read.summary.degrees_of_freedom == 0
