"""What belongs to another tenant looks like what does not exist, in every route and RPC (row A04)."""

from __future__ import annotations

import re

import grpc
import httpx
import numpy as np
import pytest
from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message_factory import GetMessageClass

from revisit import Client
from revisit.formats import QUANTISED, encode_quantised
from revisit.sdk.retry import RetryPolicy
from revisit.service.grpc import server as grpc_server
from revisit.service.rest.app import create_app
from tests.support.credentials import a_key, bearer
from tests.support.fake_merger import EasyMerger
from tests.support.live_service import live_service
from tests.support.patience import PATIENCE_S
from tests.support.service_world import cloud_points, memory_world

REQUEST_ID = {"x-request-id": "fixed"}
CLOUD = encode_quantised(cloud_points(1))
POSE = "0,0,0,0,0,0,1"
AROUND = {"centre_m": "0,0,0", "within_m": 9}
QUERY = {"submap_id": "new", "stamp_ns": 1, "T_odom_submap": POSE, "format": "ply", "timeout_s": 0, **AROUND}
OF_SUBMAP = {"robot": "rover", "map": "town", "session": "monday", "submap": "a"}
UNIVERSE = {**OF_SUBMAP, "version": "1", "webhook": "hook", "tile": "frame-1.0.0"}


def rest_calls():
    """Every call of the OpenAPI document that names a resource."""
    for path, methods in create_app(memory_world().use_cases).openapi()["paths"].items():
        if "{" in path:
            yield from ((method, path) for method in methods)


def rpcs():
    """Every RPC whose request names a resource."""
    for module, *_ in grpc_server._SERVICES:
        for service in module.DESCRIPTOR.services_by_name.values():
            for method in service.methods:
                if {"name", "parent", "open"} & set(method.input_type.fields_by_name):
                    yield method


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


MAPS_OWN = ("OptimiseMap", "RevertMap", "ListMapVersions", "WatchCorrections", "MergeMap", "ListMapMerges")


def fill(client):
    """The owner's resources; their ids, those that the service gave out too."""
    client.create_robot("rover")
    session = client.create_session(client.create_map("town", min_index_gap=0), "monday")
    for number, name in enumerate("ab"):
        operation = client.post_submap(session, name, cloud_points(1), np.eye(4), number + 1)
        client.wait(operation)
    client.wait(client.optimise_map("maps/town"))
    annex = client.create_session(client.create_map("annex", min_index_gap=0), "tuesday")
    for number, name in enumerate("cd"):
        client.wait(client.post_submap(annex, name, cloud_points(1), np.eye(4), number + 1))
    merge = client.wait(client.merge_map("maps/town", "maps/annex")).result["merge"].rpartition("/")[2]
    client.wait(client.publish_map("maps/town/versions/1"))
    client.download_tile(client.map_tiles("maps/town/versions/1")[0], "mesh")
    client.create_webhook("hook", "https://hooks.example.com/revisit", map_="maps/town")
    loops = client.loop_closures("maps/town", state=None)
    loop = loops[0].name.rpartition("/")[2] if loops else "loop-guess"
    return {**UNIVERSE, "operation": operation.name.removeprefix("operations/"), "loop": loop, "merge": merge}


def ask(http, channel, metadata, ids):
    """Every answer by its call."""
    found = {}
    for method, path in rest_calls():
        filled = re.sub(r"{(\w+)_id}", lambda m: ids[m[1]], path)
        body = {"json": {"session_id": "new"}} if path.endswith("/sessions") else {}
        if path.endswith(("}:accept", "}:reject", "loop_id}:revert")):
            body = {"json": {"note": "mine"}}
        elif path.endswith(":distances"):
            body = {"json": {"points_m": [0.0, 0.0, 0.0]}}
        elif path.endswith(":publish"):
            body = {"json": {}}
        elif path.endswith(":merge"):
            body = {"json": {"source": "maps/annex"}}
        elif path.endswith(":revert"):
            body = {"json": {"version": 1}}
        if path.endswith("/loopClosures"):
            submap = f"maps/{ids['map']}/sessions/{ids['session']}/submaps"
            body = {"json": {"query": f"{submap}/b", "match": f"{submap}/a"}}
        if not body:
            body = {"content": CLOUD, "headers": {"content-type": QUANTISED}}
        query = {**QUERY, "seq": 1, "T_odom_sensor": POSE} if method == "post" else QUERY
        answer = http.request(method, filled, params={k: v for k, v in query.items() if wanted(path, k)}, **body)
        found[f"{method} {path}"] = (answer.status_code, answer.text)
    for method in rpcs():
        found[f"{method.containing_service.name}.{method.name}"] = status(channel, metadata, method, ids)
    return found


def wanted(path, key):
    only = {"submap_id": "/submaps", "T_odom_submap": "/submaps", "seq": "/scans", "T_odom_sensor": "/scans"}
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


def message(method, ids):
    """The request with every resource name filled in."""
    request = GetMessageClass(method.input_type)()
    noun = method.containing_service.name.removesuffix("Service")
    session = f"maps/{ids['map']}/sessions/{ids['session']}"
    version = f"maps/{ids['map']}/versions/{ids['version']}"
    merge = f"maps/{ids['map']}/merges/{ids['merge']}"
    mapping = {
        **dict.fromkeys(MAPS_OWN, f"maps/{ids['map']}"),
        **dict.fromkeys(("GetMapVersion", "ListSubmapPoses"), version),
        **dict.fromkeys(("GetMapMerge", "RevertMapMerge"), merge),
        "GetCorrection": session,
    }
    names = {
        "Map": f"maps/{ids['map']}",
        "Robot": f"robots/{ids['robot']}",
        "Session": session,
        "Submap": f"{session}/submaps/{ids['submap']}",
        "LoopClosure": f"maps/{ids['map']}/loopClosures/{ids['loop']}",
        "Operation": f"operations/{ids['operation']}",
        "Mapping": mapping.get(method.name),
        "Webhook": f"webhooks/{ids['webhook']}",
        "MapTile": f"{version}/tiles/{ids['tile']}",
        "MapFile": f"maps/{ids['map']}/files/{ids['version']}",
    }
    parents = {
        "Session": names["Map"],
        "Submap": session,
        "LoopClosure": names["Map"],
        "Mapping": names["Mapping"],
        "Event": names["Map"],
        "Webhook": names["Webhook"],
        "MapTile": version,
        "MapFile": names["Map"] if method.name == "ListMapFiles" else version,
    }
    fields = method.input_type.fields_by_name
    values = {"name": names.get(noun), "parent": parents.get(noun), "session_id": "new", "submap_id": "new"}
    for name, value in values.items():
        if name in fields and value and fields[name].type == FieldDescriptor.TYPE_STRING:
            setattr(request, name, value)
    if method.name == "ListLoopClosureEvents":
        request.parent = names["LoopClosure"]
    if method.name == "CreateLoopClosure":
        request.query, request.match = f"{session}/submaps/b", f"{session}/submaps/a"
    if method.name == "MergeMap":
        request.source = "maps/annex"
    if method.name == "RevertMap":
        request.version = 1
    if "open" in fields:
        request.open.session = session
    if method.name == "MeasureMapDistances":
        request.points_m.add(x=1.0)
    if method.name == "FindMapPoints":
        request.within_m = 9.0
    if method.name in ("DownloadSubmap", "DownloadMapTile"):
        request.format = 1
    if "cloud" in fields:
        request.cloud.encoded.content_type, request.cloud.encoded.data = QUANTISED, CLOUD
    if "t_odom_submap" in fields:
        request.t_odom_submap.rotation.w = 1.0
        request.t_odom_submap.translation.x = 0.0
    return request


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
