"""Maps are searched in search processes: as in the own index, whichever process answers, and by nobody else's word."""

from __future__ import annotations

import threading
import time
from contextlib import ExitStack, contextmanager
from dataclasses import replace

import grpc
import numpy as np
import pytest

from revisit.core.errors import BadField
from revisit.core.index import FaissIndex
from revisit.internal.v1 import place_search_pb2 as pb
from revisit.service.domain.errors import StorageUncertain, Unavailable
from revisit.service.domain.processes import LivingProcess, ProcessRole
from revisit.service.engines.local.vector_index import PlaceVectorIndex
from revisit.service.features.catalogue.maps import CreateMap
from revisit.service.features.index.caught_up_index import CaughtUpIndex
from revisit.service.ports.index import VectorFilter
from revisit.service.ports.place_search import PlaceQuestion
from revisit.service.search import client
from revisit.service.search.client import RemotePlaceSearch
from revisit.service.search.load import MapLoad
from revisit.service.search.messages import question_message, question_of
from revisit.service.search.process import HeldIndex, HeldMaps, Rounds
from revisit.service.search.server import NEAREST, SERVICE, PlaceSearchServer
from tests.faults.proxy import bad_link
from tests.support.patience import PATIENCE_S, in_time
from tests.support.service_world import SESSION, TENANT, described_home, sqlite_world, submap

SUBMAPS = 12
SECRET = b"s" * 32


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    return described_home(tmp_path_factory.mktemp("described"), SUBMAPS)


@pytest.fixture
def world(home, tmp_path):
    import shutil

    made = sqlite_world(shutil.copytree(home, tmp_path / "home"))
    yield made
    made.context.transactions.close()


class Process:
    """A search process in a thread of this one."""

    def __init__(self, world, process_id, secret=SECRET, address=""):
        transactions, index = world.context.transactions, PlaceVectorIndex(FaissIndex)
        self.held = HeldIndex(world.context.storage, index, CaughtUpIndex(transactions, index))
        self.server = PlaceSearchServer(self.held.caught_up, secret, MapLoad())
        self.address = f"127.0.0.1:{self.server.start('127.0.0.1:0')}"
        self.maps = HeldMaps(self.held, process_id, address or self.address, MapLoad())

    def size(self, map_number):
        return self.held.index.size(map_number)


@contextmanager
def running(world, *ids, secret=SECRET):
    processes = [Process(world, process_id, secret) for process_id in ids]
    for process in processes:
        process.maps.show()
    for process in processes:
        process.maps.tend()
    yield processes
    for process in processes:
        process.server.stop(0.0)


class NotHere:
    """An index of this process that must not be asked."""

    def nearest(self, question):
        raise AssertionError("the index of this process was asked")

    def nearest_in(self, uow, question, version):
        raise AssertionError("the index of this process was asked")


def elsewhere(world, secret=SECRET):
    return RemotePlaceSearch(world.context.transactions, secret, NotHere())


def row(world, submap_id="s3"):
    return world.context.transactions.read(
        lambda uow: uow.submaps.get(TENANT, SESSION.map_id, SESSION.session_id, submap_id)
    ).result()


def question(world, **fields):
    record = world.context.transactions.read(lambda uow: uow.maps.get(TENANT, SESSION.map_id)).result()
    vector = np.frombuffer(row(world).descriptor, dtype="<f4")
    return PlaceQuestion(
        TENANT, record.number, vector, fields.pop("k", 5), VectorFilter(**fields.pop("where", {})), **fields
    )


def asked(world):
    here = row(world)
    return [
        {},
        {"before": here.entered},
        {"where": {"without": frozenset({here.number})}},
        {"where": {"only_sessions": frozenset()}},
        {"where": {"only_session": here.session_number, "of_session": here.session_number}},
        {"where": {"exclude_session": here.session_number}},
        {"where": {"position_m": here.position_m, "radius_m": 2.5}},
    ]


class CaughtUpMeanwhile(PlaceVectorIndex):
    """An index that knows all of the database before its first search: another thread has caught up."""

    def __init__(self, world):
        super().__init__(FaissIndex)
        self._others = CaughtUpIndex(world.context.transactions, self)
        self.searches = 0

    def search(self, map_number, vector, k, where):
        """As the other does."""
        self.searches += 1
        if self.searches == 1:
            self._others.catch_up(TENANT, map_number)
        return super().search(map_number, vector, k, where)


def test_a_search_among_those_before_a_submap_finds_none_that_another_thread_brings_meanwhile(world):
    index = CaughtUpMeanwhile(world)
    asked_for = question(world, before=row(world).entered, k=SUBMAPS)
    found = CaughtUpIndex(world.context.transactions, index).nearest(asked_for).matches
    alone = CaughtUpIndex(world.context.transactions, PlaceVectorIndex(FaissIndex)).nearest(asked_for).matches
    assert found == alone
    assert len(found) < SUBMAPS - 1
    assert index.searches == 2


def test_a_search_process_answers_as_the_index_of_the_process_that_asks(world):
    own = CaughtUpIndex(world.context.transactions, PlaceVectorIndex(FaissIndex))
    with running(world, "search-a"):
        there = elsewhere(world)
        for fields in asked(world):
            assert there.nearest(question(world, **fields)) == own.nearest(question(world, **fields))


def test_a_question_arrives_as_it_was_sent(world):
    for fields in asked(world):
        sent = question(world, **fields)
        came = question_of(pb.NearestRequest.FromString(question_message(sent).SerializeToString()))
        assert replace(came, vector=sent.vector) == replace(sent, vector=sent.vector)
        np.testing.assert_array_equal(came.vector, sent.vector)


async def test_an_answer_holds_what_was_committed_before_the_question(world):
    with running(world, "search-a"):
        there = elsewhere(world)
        before = there.nearest(question(world)).searched
        await world.use_cases.posting.post(TENANT, submap("later", 30))
        world.work_off()
        assert there.nearest(question(world)).searched == before + 1 == SUBMAPS + 1


def test_another_process_answers_where_the_first_is_gone(world):
    with running(world, "search-a", "search-b") as processes:
        there = elsewhere(world)
        expected = there.nearest(question(world))
        holding = [one for one in processes if one.size(question(world).map_number)]
        assert len(holding) == 1
        holding[0].server.stop(0.0)
        assert there.nearest(question(world)) == expected


def test_another_process_answers_where_the_link_to_the_first_goes_dark(world):
    """A host that is cut off says nothing: its process counts as living for seconds, and no connection is reset."""
    with ExitStack() as stack:
        (first,) = stack.enter_context(running(world, "search-a"))
        link = stack.enter_context(bad_link(first.address))
        behind = HeldMaps(first.held, "search-a", link.address, MapLoad())
        behind.show()
        behind.tend()
        there = elsewhere(world)
        expected = there.nearest(question(world))
        assert link.connections == 1
        (second,) = stack.enter_context(running(world, "search-b"))

        def only_the_second_shows_itself():
            world.clock.ms += client.ALIVE_WITHIN_MS + 1
            second.maps.show()

        link.dark, began_s = True, time.monotonic()
        threading.Timer(1.0, only_the_second_shows_itself).start()
        assert there.nearest(question(world)) == expected
        assert in_time(time.monotonic() - began_s, client.PATIENCE_S / 2)


def test_a_process_of_another_secret_gets_no_answer(world, monkeypatch):
    monkeypatch.setattr(client, "PATIENCE_S", 0.5)
    with running(world, "search-a") as (process,):
        with pytest.raises(Unavailable, match="no search process answers"):
            elsewhere(world, secret=b"t" * 32).nearest(question(world))
        with grpc.insecure_channel(process.address) as channel, pytest.raises(grpc.RpcError) as refused:
            channel.unary_unary(f"/{SERVICE}/{NEAREST}")(question_message(question(world)).SerializeToString())
        assert refused.value.code() is grpc.StatusCode.UNAUTHENTICATED


def test_a_descriptor_of_another_dimension_is_refused(world):
    with running(world, "search-a"):
        wrong = replace(question(world), vector=np.ones(7, np.float32))
        with pytest.raises(BadField, match="values"):
            elsewhere(world).nearest(wrong)


def test_without_search_processes_the_own_index_answers(world):
    own = CaughtUpIndex(world.context.transactions, PlaceVectorIndex(FaissIndex))
    there = RemotePlaceSearch(world.context.transactions, SECRET, own)
    assert not there.anywhere()
    assert there.nearest(question(world)).matches[0].submap_number == row(world).number


async def test_maps_move_only_once_the_process_that_came_has_loaded_them(world):
    for number in range(8):
        await world.use_cases.maps.create(TENANT, CreateMap(f"m{number}"))
    town = question(world).map_number
    with running(world, "search-a") as (first,):
        joining = [Process(world, f"search-{number}") for number in range(8)]
        for one in joining:
            one.maps.show()
        first.maps.tend()
        assert first.size(town) == SUBMAPS, "the others are still loading"
        for one in joining:
            one.maps.tend()
        first.maps.tend()
        assert [one.size(town) for one in (first, *joining)].count(SUBMAPS) == 1
        assert elsewhere(world).nearest(question(world)).searched == SUBMAPS
        for one in joining:
            one.server.stop(0.0)


async def test_a_deleted_map_leaves_the_memory_of_its_process(world):
    town = question(world).map_number
    with running(world, "search-a") as (process,):
        assert process.size(town) == SUBMAPS
        await world.use_cases.maps.delete(TENANT, SESSION.map_id)
        process.maps.tend()
        assert process.size(town) == 0 and not process.maps.holds(town)


def test_a_process_that_shows_itself_no_more_is_asked_no_more(world):
    gone = LivingProcess("search-gone", ProcessRole.SEARCH, "127.0.0.1:1", ready=True)
    world.context.transactions.write(lambda uow: uow.processes.announce(gone)).result()
    world.clock.ms += client.ALIVE_WITHIN_MS + 1
    with running(world, "search-a"):
        alive = world.context.transactions.read(client.search_processes).result()
        assert [one.process_id for one in alive] == ["search-a"]


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
@pytest.mark.parametrize(("error", "ends"), [(StorageUncertain("the database failed"), False), (OSError(), True)])
def test_a_round_without_a_database_is_put_off_and_any_other_failure_ends_the_process(error, ends):
    done, failed, outcomes = threading.Event(), threading.Event(), iter([None, error, error, None])

    def work():
        outcome = next(outcomes, done)
        if outcome is done:
            done.set()
        elif outcome is not None:
            raise outcome

    rounds = Rounds(work, 0.001, failed.set)
    assert (failed if ends else done).wait(PATIENCE_S)
    rounds.stop()
    assert failed.is_set() is ends
