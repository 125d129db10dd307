"""A query that names a sequence number sees what was stored up to it, or says that it does not: both transports."""

from __future__ import annotations

import itertools
import threading
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
import pytest

from revisit import Client
from revisit.sdk.errors import DeadlineExceeded, InvalidArgument
from revisit.service.domain.identity import DEFAULT_TENANT
from tests.support.campaigns import Campaign, sizes
from tests.support.credentials import a_key
from tests.support.fake_recogniser import CANNOT_BE_DESCRIBED
from tests.support.live_service import live_service
from tests.support.service_world import cloud_points, pose, sqlite_world

SHORT_S = 0.05
ROBOTS = 4
PORTION = 100
"""Checks in a map of its own."""


@pytest.fixture
def paused(service):
    """The service's worker, at rest until the test lets it work."""
    service.working.clear()
    yield service.working
    service.working.set()


def post(client, session, submap_id="a", place=1, points=300):
    return client.post_submap(session, submap_id, cloud_points(place, points), pose(float(place)), 1_000)


def queries(client, town, place=1):
    """Every kind of query that takes `min_seq`, as functions of it."""
    cloud = cloud_points(place)
    return {
        "by submap": lambda **fresh: client.search(town, submap=f"{town}/sessions/monday/submaps/a", **fresh),
        "by descriptor": lambda **fresh: client.search(
            town, descriptor=np.eye(64)[0].tolist(), model_version="fake-1", **fresh
        ),
        "by cloud": lambda **fresh: client.search(town, points=cloud, **fresh),
        "localize": lambda **fresh: client.localize(town, cloud, **fresh),
        "loop closures": lambda **fresh: client.loop_closures(town, **fresh),
    }


@pytest.mark.parametrize("kind", ["by submap", "by descriptor", "by cloud", "localize", "loop closures"])
def test_every_query_says_that_it_would_miss_what_is_not_described_yet(client, session, town, paused, kind):
    seq = post(client, session).seq
    with pytest.raises(DeadlineExceeded) as refused:
        queries(client, town)[kind](min_seq=seq, min_seq_timeout_s=SHORT_S)
    assert (refused.value.reason, refused.value.retryable) == ("SEQ_NOT_REACHED", True)


def test_loops_of_a_submap_are_waited_for_beyond_its_description(client, service, session, town):
    """The search for a submap sees it as soon as it is described; the list of its loops when its job has ended."""
    operation = client.wait(post(client, session))
    seq = client.get_submap(operation.subject).seq

    def search_on(uow, *, searched):
        (row,) = uow.submaps.find(DEFAULT_TENANT, map_id=town.removeprefix("maps/"))
        uow.submaps.revise([row], searched=searched)

    write = service.world.context.transactions.write
    write(partial(search_on, searched=False)).result()
    asked = queries(client, town)
    assert asked["by submap"](min_seq=seq) == []
    with pytest.raises(DeadlineExceeded) as refused:
        asked["loop closures"](min_seq=seq, min_seq_timeout_s=SHORT_S)
    assert refused.value.reason == "SEQ_NOT_REACHED"
    write(partial(search_on, searched=True)).result()
    assert list(asked["loop closures"](min_seq=seq)) == []


def test_a_query_waits_for_what_its_own_client_has_posted(client, session, town, paused):
    seq = post(client, session).seq
    later = threading.Timer(0.1, paused.set)
    later.start()
    hits = client.search(town, points=cloud_points(1), min_seq=seq)
    later.join()
    assert [hit.submap for hit in hits] == [f"{session.name}/submaps/a"]


def test_the_seq_is_that_of_the_submap_and_grows_with_each(client, session):
    first, second = post(client, session), post(client, session, "b", 2)
    listed = [submap.seq for submap in client.list_submaps(session)]
    assert listed == [first.seq, second.seq]
    assert first.seq < second.seq
    assert client.get_submap(first.subject).seq == first.seq
    assert post(client, session).seq == first.seq


def test_a_stream_tells_the_seq_of_the_submaps_that_its_scans_complete(client, session, town):
    with client.stream(session) as stream:
        for number in range(12):
            stream.send(cloud_points(number), pose(float(number)), number)
        stream.flush()
        seq = stream.submap_seq
    assert seq == max(submap.seq for submap in client.list_submaps(session)) > 0
    described = {hit.submap for hit in client.search(town, points=cloud_points(5), min_seq=seq)}
    assert described == {submap.name for submap in client.list_submaps(session)}


def test_a_number_that_no_submap_has_yet_is_not_answered_as_if_it_had(client, session, town):
    seq = post(client, session).seq
    with pytest.raises(DeadlineExceeded, match=f"no submap with seq {seq + 10**6} was stored"):
        client.search(town, points=cloud_points(1), min_seq=seq + 10**6, min_seq_timeout_s=SHORT_S)


def test_submaps_of_other_maps_and_later_ones_are_not_waited_for(client, session, town, paused):
    paused.set()
    operation = post(client, session)
    client.wait(operation)
    paused.clear()
    post(client, session, "later", 2)
    other = client.create_session(client.create_map(f"other-{operation.seq}"), "monday")
    post(client, other)
    hits = client.search(town, submap=operation.subject, min_seq=operation.seq, min_seq_timeout_s=0.0)
    assert hits == []


def test_a_submap_that_cannot_be_described_and_one_that_is_deleted_are_not_waited_for(client, session, town, paused):
    failing = post(client, session, "failing", 1, CANNOT_BE_DESCRIBED)
    gone = post(client, session, "gone", 2)
    client.delete(gone.subject)
    paused.set()
    assert client.search(town, points=cloud_points(1), min_seq=gone.seq) == []
    assert client.get_operation(failing.name).failure_reason == "UNUSABLE_CLOUD"


@pytest.mark.parametrize("fresh", [(2**63, 1.0), (1, -0.1), (1, 60.1)])
def test_what_cannot_be_waited_for_is_refused(client, session, town, fresh):
    min_seq, timeout_s = fresh
    with pytest.raises(InvalidArgument):
        client.loop_closures(town, min_seq=min_seq, min_seq_timeout_s=timeout_s)


def check_randomly(client, seed: int, checks: int) -> int:
    """Post, delete and query at random under a working worker; how many queries were refused as too early."""
    rng = np.random.default_rng(seed)
    session = client.create_session(client.create_map(f"random-{seed}"), "monday")
    town = session.name.partition("/sessions/")[0]
    alive: dict[int, str] = {}
    refused = 0
    for number in range(checks):
        place = int(rng.integers(0, 50))
        operation = post(client, session, f"s{number}", place)
        alive[operation.seq] = operation.subject
        if len(alive) > 40 or rng.random() < 0.1:
            client.delete(alive.pop(int(rng.choice(list(alive)))))
        min_seq = int(rng.choice([operation.seq, *alive]))
        timeout_s = float(rng.choice([0.0, 0.001, 60.0]))
        vector = [1.0] * 64
        try:
            hits = client.search(
                town, descriptor=vector, model_version="fake-1", k=100, min_seq=min_seq, min_seq_timeout_s=timeout_s
            )
        except DeadlineExceeded:
            refused += 1
            assert timeout_s < 60.0
            continue
        missed = {name for seq, name in alive.items() if seq <= min_seq} - {hit.submap for hit in hits}
        assert not missed, f"seed {seed}, check {number}: {missed} missed with min_seq {min_seq}"
    return refused


def test_random_queries_under_a_working_worker_never_miss_silently(client):
    refused = check_randomly(client, checks=20, seed=2026)
    assert refused < 20, "no query was answered"


@pytest.mark.timeout(7200)
@pytest.mark.parametrize("checks", sizes("FRESHNESS_CHECKS", 20, 100_000))
def test_random_queries_over_a_database_never_miss_silently(tmp_path, checks):
    world = sqlite_world(tmp_path)
    campaign, refused = Campaign("P7", checks), 0
    with (
        live_service(world) as running,
        Client(running.http) as rest,
        Client.grpc(running.grpc) as rpc,
        ThreadPoolExecutor(ROBOTS) as robots,
    ):
        seeds = itertools.count()
        while not campaign.over:
            portion = min(PORTION, -(-campaign.left // ROBOTS))
            checks_of = partial(check_randomly, checks=portion)
            refused += sum(robots.map(checks_of, itertools.islice(itertools.cycle((rest, rpc)), ROBOTS), seeds))
            campaign.done += ROBOTS * portion
    world.context.transactions.close()
    assert refused < campaign.done
    campaign.publish(f"0 of {campaign.done} queries missed what they named; {refused} were refused as too early")


def test_a_tenant_without_submaps_cannot_find_out_how_many_others_have(guarded):
    clients = {name: Client(guarded.http, api_key=a_key(guarded.world, tenant=name).text) for name in ("many", "none")}
    for client in clients.values():
        client.create_session(client.create_map("town"), "monday")
    seq = max(post(clients["many"], "maps/town/sessions/monday", name).seq for name in "abc")
    for min_seq in (1, seq, seq + 1, 10**9):
        with pytest.raises(DeadlineExceeded) as refused:
            clients["none"].loop_closures("maps/town", min_seq=min_seq, min_seq_timeout_s=5.0)
        assert refused.value.message == f"no submap with seq {min_seq} was stored"
    assert clients["many"].loop_closures("maps/town", min_seq=seq, min_seq_timeout_s=60.0) is not None
    for client in clients.values():
        client.close()
