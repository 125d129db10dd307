"""A search by JSON is answered the same with and without a query string, which leads it through all of FastAPI."""

from __future__ import annotations

import httpx
import pytest

from revisit.api.scopes import Scope
from tests.support.credentials import a_key, bearer
from tests.support.service_world import cloud_points, pose

BODIES = {
    "by submap": ('{"submap": "%s"}', 200),
    "few hits": ('{"submap": "%s", "k": 1}', 200),
    "by descriptor": ('{"descriptor": [1.0, 0.0], "model_version": "another"}', 409),
    "neither": ("{}", 422),
    "both": ('{"submap": "%s", "descriptor": [1.0], "model_version": "1"}', 422),
    "k too large": ('{"submap": "%s", "k": 101}', 422),
    "no such field": ('{"submap": "%s", "K": 1}', 422),
    "no json": ("{", 400),
    "twice the same": ('{"k": 1, "k": 2}', 400),
    "no such submap": ('{"submap": "maps/a/sessions/b/submaps/c"}', 422),
}


@pytest.fixture
def http(service):
    with httpx.Client(base_url=service.http, trust_env=False) as opened:
        yield opened


def told(http, path, body, media_type="application/json; charset=utf-8"):
    """Status and JSON of the answer, without the id of the request."""
    answer = http.post(path, content=body, headers={"content-type": media_type})
    return answer.status_code, {key: value for key, value in answer.json().items() if key != "request_id"}


@pytest.mark.parametrize("case", BODIES)
def test_both_ways_answer_alike(http, client, session, town, case):
    posted = [client.post_submap(session, name, cloud_points(1), pose(), 1) for name in ("a", "b")]
    for operation in posted:
        client.wait(operation)
    body, status = BODIES[case]
    body = body.replace("%s", f"{session.name}/submaps/a")
    path = f"/v1/{town}/submaps:search"
    answer = told(http, path, body)
    assert answer == told(http, f"{path}?k=20", body)
    assert answer[0] == status
    if case == "few hits":
        assert [hit["submap"] for hit in answer[1]["hits"]] == [f"{session.name}/submaps/b"]


def test_a_long_id_and_a_query_string_are_judged_as_before(http, town):
    body = '{"submap": "maps/a/sessions/b/submaps/c"}'
    paths = (f"/v1/{town}/submaps:search?k=many", f"/v1/maps/{'m' * 201}/submaps:search")
    assert [told(http, path, body)[1]["reason"] for path in paths] == ["BAD_FIELD"] * 2


def test_who_may_not_search_is_refused_both_ways(guarded, guarded_http):
    held = bearer(a_key(guarded.world, scopes=frozenset({Scope.INGEST})))
    for path in ("/v1/maps/a/submaps:search", "/v1/maps/a/submaps:search?k=20"):
        assert guarded_http.post(path, json={"submap": "x"}).status_code == 401
        assert guarded_http.post(path, json={"submap": "x"}, headers=held).status_code == 403
