"""Wrong input gets the documented error on both transports and stores nothing (reliability: G, T, I, Q rows)."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest

from revisit import ApiError, Cloud
from revisit.formats import NPY, QUANTISED, encode_npy, encode_quantised
from revisit.sdk.errors import InvalidArgument
from revisit.v1 import map_pb2
from tests.support.service_world import cloud_points, pose

GOOD = cloud_points(1)
QUANTISED_GOOD = encode_quantised(GOOD)


BAD_CLOUDS = {
    "no points": (Cloud(encode_npy(GOOD[:0]), NPY), "UNUSABLE_CLOUD"),
    "truncated": (Cloud(QUANTISED_GOOD[:-9], QUANTISED), "MALFORMED_BODY"),
    "4 billion points": (
        Cloud(QUANTISED_GOOD[:4] + struct.pack("<I", 2**32 - 1) + QUANTISED_GOOD[8:], QUANTISED),
        "TOO_LARGE",
    ),
    "an unknown content type": (Cloud(GOOD.tobytes(), "application/x-unheard-of"), "UNSUPPORTED_ENCODING"),
}
"""A few of those of tests/corpus, for what the SDK makes of a refusal."""


@pytest.mark.parametrize("case", BAD_CLOUDS)
def test_a_bad_cloud_is_refused_for_its_reason_and_nothing_is_stored(case, client, session, service):
    cloud, reason = BAD_CLOUDS[case]
    before = service.stored()
    with pytest.raises(ApiError) as refused:
        client.post_submap(session, "bad", cloud, pose(), 1)
    assert refused.value.reason == reason
    assert refused.value.code in ("INVALID_ARGUMENT", "RESOURCE_EXHAUSTED")
    assert not refused.value.retryable
    assert refused.value.request_id
    assert service.stored() == before


def test_a_cloud_with_a_few_missing_returns_is_accepted_without_them(client, session):
    points = GOOD.copy()
    points[:15] = np.nan
    operation = client.post_submap(session, "holes", points, pose(), 1)
    assert client.get_submap(operation.subject).point_count == 285


def test_the_same_submap_again_answers_again_and_another_cloud_is_a_conflict(client, session, service):
    first = client.post_submap(session, "twice", GOOD, pose(), 1)
    before = service.stored()
    assert client.post_submap(session, "twice", GOOD, pose(), 1).name == first.name
    with pytest.raises(ApiError) as refused:
        client.post_submap(session, "twice", cloud_points(2), pose(), 1)
    assert (refused.value.code, refused.value.reason) == ("ALREADY_EXISTS", "ALREADY_EXISTS")
    with pytest.raises(ApiError, match="ALREADY_EXISTS"):
        client.post_submap(session, "twice", GOOD, pose(0.001), 1)
    assert service.stored() == before


def test_the_sdk_refuses_a_reflection_before_it_is_sent(client, session):
    with pytest.raises(ApiError, match=r"BAD_FIELD.*reflection"):
        client.post_submap(session, "mirror", GOOD, np.diag([1.0, 1.0, -1.0, 1.0]), 1)


@pytest.mark.parametrize(
    ("vector", "version"),
    [([1.0, 2.0], "fake-1"), ([0.0] * 64, "fake-1"), ([1.0] * 64, "another-model"), ([], "fake-1")],
)
def test_a_descriptor_that_cannot_be_compared_is_refused(vector, version, client, session, town):
    client.wait(client.post_submap(session, "a", GOOD, pose(), 1))
    with pytest.raises(ApiError) as refused:
        client.search(town, descriptor=vector, model_version=version)
    assert refused.value.reason in ("BAD_FIELD", "DESCRIPTOR_MODEL_MISMATCH")


def test_a_session_and_a_submap_with_an_id_outside_the_alphabet_are_refused(client, session, town, service):
    before = service.stored()
    for create in (
        lambda: client.create_session(town, "a b"),
        lambda: client.post_submap(session, "a b", GOOD, pose(), 1),
    ):
        with pytest.raises(ApiError) as refused:
            create()
        assert (refused.value.code, refused.value.reason) == ("INVALID_ARGUMENT", "BAD_FIELD")
    assert service.stored() == before


UNKNOWN = [
    "maps/nowhere",
    "maps/nowhere/sessions/s",
    "maps/nowhere/sessions/s/submaps/a",
    "maps/nowhere/loopClosures/l",
    "operations/op-nothing",
    "robots/nobody",
]


@pytest.mark.parametrize("name", UNKNOWN)
def test_what_does_not_exist_is_not_found(name, client):
    groups = {"submaps": client.submaps, "sessions": client.sessions, "loopClosures": client.loops, "maps": client.maps}
    groups |= {"operations": client.operations, "robots": client.robots}
    with pytest.raises(ApiError) as refused:
        groups[name.split("/")[-2]].get(name)
    assert (refused.value.code, refused.value.reason, refused.value.retryable) == ("NOT_FOUND", "NOT_FOUND", False)


def test_writing_into_what_does_not_exist_is_not_found_and_nothing_is_stored(client, town, service):
    before = service.stored()
    for call in (
        lambda: client.create_session("maps/nowhere", "s"),
        lambda: client.create_session(town, "s", robot="robots/nobody"),
        lambda: client.post_submap("maps/nowhere/sessions/s", "a", GOOD, pose(), 1),
        lambda: client.search("maps/nowhere", points=GOOD),
        lambda: client.localize("maps/nowhere", GOOD),
        lambda: client.delete("maps/nowhere"),
        lambda: client.loop_closures("maps/nowhere"),
        lambda: client.finish_session("maps/nowhere/sessions/s"),
        lambda: client.list_submaps("maps/nowhere/sessions/s"),
    ):
        with pytest.raises(ApiError, match="NOT_FOUND"):
            call()
    assert service.stored() == before


def test_a_finished_session_takes_nothing_more(client, session, service):
    client.finish_session(session)
    before = service.stored()
    with pytest.raises(ApiError) as refused:
        client.post_submap(session, "late", GOOD, pose(), 1)
    assert (refused.value.code, refused.value.reason) == ("FAILED_PRECONDITION", "SESSION_FINISHED")
    assert service.stored() == before


def test_a_submap_that_is_not_described_yet_has_no_mesh(client, session, service):
    service.working.clear()
    try:
        client.post_submap(session, "waiting", GOOD, pose(), 1)
        with pytest.raises(ApiError) as refused:
            client.download(f"{session.name}/submaps/waiting", "mesh")
    finally:
        service.working.set()
    assert (refused.value.code, refused.value.reason) == ("FAILED_PRECONDITION", "NOT_READY")


FOREIGN_TOKENS = [
    "forged",
    "YWZ0ZXI6MQ",
    "!YWZ0ZXI6MQ==",
    "YWZ0ZXI6LTE=",
    "\u00e9",
    "YWZ0ZXI6MQ==" + "=" * 200,
    "A" * 22 + "==",
]


@pytest.mark.parametrize("token", FOREIGN_TOKENS)
def test_a_foreign_page_token_is_refused(token, client):
    with pytest.raises(ApiError) as refused:
        client._transport.call("ListMaps", map_pb2.ListMapsRequest(page_token=token))
    assert (refused.value.reason, refused.value.field) == ("BAD_FIELD", "page_token")


def by_descriptor(client, town, **criteria):
    return client.search(town, descriptor=[1.0], model_version="fake-1", **criteria)


def near(client, town, radius_m):
    return client.localize(town, GOOD, prior_position_m=(0, 0, 0), radius_m=radius_m)


def pages_of(client, page_size):
    return client._transport.call("ListMaps", map_pb2.ListMapsRequest(page_size=page_size))


OUT_OF_BOUNDS = {
    **{f"by cloud, k {k}": ("k", lambda c, m, k=k: c.search(m, points=GOOD, k=k)) for k in (0, -1, 101, 2 * 10**9)},
    **{f"by descriptor, k {k}": ("k", lambda c, m, k=k: by_descriptor(c, m, k=k)) for k in (0, -1, 101, 2 * 10**9)},
    **{f"radius {r}": ("radius_m", lambda c, m, r=r: near(c, m, r)) for r in (-1.0, 0.0, 1e30)},
    **{f"pages of {size}": ("page_size", lambda c, m, size=size: pages_of(c, size)) for size in (-1, 501)},
    "similarity 1.5": ("min_similarity", lambda c, m: by_descriptor(c, m, min_similarity=1.5)),
    "left by 10001 m": ("leave_distance_m", lambda c, m: by_descriptor(c, m, leave_distance_m=10_001)),
    "101 candidates": ("candidates", lambda c, m: c.localize(m, GOOD, candidates=101)),
    "tau_m 0.05": ("tau_m", lambda c, m: c.create_map("short", tau_m=0.05)),
    "a name of 257 characters": ("display_name", lambda c, m: c.create_map("long", display_name="x" * 257)),
    "waiting 61 s": ("min_seq_timeout_s", lambda c, m: c.loop_closures(m, min_seq=1, min_seq_timeout_s=61.0)),
}
MISTYPED = {
    "an unknown state of loops": ("state", lambda client, town: client.loop_closures(town, state="CLOSED")),
    "an unknown state of operations": ("state", lambda client, town: client.list_operations(state="ACCEPTED")),
    "an unknown criterion": ("min_similarty", lambda client, town: client.search(town, points=GOOD, min_similarty=0.5)),
    "text for a number": ("radius_m", lambda client, town: client.search(town, points=GOOD, radius_m="near")),
    "no number": ("min_similarity", lambda client, town: client.search(town, points=GOOD, min_similarity=math.nan)),
    "half a submap": ("k", lambda client, town: client.search(town, points=GOOD, k=1.5)),
    "more than an integer holds": ("k", lambda client, town: client.search(town, points=GOOD, k=2**40)),
    "two coordinates": (
        "prior_position_m",
        lambda c, m: c.localize(m, GOOD, prior_position_m=[1, 2], radius_m=1),
    ),
    "an unknown format": ("format", lambda client, town: client.download(f"{town}/sessions/monday/submaps/a", "las")),
    "left by less than nothing": (
        "leave_distance_m",
        lambda client, town: client.create_map("gap", leave_distance_m=-1),
    ),
}


@pytest.mark.parametrize("case", {**OUT_OF_BOUNDS, **MISTYPED})
def test_what_is_out_of_bounds_or_mistyped_is_named_alike_over_both_transports(case, client, session, town):
    field, call = {**OUT_OF_BOUNDS, **MISTYPED}[case]
    with pytest.raises(InvalidArgument) as refused:
        call(client, town)
    assert (refused.value.reason, refused.value.field) == ("BAD_FIELD", field)


def test_a_failed_operation_says_why(client, session):
    # 668 points are what the fake recogniser cannot describe.
    operation = client.post_submap(session, "dull", cloud_points(1, 668), pose(), 1)
    with pytest.raises(ApiError) as failed:
        client.wait(operation)
    assert failed.value.reason == "UNUSABLE_CLOUD"
    assert client.get_submap(operation.subject).state == "FAILED"
