"""The OpenAPI document and the service agree: generated requests get documented answers, never a server error."""

from __future__ import annotations

import json
import os
from pathlib import Path

import httpx
import pytest
import schemathesis
import structlog
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from schemathesis.checks import not_a_server_error
from schemathesis.generation import GenerationMode
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    negative_data_rejection,
    response_schema_conformance,
    status_code_conformance,
)

from revisit import Client
from revisit.formats import MEDIA_TYPES
from tests.support.cloud_files import records, valid_files
from tests.support.patience import PATIENCE_S
from tests.support.service_world import cloud_points, pose

# Per operation, half of them as the document says and half against it.
EXAMPLES = int(os.environ.get("REVISIT_SCHEMATHESIS_EXAMPLES", "6"))


def no_server_error(ctx, response, case):
    """No 5xx, except what is documented for a `min_seq` that no submap has yet."""
    if response.status_code == 504 and response.json()["reason"] in ("SEQ_NOT_REACHED", "NO_ANSWER"):
        return None
    return not_a_server_error(ctx, response, case)


AGREES = [no_server_error, status_code_conformance, content_type_conformance, response_schema_conformance]
DOCUMENT = json.loads((Path(__file__).resolve().parents[3] / "docs/reference/openapi.json").read_text())
ENDLESS = {"/v1/maps/{map_id}/events"}
"""Answers that go on until the client ends them; test_api_events asks for these."""
POSE = "1,2,3,0,0,0,1"
GOOD_CLOUDS = dict(valid_files(records(300)).values())


def operations():
    """Every operation of the document by name; clouds are sent as the bytes they are.

    The service asked is an open one, so a request without a key is none against the document.
    """
    for media_type in MEDIA_TYPES:
        schemathesis.serializer(media_type)(lambda context, value: value)
    paths = {
        path: {method: {**operation, "security": []} for method, operation in methods.items()}
        for path, methods in DOCUMENT["paths"].items()
        if path not in ENDLESS
    }
    schema = schemathesis.openapi.from_dict({**DOCUMENT, "paths": paths})
    return {f"{o.method.upper()} {o.path}": o for o in (result.ok() for result in schema.get_all_operations())}


OPERATIONS = operations()
# What has no query and no body cannot be asked wrongly but for ids, and any text may be an unknown id.
FALLIBLE = [name for name, operation in OPERATIONS.items() if operation.query or operation.body]


@pytest.fixture(scope="module")
def service(sqlite_service):
    return sqlite_service


@pytest.fixture(scope="module")
def existing(service):
    """A described submap with its session and map, a robot and an operation: ids of path parameters."""
    with Client(service.http) as client:
        session = client.create_session(client.create_map("town"), "monday")
        operation = client.wait(client.post_submap(session, "a", cloud_points(1), pose(), 1))
        client.create_robot("rover")
    operation_id = operation.name.rpartition("/")[2]
    return {
        "map_id": "town",
        "session_id": "monday",
        "submap_id": "a",
        "robot_id": "rover",
        "operation_id": operation_id,
    }


def lead_somewhere(case, existing):
    """Ids that exist, a pose that is one, and a cloud that is one, so that the answer is not always a refusal."""
    case.path_parameters.update({name: existing[name] for name in case.path_parameters if name in existing})
    case.query.update({name: POSE for name in ("T_odom_submap", "T_odom_sensor") if name in case.query})
    if case.media_type in GOOD_CLOUDS:
        case.body = GOOD_CLOUDS[case.media_type]


def generated(operation, mode, examples):
    """Decorates a test with generated requests."""

    def decorate(test):
        limits = settings(
            max_examples=examples,
            deadline=None,
            database=None,
            suppress_health_check=list(HealthCheck),
        )
        return limits(given(case=operation.as_strategy(generation_mode=mode), known=st.booleans())(test))

    return decorate


@pytest.mark.parametrize("name", OPERATIONS)
def test_every_request_that_fits_the_document_gets_a_documented_answer(name, service, existing):
    @generated(OPERATIONS[name], GenerationMode.POSITIVE, EXAMPLES // 2 if name in FALLIBLE else EXAMPLES)
    def check(case, known):
        if known and case.method != "DELETE":
            lead_somewhere(case, existing)
        case.call_and_validate(base_url=service.http, checks=AGREES, timeout=PATIENCE_S)

    with structlog.testing.capture_logs() as logs:
        check()
    assert [entry for entry in logs if entry["log_level"] == "error"] == []


@pytest.mark.parametrize("name", FALLIBLE)
def test_every_request_against_the_document_is_refused_as_documented(name, service):
    before = service.stored()

    @generated(OPERATIONS[name], GenerationMode.NEGATIVE, EXAMPLES // 2)
    def check(case, known):
        case.call_and_validate(base_url=service.http, checks=[*AGREES, negative_data_rejection], timeout=PATIENCE_S)

    check()
    assert service.stored() == before


def test_every_status_of_the_error_table_is_documented_for_every_operation(service):
    document = httpx.get(f"{service.http}/openapi.json", trust_env=False).json()
    for path in document["paths"].values():
        for operation in path.values():
            assert {"400", "404", "409", "413", "415", "422", "429", "500", "503", "504", "507"} <= operation[
                "responses"
            ].keys()
            assert "default" not in operation["responses"]
