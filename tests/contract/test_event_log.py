"""The contract of EventLog, and what the other repositories write into it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from revisit.service.domain.events import EventRecord, map_of
from revisit.service.domain.identity import TenantId
from tests.support.records import TENANT, a_job, a_loop, a_map, a_session, a_submap

OTHER = TenantId("other")


@pytest.fixture(autouse=True)
def maps(write):
    """The maps that something happens in: an event of another is none."""
    write(lambda uow: [uow.maps.add(a_map(*of)) for of in (("town", TENANT), ("yard", TENANT), ("town", OTHER))])


def note(uow, map_id="town", subject="x", tenant=TENANT):
    uow.events.record(EventRecord(tenant, map_id, "OPERATION", subject))


def told(read, after=0, tenant=TENANT, map_id="town", limit=100):
    return read(lambda uow: uow.events.following(tenant, map_id, after, limit))


def last(read, map_id="town", tenant=TENANT):
    return read(lambda uow: uow.events.last_numbers([(tenant, map_id)])).get((tenant, map_id))


def test_events_are_numbered_within_their_map(write, read):
    for map_id, subject, tenant in (("town", "a", TENANT), ("yard", "b", TENANT), ("town", "c", OTHER)):
        write(lambda uow, row=(map_id, subject, tenant): note(uow, *row))
    write(lambda uow: note(uow, "town", "d"))
    assert [(event.number, event.subject) for event in told(read)] == [(1, "a"), (2, "d")]
    assert [(event.number, event.subject) for event in told(read, map_id="yard")] == [(1, "b")]
    assert [(event.number, event.subject) for event in told(read, tenant=OTHER)] == [(1, "c")]
    assert [event.subject for event in told(read, after=1)] == ["d"]
    assert [event.subject for event in told(read, limit=1)] == ["a"]
    assert (last(read), last(read, "yard"), last(read, "elsewhere")) == (2, 1, None)


def test_several_events_of_a_transaction_are_numbered_in_their_order(write, read):
    def several(uow):
        for map_id, subject in (("yard", "a"), ("town", "b"), ("yard", "c"), ("town", "d")):
            note(uow, map_id, subject)

    write(several)
    assert [(event.number, event.subject) for event in told(read)] == [(1, "b"), (2, "d")]
    assert [(event.number, event.subject) for event in told(read, map_id="yard")] == [(1, "a"), (2, "c")]


def test_a_map_that_is_made_anew_goes_on_with_the_numbers_of_the_former(write, read):
    write(lambda uow: note(uow, subject="a"))
    write(lambda uow: uow.maps.delete(TENANT, map_id="town"))
    assert last(read) is None
    write(lambda uow: note(uow, subject="of no map"))
    write(lambda uow: uow.maps.add(a_map()))
    write(lambda uow: note(uow, subject="b"))
    assert [(event.number, event.subject) for event in told(read, after=1)] == [(2, "b")]
    assert last(read) == 2 and last(read, "yard") == 0


def test_what_is_forgotten_leaves_a_sign_and_the_newest(write, read):
    for subject in "abcdef":
        write(lambda uow, subject=subject: note(uow, subject=subject))
    write(lambda uow: note(uow, subject="g", tenant=OTHER))
    assert write(lambda uow: uow.events.forget(2)) == 4
    assert [(event.kind, event.subject, event.number) for event in told(read)] == [
        ("FORGOTTEN", "", 4), ("OPERATION", "e", 5), ("OPERATION", "f", 6),
    ]  # fmt: skip
    assert [event.kind for event in told(read, limit=1)] == ["FORGOTTEN"]
    assert [event.number for event in told(read, after=4)] == [5, 6]
    assert told(read, map_id="yard") == []
    assert [event.subject for event in told(read, tenant=OTHER)] == ["g"]
    assert write(lambda uow: uow.events.forget(2)) == 0
    assert last(read) == 6


def test_a_job_is_an_event_when_its_state_changes_and_not_with_each_heartbeat(write, read):
    subject = "maps/town/sessions/monday/submaps/a"
    write(lambda uow: uow.queue.enqueue(a_job("op-1", subject=subject)))
    lease = write(lambda uow: uow.queue.claim("w"))
    write(lambda uow: uow.queue.extend(lease))
    write(lambda uow: uow.queue.complete(lease, {}))
    events = told(read, map_id="town")
    assert [(event.kind, event.subject) for event in events] == [("OPERATION", "op-1")] * 3


def test_a_query_that_a_client_waits_for_is_no_event(write, read):
    write(lambda uow: uow.queue.enqueue(a_job("op-1", subject="maps/town", kind="LOCALIZE", priority=0)))
    assert told(read) == []


def test_a_loop_is_an_event_when_it_is_accepted_or_changes(write, read):
    def fill(uow):
        uow.sessions.add(a_session())
        numbers = [uow.submaps.add(a_submap(name, ordinal=at)).number for at, name in enumerate("ab")]
        accepted = uow.loops.add(a_loop(numbers[1], numbers[0]))
        rejected = replace(accepted, loop_id="no", state="REJECTED", reason="TOO_DIFFERENT")
        uow.loops.add(replace(rejected, loop_id="maybe", reason="AMBIGUOUS"))
        return accepted, uow.loops.add(rejected)

    accepted, rejected = write(fill)
    assert [event.subject for event in told(read)] == [accepted.loop_id, "maybe"]
    write(lambda uow: uow.loops.replace(replace(accepted, evidence={"more": 1})))
    assert len(told(read)) == 2
    write(lambda uow: uow.loops.replace(replace(rejected, state="ACCEPTED", reason=None)))
    assert [event.subject for event in told(read)][2:] == ["no"]


def test_a_change_that_is_undone_is_no_event(write, read):
    def fails(uow):
        note(uow)
        raise RuntimeError("half way")

    with pytest.raises(RuntimeError):
        write(fails)
    assert told(read) == []


def test_the_map_of_a_subject_is_in_its_name():
    assert map_of("maps/town/sessions/monday/submaps/a") == map_of("maps/town") == "town"
    assert map_of("robots/rover") == map_of("") == ""
