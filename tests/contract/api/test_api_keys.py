"""Keys, streams, floods and the audit log on both transports (rows A02, A05, A08, A09)."""

from __future__ import annotations

import asyncio
import base64
import hmac
import re
from types import SimpleNamespace

import grpc
import httpx
import pytest

from revisit.service.domain.callers import ANYONE
from revisit.service.domain.errors import StorageFull, Unauthenticated
from revisit.service.features.catalogue.maps import CreateMap
from revisit.service.features.keys.calls import CreateKey, caller_of_key, parse_key
from revisit.service.grpc import access as grpc_access
from revisit.service.grpc import server as grpc_server
from revisit.v1 import loop_closure_pb2, map_pb2, map_pb2_grpc
from tests.support.credentials import a_key, bearer, ended
from tests.support.live_service import live_service
from tests.support.patience import PATIENCE_S
from tests.support.service_world import memory_world

LIST_MAPS = map_pb2.DESCRIPTOR.services_by_name["MapService"].methods_by_name["ListMaps"]


def wrong_keys(key):
    other = "x" if key[-1] != "x" else "y"
    return {
        "another secret": key[:-1] + other,
        "one character more": key + "a",
        "one character less": key[:-1],
        "another id": "rv_000000000000" + key[15:],
        "only the id": key[:16],
        "not even a key": "secret",
        "text beyond ASCII": "rv_\u00e9",
    }


@pytest.mark.parametrize("case", wrong_keys("rv_abcdefabcdef_" + "a" * 43))
def test_a_wrong_key_is_refused_alike_on_both_transports(guarded, guarded_grpc, guarded_http, case):
    wrong = wrong_keys(a_key(guarded.world).text)[case]
    header = f"Bearer {wrong}".encode()
    answer = guarded_http.get("/v1/maps", headers={"authorization": header})
    assert (answer.status_code, answer.json()["detail"]) == (401, "The credential is missing or not valid.")
    if case != "text beyond ASCII":  # which gRPC does not send as metadata
        code, details = ended(guarded_grpc, LIST_MAPS, [("authorization", header.decode())])
        assert (code, details) == (grpc.StatusCode.UNAUTHENTICATED, answer.json()["detail"])


def test_a_key_in_the_query_string_or_as_another_scheme_opens_nothing(guarded, guarded_http):
    key = a_key(guarded.world).text
    assert guarded_http.get("/v1/maps", params={"api_key": key, "authorization": key}).status_code == 401
    assert guarded_http.get("/v1/maps", headers={"authorization": f"Basic {key}"}).status_code == 401
    assert guarded_http.get("/v1/maps", headers={"authorization": key}).status_code == 401


def test_a_key_is_known_by_its_hash_alone_and_shown_once(guarded):
    key = a_key(guarded.world)
    stored = guarded.world.context.transactions.read(lambda uow: uow.keys.get(key.record.key_id)).result()
    assert re.fullmatch(r"rv_[a-z0-9]{12}_[A-Za-z0-9]{43}", key.text)
    assert key.text[16:] not in repr(stored)
    assert len(stored.secret_sha256) == 64


def test_an_expired_and_a_revoked_key_say_so_to_their_holder_only():
    world = memory_world()
    short, long = a_key(world, lifetime_s=60), a_key(world)
    with live_service(world) as running, httpx.Client(base_url=running.http, trust_env=False) as http:
        assert http.get("/v1/maps", headers=bearer(short)).status_code == 200
        world.clock.ms += 60_001
        assert "has expired" in http.get("/v1/maps", headers=bearer(short)).json()["detail"]
        asyncio.run(world.use_cases.keys.revoke(long.record.key_id))
        assert "was revoked" in http.get("/v1/maps", headers=bearer(long)).json()["detail"]
        stranger = http.get("/v1/maps", headers=bearer(long.text[:-2] + "zz"))
        assert "revoked" not in stranger.json()["detail"]


def test_rotation_leaves_two_live_keys_until_the_grace_has_passed():
    world = memory_world()
    old = a_key(world, scopes=["query"], lifetime_s=1000)
    new = asyncio.run(world.use_cases.keys.rotate(old.record.key_id, grace_s=60))
    assert (new.record.tenant, new.record.scopes, new.record.label) == ("acme", ("query",), "a test")
    assert new.record.expires_at_ns - new.record.created_at_ns == 1000 * 10**9
    with live_service(world) as running, httpx.Client(base_url=running.http, trust_env=False) as http:
        statuses = [[http.get("/v1/maps", headers=bearer(key)).status_code for key in (old, new)]]
        world.clock.ms += 60_001
        statuses += [[http.get("/v1/maps", headers=bearer(key)).status_code for key in (old, new)]]
    assert statuses == [[200, 200], [401, 200]]


def test_without_any_key_everyone_is_let_in_until_the_first_key_is_made():
    world = memory_world()
    with live_service(world) as running, httpx.Client(base_url=running.http, trust_env=False) as http:
        assert http.post("/v1/maps", json={"map_id": "town"}).status_code == 201
        assert http.get("/v1/maps", headers=bearer("rv_abcdefabcdef_" + "a" * 43)).status_code == 401
        key = a_key(world, tenant="default")
        assert http.get("/v1/maps").status_code == 401
        assert [m["name"] for m in http.get("/v1/maps", headers=bearer(key)).json()["maps"]] == ["maps/town"]
        asyncio.run(world.use_cases.keys.revoke(key.record.key_id))
        assert http.get("/v1/maps").status_code == 401


@pytest.mark.parametrize(
    "field", ["tenant", "tenant_id", "status", "state", "descriptor", "loop_score", "created_at_ns"]
)
@pytest.mark.parametrize("resource", ["maps", "robots", "sessions"])
def test_what_the_service_decides_cannot_be_assigned_by_a_client(guarded, guarded_http, resource, field):
    headers = bearer(a_key(guarded.world, tenant="assign"))
    guarded_http.post("/v1/maps", json={"map_id": "town"}, headers=headers)
    path = "/v1/maps/town/sessions" if resource == "sessions" else f"/v1/{resource}"
    body = {f"{resource.removesuffix('s')}_id": "x", field: "acme"}
    answer = guarded_http.post(path, json=body, headers=headers)
    assert (answer.status_code, answer.json()["field"]) == (422, field)


def test_an_unknown_field_of_a_message_does_not_choose_the_tenant(guarded, guarded_grpc):
    ours, theirs = (tuple(bearer(a_key(guarded.world, tenant=name)).items()) for name in ("wire", "other-wire"))
    request = map_pb2.CreateMapRequest(map_id="wired").SerializeToString() + b"\xfa\x01\x04acme"  # field 31
    guarded_grpc.unary_unary("/revisit.v1.MapService/CreateMap")(request, metadata=ours)
    stub = map_pb2_grpc.MapServiceStub(guarded_grpc)
    lists = [stub.ListMaps(map_pb2.ListMapsRequest(), metadata=key).maps for key in (ours, theirs)]
    assert [[m.name for m in maps] for maps in lists] == [["maps/wired"], []]


def test_a_page_token_tells_nothing_and_is_good_for_its_own_tenant_alone(guarded, guarded_http, guarded_grpc):
    ours, theirs = (bearer(a_key(guarded.world, tenant=name)) for name in ("pages", "other-pages"))
    for key in (ours, theirs, ours):
        for map_id in ("town-1", "town-2"):
            guarded_http.post("/v1/maps", json={"map_id": map_id}, headers=key)
    token = guarded_http.get("/v1/maps?page_size=1", headers=ours).json()["next_page_token"]
    number = guarded.world.context.transactions.read(lambda uow: uow.maps.find("pages")[0].number).result()
    content = base64.urlsafe_b64decode(token)
    assert len(content) == 16 and number.to_bytes(8, "big") not in content
    path, stub = f"/v1/maps?page_token={token}", map_pb2_grpc.MapServiceStub(guarded_grpc)
    assert [m["name"] for m in guarded_http.get(path, headers=ours).json()["maps"]] == ["maps/town-2"]
    refused = guarded_http.get(path, headers=theirs)
    assert (refused.status_code, refused.json()["field"]) == (422, "page_token")
    with pytest.raises(grpc.RpcError) as told:
        stub.ListMaps(map_pb2.ListMapsRequest(page_token=token), metadata=tuple(theirs.items()))
    assert told.value.code() is grpc.StatusCode.INVALID_ARGUMENT


def test_a_flood_of_bad_keys_is_answered_429_and_shuts_no_good_key_out():
    world = memory_world()
    key = a_key(world)
    with (
        live_service(world) as running,
        httpx.Client(base_url=running.http, trust_env=False) as http,
        grpc.insecure_channel(running.grpc) as channel,
    ):
        answers = [http.get("/v1/maps", headers=bearer("wrong")) for _ in range(1000)]
        assert [answer.status_code for answer in answers] == [401] * 20 + [429] * 980
        assert answers[-1].json()["reason"] == "RATE"
        assert 1 <= int(answers[-1].headers["retry-after"]) <= 5
        assert http.get("/v1/maps", headers=bearer(key)).status_code == 200
        ends = [ended(channel, LIST_MAPS, bearer("wrong").items())[0] for _ in range(40)]
        assert set(ends[20:]) == {grpc.StatusCode.RESOURCE_EXHAUSTED}
        world.clock.ms += 5_000
        assert http.get("/v1/maps", headers=bearer("wrong")).status_code == 401
    rows = world.context.transactions.read(lambda uow: uow.audit.since(0, 1000)).result()
    refused = [row for row in rows if row.action == "refused"]
    assert len(refused) <= 41
    # What was over budget is counted in the next row that is written.
    assert sum(int(row.detail.get("over_budget_before", 0)) for row in refused) >= 980


async def test_an_unknown_id_costs_the_same_comparison_as_a_wrong_secret(monkeypatch):
    """So the time of a refusal does not tell whether the id exists: both compare as many bytes, in constant time."""
    world = memory_world()
    made = await world.use_cases.keys.create(CreateKey("acme", ["query"]))
    wrong = parse_key(made.text[:-2] + "zz")
    compared = []

    def spied(stored, shown):
        compared.append((type(stored), len(stored), shown))
        return hmac.compare_digest(stored, shown)

    monkeypatch.setattr("revisit.service.features.keys.calls.hmac", SimpleNamespace(compare_digest=spied))
    for known in (made.record, None):
        with pytest.raises(Unauthenticated):
            caller_of_key(known, wrong, 0)
    assert len(compared) == 2
    assert compared[0] == compared[1]


class CountingGate(grpc_access.Gate):
    """Verifies credentials five times a second, and counts."""

    admitted = 0

    def __init__(self, use_cases, *others):
        super().__init__(use_cases, *others, recheck_s=0.2)

    async def verify(self, method, shown):
        await super().verify(method, shown)
        type(self).admitted += 1


@pytest.mark.parametrize("cause", ["revoked", "expired"])
async def test_a_stream_ends_soon_after_its_key_is_gone(monkeypatch, cause):
    monkeypatch.setattr("revisit.service.grpc.server.Gate", CountingGate)
    monkeypatch.setattr(CountingGate, "admitted", 0)
    assert grpc_access.STREAM_RECHECK_S <= 1  # second: of three that are promised
    world = memory_world()
    made = await world.use_cases.keys.create(CreateKey("acme", ["ingest", "query"], "", 3600))
    await world.use_cases.maps.create(made.record.tenant, CreateMap("town"))
    server = grpc_server.create_server(world.use_cases)
    port = server.add_insecure_port("127.0.0.1:0")
    await server.start()
    async with grpc.aio.insecure_channel(f"127.0.0.1:{port}") as channel:
        method = channel.unary_stream("/revisit.v1.LoopClosureService/WatchLoopClosures")
        request = loop_closure_pb2.WatchLoopClosuresRequest(parent="maps/town").SerializeToString()
        stream = method(request, metadata=tuple(bearer(made).items()))
        reading = asyncio.create_task(stream.read())
        async with asyncio.timeout(PATIENCE_S):
            while CountingGate.admitted < 3:  # verified again, and let go on
                await asyncio.sleep(0.05)
        assert not reading.done()
        if cause == "revoked":
            await world.use_cases.keys.revoke(made.record.key_id)
        else:
            world.clock.ms += 3_600_001
        with pytest.raises(grpc.aio.AioRpcError) as ended:
            await asyncio.wait_for(reading, PATIENCE_S)
        assert ended.value.code() is grpc.StatusCode.UNAUTHENTICATED
        assert "lost its right" in ended.value.details()
    await server.stop(0.1)


class EndedCall:
    """The context of a call that ends while its credential is being verified; asking it crashes gRPC's core then."""

    ended = False

    def _ask(self, answer):
        assert not self.ended, "gRPC would end this process with a segmentation fault"
        return answer

    def invocation_metadata(self):
        return self._ask(())

    def auth_context(self):
        return self._ask({})

    def peer(self):
        return self._ask("ipv4:127.0.0.1:9")


async def test_a_call_that_has_ended_is_asked_for_nothing_while_its_watch_goes_on(monkeypatch):
    verified, watched = asyncio.Event(), asyncio.Event()

    class Access:
        async def admit(self, *_shown):
            (watched if verified.is_set() else verified).set()
            return ANYONE

        admit_call = admit

    gate = grpc_access.Gate(SimpleNamespace(access=Access()), recheck_s=0.0)
    call = EndedCall()
    async with gate.watching("/revisit.v1.LoopClosureService/WatchLoopClosures", call):
        call.ended = True
        assert verified.is_set()
        async with asyncio.timeout(60):
            await watched.wait()


def test_refusals_and_admin_calls_and_deletions_are_in_the_audit_log(guarded, guarded_http):
    key = a_key(guarded.world, tenant="audited")
    weak = a_key(guarded.world, tenant="audited", scopes=["query"])
    read = guarded.world.context.transactions.read
    before = read(lambda uow: uow.audit.highest()).result()
    guarded_http.post("/v1/maps", json={"map_id": "gone"}, headers=bearer(key))
    assert guarded_http.delete("/v1/maps/gone", headers=bearer(weak)).status_code == 403
    assert guarded_http.delete("/v1/maps/gone", headers=bearer(key)).status_code == 204
    rows = read(lambda uow: uow.audit.since(before, 10)).result()
    found = [(row.tenant, row.actor, row.action, row.subject) for row in rows]
    assert found == [
        ("audited", f"key {weak.record.key_id}", "refused", "DELETE /v1/maps/gone"),
        ("audited", f"key {key.record.key_id}", "admin_call", "DELETE /v1/maps/gone"),
        ("audited", f"key {key.record.key_id}", "map_deleted", "maps/gone"),
    ]
    assert asyncio.run(guarded.world.use_cases.audit.verify()).fault is None


def test_a_full_disk_changes_no_refusal(monkeypatch):
    world = memory_world()
    a_key(world)

    def full(work, **_):
        raise StorageFull

    with live_service(world) as running, httpx.Client(base_url=running.http, trust_env=False) as http:
        running.working.clear()
        monkeypatch.setattr(world.context.transactions, "write", full)
        assert http.get("/v1/maps").status_code == 401
        monkeypatch.undo()
