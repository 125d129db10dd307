"""What belongs to another tenant looks like what does not exist, in every route and RPC (row A04)."""

from __future__ import annotations

import re
from dataclasses import replace

import grpc
import httpx
import numpy as np
import pytest
from google.protobuf.message_factory import GetMessageClass

from revisit import Client
from revisit.api.calls import CALLS
from revisit.formats import QUANTISED, encode_quantised
from revisit.sdk.anchors import NewAnchor
from revisit.sdk.radio import RadioReading
from revisit.sdk.retry import RetryPolicy
from revisit.service.rest.app import create_app
from tests.support.credentials import a_key, bearer
from tests.support.fake_merger import EasyMerger
from tests.support.live_service import live_service
from tests.support.made_pictures import a_png
from tests.support.patience import PATIENCE_S
from tests.support.service_world import cloud_points, memory_world

REQUEST_ID = {"x-request-id": "fixed"}
CLOUD = encode_quantised(cloud_points(1))
POSE = "0,0,0,0,0,0,1"
AROUND = {"centre_m": "0,0,0", "within_m": 9}
QUERY = {"submap_id": "new", "stamp_ns": 1, "T_odom_submap": POSE, "format": "ply", "timeout_s": 0, **AROUND}
QUERY |= {"plan_id": "new", "pins": ["0,0,0,0", "9,0,9,0"]}
OF_SUBMAP = {"robot": "rover", "map": "town", "session": "monday", "submap": "a"}
UNIVERSE = {**OF_SUBMAP, "version": "1", "webhook": "hook", "tile": "frame-1.0.0", "anchor": "door", "plan": "ground"}


DOOR = NewAnchor("door", "CONTROL_POINT", 1, np.eye(3), local_m=(0.0, 0.0, 0.0), T_odom_sensor=np.eye(4))


def rest_calls():
    """Every call of the OpenAPI document that names a resource: in its path, or in its body."""
    for path, methods in create_app(memory_world().use_cases).openapi()["paths"].items():
        if "{" in path or path.endswith("/webhooks"):
            yield from ((method, path) for method in methods if "{" in path or method == "post")


NAMELESS = {
    *("CreateMap", "CreateRobot", "ListMaps", "ListRobots", "ListWebhooks", "ListOperations", "GetStatus"),
}
"""The calls whose requests name no resource that there is."""


def rpcs():
    """Every RPC whose request names a resource."""
    return [call.method for name, call in CALLS.items() if name not in NAMELESS]


@pytest.fixture(scope="module")
def answers():
    """What a stranger is told about ids, before and after another tenant has them."""
    world = memory_world()
    world.merger = EasyMerger()
    owner, stranger = a_key(world, "owner"), a_key(world, "stranger")
    once = RetryPolicy(attempts=1)
    with (
        live_service(world) as running,
        httpx.Client(base_url=running.http, trust_env=False, headers={**bearer(stranger), **REQUEST_ID}) as http,
        grpc.insecure_channel(running.grpc) as channel,
        Client(running.http, api_key=owner.text, retry=once) as client,
    ):
        metadata = tuple({**bearer(stranger), **REQUEST_ID}.items())
        guessed = {**UNIVERSE, "operation": "op-guess", "loop": "loop-guess", "merge": "merge-guess"}
        before = ask(http, channel, metadata, guessed)
        real = fill(client)
        after = ask(http, channel, metadata, real)
        yield before, {key: renamed(answer, real, guessed) for key, answer in after.items()}, client, real


def fill(client):
    """The owner's resources; their ids, those that the service gave out too."""
    client.create_robot("rover")
    session = client.create_session(client.create_map("town", leave_distance_m=0), "monday")
    for number, name in enumerate("ab"):
        operation = client.post_submap(session, name, cloud_points(1), np.eye(4), number + 1)
        client.wait(operation)
    client.sessions.post_anchors(session, [DOOR])
    client.wait(client.optimise_map("maps/town"))
    annex = client.create_session(client.create_map("annex", leave_distance_m=0), "tuesday")
    for number, name in enumerate("cd"):
        client.wait(client.post_submap(annex, name, cloud_points(1), np.eye(4), number + 1))
    merge = client.wait(client.merge_map("maps/town", "maps/annex")).result["merge"].rpartition("/")[2]
    client.wait(client.publish_map("maps/town/versions/1"))
    client.download_tile(client.map_tiles("maps/town/versions/1")[0], "mesh")
    client.plans.create("maps/town", "ground", PICTURE, [((0, 0), (0.0, 0.0)), ((9, 0), (9.0, 0.0))])
    client.create_webhook("hook", "https://hooks.example.com/revisit", map_="maps/town")
    loops = client.loop_closures("maps/town", state="ALL")
    loop = loops[0].name.rpartition("/")[2] if loops else "loop-guess"
    return {**UNIVERSE, "operation": operation.name.removeprefix("operations/"), "loop": loop, "merge": merge}


MAP, SESSION, VERSION = "maps/{map}", "maps/{map}/sessions/{session}", "maps/{map}/versions/{version}"
SUBMAP, LOOP = SESSION + "/submaps/{submap}", MAP + "/loopClosures/{loop}"
NOTE = {"note": "mine"}
HOOK = {"webhook_id": "new", "url": "https://hooks.example.com/mine"}
ANCHOR = {
    "anchor_id": "new",
    "kind": "CONTROL_POINT",
    "local_m": "0,0,0",
    "T_odom_sensor": POSE,
    "covariance_enu": np.eye(3).ravel().tolist(),
}
HEARD = RadioReading(7, {"aa:01": -50.0}).message(b"key")
PICTURE = a_png()
PINS = [{"pixel_x": 0.0}, {"pixel_x": 9.0, "x_m": 9.0}]
BODIES = {
    "/sessions": {"session_id": "new"},
    "/webhooks": {**HOOK, "map_id": "{map}"},
    "/anchors": {"anchors": [ANCHOR]},
    "/anchors:preview": {"anchors": [ANCHOR]},
    "/radio": {"readings": [HEARD]},
    **dict.fromkeys(("}:accept", "}:reject", "loop_id}:revert"), NOTE),
    ":distances": {"points_m": [0.0, 0.0, 0.0]},
    ":publish": {},
    ":pin": {"pins": PINS},
    ":merge": {"source": "maps/annex"},
    ":revert": {"version": 1},
    ":setRetention": {"policy": {"best_submaps": 1}},
    ":previewRetention": {"policy": {"best_submaps": 1}},
    "/loopClosures": {"query": SESSION + "/submaps/b", "match": SESSION + "/submaps/a"},
}
"""The JSON of a path by its end; of any other it is a cloud."""


def ask(http, channel, metadata, ids):
    """Every answer by its call."""
    found = {}
    for method, path in rest_calls():
        url = re.sub(r"{(\w+)_id}", lambda m: ids[m[1]], path)
        json = next((one for end, one in BODIES.items() if path.endswith(end)), None)
        content, kind = (PICTURE, "image/png") if path.endswith("/plans") else (CLOUD, QUANTISED)
        binary = {"content": content, "headers": {"content-type": kind}}
        body = binary if json is None else {"json": filled(json, ids)}
        query = {**QUERY, "seq": 1, "T_odom_sensor": POSE} if method == "post" else QUERY
        answer = http.request(method, url, params={k: v for k, v in query.items() if wanted(path, k)}, **body)
        found[f"{method} {path}"] = (answer.status_code, answer.text)
    for method in rpcs():
        found[f"{method.containing_service.name}.{method.name}"] = status(channel, metadata, method, ids)
    return found


def wanted(path, key):
    only = {"submap_id": "/submaps", "T_odom_submap": "/submaps", "seq": "/scans", "T_odom_sensor": "/scans"}
    only |= {"plan_id": "/plans", "pins": "/plans"}
    only |= {"format": ":download", "timeout_s": ":wait", **dict.fromkeys(AROUND, "/points")}
    return path.endswith(only[key]) if key in only else True


def status(channel, metadata, method, ids):
    request = message(method, ids)
    kinds = {(False, False): "unary_unary", (False, True): "unary_stream", (True, True): "stream_stream"}
    rpc = getattr(channel, kinds[method.client_streaming, method.server_streaming])(
        f"/{method.containing_service.full_name}/{method.name}"
    )
    data = request.SerializeToString()
    try:
        answer = rpc(iter([data]) if method.client_streaming else data, metadata=metadata, timeout=PATIENCE_S)
        if method.server_streaming:
            list(answer)
    except grpc.RpcError as error:
        return error.code().name, error.details()
    return "OK", ""


NAMES = {
    "Map": {"name": MAP},
    "Robot": {"name": "robots/{robot}"},
    "Session": {"name": SESSION, "parent": MAP, "session_id": "new"},
    "Submap": {"name": SUBMAP, "parent": SESSION, "submap_id": "new"},
    "LoopClosure": {"name": LOOP, "parent": MAP},
    "Anchor": {"name": SESSION + "/anchors/{anchor}", "parent": SESSION},
    "Radio": {"parent": SESSION},
    "Operation": {"name": "operations/{operation}"},
    "Mapping": {"name": MAP, "parent": MAP},
    "Event": {"parent": MAP},
    "Webhook": {"name": "webhooks/{webhook}", "parent": "webhooks/{webhook}"},
    "MapTile": {"name": VERSION + "/tiles/{tile}", "parent": VERSION},
    "Plan": {"name": MAP + "/plans/{plan}", "parent": MAP, "plan_id": "new", "pins": PINS, "image": PICTURE},
    "MapFile": {"name": "maps/{map}/files/{version}", "parent": VERSION},
}
"""The names in the requests of a service, by its noun."""
OWN = {
    "GetMapVersion": {"name": VERSION},
    "ListSubmapPoses": {"parent": VERSION},
    "ListMapChanges": {"parent": VERSION},
    "GetMapMerge": {"name": "maps/{map}/merges/{merge}"},
    "RevertMapMerge": {"name": "maps/{map}/merges/{merge}"},
    "GetCorrection": {"name": SESSION},
    "GetRetention": {"name": MAP},
    "SetRetention": {"name": MAP},
    "PreviewRetention": {"name": MAP},
    "ListMapFiles": {"parent": MAP},
    "ListLoopClosureEvents": {"parent": LOOP},
    "CreateLoopClosure": {"query": SESSION + "/submaps/b", "match": SESSION + "/submaps/a"},
    "PostAnchors": {"anchors": [replace(DOOR, anchor_id="new").message()]},
    "PreviewAnchors": {"anchors": [replace(DOOR, anchor_id="new").message()]},
    "PostRadio": {"readings": [HEARD]},
    "MergeMap": {"source": "maps/annex"},
    "RevertMap": {"version": 1},
    "CreateWebhook": {**HOOK, "map": MAP},
    "StreamScans": {"open": {"session": SESSION}},
    "Relocalise": {"open": {"parent": MAP}},
    "MeasureMapDistances": {"points_m": [{"x": 1.0}]},
    "FindMapPoints": {"within_m": 9.0},
    "DownloadSubmap": {"format": 1},
    "DownloadMapTile": {"format": 1},
}
"""What the requests of one method have beside those, or instead of them."""
ANYWHERE = {
    "cloud": {"encoded": {"content_type": QUANTISED, "data": CLOUD}},
    "t_odom_submap": {"rotation": {"w": 1.0}, "translation": {"x": 0.0}},
}
"""What a field of this name is filled with."""


def message(method, ids):
    """The request with every resource name filled in."""
    noun = method.containing_service.name.removesuffix("Service")
    wanted = {**ANYWHERE, **NAMES.get(noun, {}), **OWN.get(method.name, {})}
    fields = {name: filled(value, ids) for name, value in wanted.items() if name in method.input_type.fields_by_name}
    return GetMessageClass(method.input_type)(**fields)


def filled(value, ids):
    """The value with its names filled in, in whatever it lies."""
    if isinstance(value, dict):
        return {name: filled(one, ids) for name, one in value.items()}
    return value.format_map(ids) if isinstance(value, str) else value


def renamed(answer, real, guessed):
    """The answer with the ids that the service gave out replaced by guessed ones."""
    code, text = answer
    for noun in ("operation", "loop", "merge"):
        text = text.replace(real[noun], guessed[noun])
    return code, text


def test_foreign_ids_are_answered_as_ids_that_nobody_has(answers):
    before, after, _, _ = answers
    assert len(before) >= 35
    assert after == before


def test_every_call_that_names_a_resource_says_that_it_does_not_exist(answers):
    _, after, _, _ = answers
    others = {call: answer for call, answer in after.items() if answer[0] not in (404, "NOT_FOUND")}
    assert others == {}


def test_the_owner_still_has_everything_that_a_stranger_tried_to_change(answers):
    _, _, client, real = answers
    session = client.get_session("maps/town/sessions/monday")
    assert (session.state, session.committed_seq) == ("ACTIVE", 0)
    assert [submap.state for submap in client.list_submaps(session)] == ["DESCRIBED", "DESCRIBED"]
    assert client.get_robot("robots/rover").name == "robots/rover"
    assert client.get_operation(f"operations/{real['operation']}").state == "DONE"


def test_a_search_finds_nothing_of_another_tenants_map_of_the_same_name():
    world = memory_world()
    once = RetryPolicy(attempts=1)
    with live_service(world) as running:
        found = {}
        for tenant, place in (("one", 1), ("two", 1), ("three", 2)):
            with Client(running.http, api_key=a_key(world, tenant).text, retry=once) as client:
                session = client.create_session(client.create_map("town"), tenant)
                client.wait(client.post_submap(session, "a", cloud_points(place), np.eye(4), 1))
                found[tenant] = [hit.submap for hit in client.search("maps/town", points=cloud_points(1), k=100)]
    assert found == {tenant: [f"maps/town/sessions/{tenant}/submaps/a"] for tenant in ("one", "two", "three")}
