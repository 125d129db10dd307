"""The contract of Transactions, UnitOfWork and its repositories."""

from __future__ import annotations

import threading
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from revisit.service.domain.errors import AlreadyExists, NotFound
from revisit.service.domain.identity import TenantId
from revisit.service.ports.repositories import FoundSubmap, LoopEnds
from revisit.service.ports.storage import require_map
from tests.support.memory.transactions import MemoryTransactions
from tests.support.records import TENANT, a_loop, a_map, a_robot, a_scan, a_session, a_submap

OTHER = TenantId("other")


def fill(uow):
    uow.maps.add(a_map())
    uow.robots.add(a_robot())
    session = uow.sessions.add(a_session(robot_id="rover"))
    scan = uow.scans.add(a_scan())
    first = uow.submaps.add(a_submap("a", descriptor=b"\x00\x00\x80?"))
    second = uow.submaps.add(a_submap("b", ordinal=1))
    loop = uow.loops.add(a_loop(second.number, first.number))
    return session, scan, first, second, loop


def test_what_is_written_is_read_back_bit_for_bit(write, read):
    session, scan, first, second, loop = write(fill)
    assert read(lambda uow: uow.sessions.get(TENANT, "town", "monday")) == session
    assert read(lambda uow: uow.scans.get(TENANT, "town", "monday", 1)) == scan
    assert read(lambda uow: uow.submaps.get(TENANT, "town", "monday", "a")) == replace(first, seq=1)
    assert read(lambda uow: uow.submaps.get(TENANT, "town", "monday", "b")) == replace(second, seq=2)
    assert read(lambda uow: uow.loops.get(TENANT, "town", loop.loop_id)) == replace(loop, seq=1)


def test_an_exception_undoes_the_whole_transaction(write, read):
    def fails(uow):
        uow.maps.add(a_map())
        raise RuntimeError("half way")

    with pytest.raises(RuntimeError, match="half way"):
        write(fails)
    assert read(lambda uow: uow.maps.count(TENANT)) == 0


def test_what_reads_in_memory_cannot_write():
    store = MemoryTransactions()
    store.write(fill).result()
    before = store.read_here(lambda uow: uow.maps.find(TENANT))
    changed = replace(before[0], graph_edits=7)
    for work in (lambda uow: uow.maps.add(a_map("other")), lambda uow: uow.maps.replace(changed)):
        with pytest.raises(TypeError):
            store.read_here(work)
    assert store.read_here(lambda uow: uow.maps.find(TENANT)) == before


def test_the_version_is_another_one_after_every_commit_and_after_nothing_else(transactions, write, read):
    untold = transactions.version() is None
    seen = [transactions.version()]
    for name in ("a", "b"):
        write(lambda uow, name=name: uow.maps.add(a_map(name)))
        assert untold or transactions.version() not in seen
        seen.append(transactions.version())
    assert read(lambda uow: uow.maps.count(TENANT)) == 2
    assert transactions.version() == seen[-1]


def test_a_taken_key_is_refused_and_another_tenant_may_take_it(write):
    write(lambda uow: uow.maps.add(a_map()))
    with pytest.raises(AlreadyExists):
        write(lambda uow: uow.maps.add(a_map()))
    write(lambda uow: uow.maps.add(a_map(tenant=OTHER)))


def test_numbers_grow_and_are_never_used_again(write):
    first = write(lambda uow: uow.maps.add(a_map("a")))
    second = write(lambda uow: uow.maps.add(a_map("b")))
    write(lambda uow: uow.maps.delete(TENANT, map_id="b"))
    third = write(lambda uow: uow.maps.add(a_map("c")))
    assert 0 < first.number < second.number < third.number


def test_a_thread_that_may_wait_reads_for_itself(transactions, write):
    write(lambda uow: uow.maps.add(a_map()))
    assert transactions.read_here(lambda uow: (uow.maps.count(TENANT), threading.get_ident())) == (
        1,
        threading.get_ident(),
    )
    with pytest.raises(NotFound):
        transactions.read_here(lambda uow: require_map(uow, TENANT, "village"))


def test_find_filters_pages_and_keeps_the_tenant(write, read):
    for map_id in "abcde":
        write(lambda uow, map_id=map_id: uow.maps.add(a_map(map_id)))
    write(lambda uow: uow.maps.add(a_map("z", tenant=OTHER)))
    second = read(lambda uow: uow.maps.find(TENANT, limit=2))[-1]
    rest = read(lambda uow: uow.maps.find(TENANT, after=second.number))
    assert [record.map_id for record in rest] == ["c", "d", "e"]
    assert [r.map_id for r in read(lambda uow: uow.maps.find(TENANT, map_id="d"))] == ["d"]
    everyone = [
        read(lambda uow: uow.maps.of_all_tenants()),
        read(lambda uow: uow.maps.of_all_tenants(after=second.number)),
    ]
    assert [[record.map_id for record in records] for records in everyone] == [list("abcdez"), list("cdez")]
    assert [record.map_id for record in read(lambda uow: uow.maps.of_all_tenants(limit=2))] == ["a", "b"]
    assert read(lambda uow: uow.maps.count(TENANT)) == 5
    assert read(lambda uow: uow.maps.count(OTHER, map_id="a")) == 0
    assert read(lambda uow: uow.maps.get(OTHER, "a")) is None


def test_the_sessions_of_a_storey_are_told_and_those_of_none(write, read):
    storeys = {"garage": "B1", "roof": "5", "garage-again": "B1", "ramp": None}
    write(lambda uow: uow.maps.add(a_map()))
    numbers = {
        name: write(lambda uow, named=replace(a_session(name), storey=storey): uow.sessions.add(named).number)
        for name, storey in storeys.items()
    }

    def told(storey):
        return read(lambda uow: uow.sessions.distinct(TENANT, "number", map_id="town", storey=storey))

    assert told("B1") == {numbers["garage"], numbers["garage-again"]}
    assert told(None) == {numbers["ramp"]}
    assert told("B2") == set()
    assert read(lambda uow: uow.sessions.get(TENANT, "town", "roof")).storey == "5"


def test_the_values_of_a_field_are_told_once_without_those_of_others(write, read):
    *_, first, second, _ = write(fill)
    write(lambda uow: uow.submaps.replace(replace(first, state="DESCRIBED", place_sha256="s" * 64)))
    assert read(lambda uow: uow.submaps.distinct(TENANT, "operation_id")) == {"op-1"}
    assert read(lambda uow: uow.submaps.distinct(TENANT, "place_sha256")) == {"s" * 64}
    assert read(lambda uow: uow.submaps.distinct(TENANT, "number")) == {first.number, second.number}
    assert read(lambda uow: uow.submaps.distinct(TENANT, "submap_id", map_id="town", state="QUEUED")) == {"b"}
    assert read(lambda uow: uow.submaps.distinct(OTHER, "operation_id")) == set()


def test_records_are_found_by_their_numbers_within_the_tenant(write, read):
    ours = write(lambda uow: uow.maps.add(a_map()))
    theirs = write(lambda uow: uow.maps.add(a_map(tenant=OTHER)))
    assert read(lambda uow: uow.maps.numbered(TENANT, [theirs.number, 999, ours.number])) == {ours.number: ours}
    assert read(lambda uow: uow.maps.numbered(TENANT, [])) == {}


def test_what_a_search_tells_of_submaps_is_read_by_number_within_a_tenant(write, read):
    *_, first, second, _ = write(fill)
    names = first.map_id, first.session_id, first.submap_id
    told = FoundSubmap(first.number, *names, first.position_m)
    assert read(lambda uow: uow.submaps.found(TENANT, [first.number, 999])) == {first.number: told}
    assert read(lambda uow: uow.submaps.found(OTHER, [second.number])) == {}


def test_the_loops_of_some_queries_that_tell_anything_are_read_at_once(write, read):
    *_, first, second, _ = write(fill)

    def more(uow):
        third = uow.submaps.add(a_submap("c", ordinal=2))
        rejected = replace(a_loop(first.number, third.number), state="REJECTED", reason="AMBIGUOUS")
        uow.loops.add(a_loop(third.number, first.number))
        uow.loops.add(rejected)
        uow.loops.add(replace(rejected, loop_id="other", reason="LOW_OVERLAP"))
        return third

    third = write(more)
    asked = [third.number, first.number]
    told = read(lambda uow: uow.loops.telling(TENANT, asked, ["AMBIGUOUS"]))
    assert [(one.query_number, one.match_number, one.reason) for one in told] == [
        (first.number, third.number, "AMBIGUOUS"),
        (third.number, first.number, None),
    ]
    assert told[1].evidence == {"inliers": 12, "rmse_m": 0.1}
    assert read(lambda uow: uow.loops.telling(OTHER, asked, ["AMBIGUOUS"])) == []
    assert [one.query_number for one in read(lambda uow: uow.loops.telling(TENANT, [second.number], ["X"]))] == [
        second.number
    ]
    assert read(lambda uow: uow.loops.telling(TENANT, [], ["AMBIGUOUS"])) == []


def test_the_ends_of_loops_that_were_rejected_for_some_reasons_are_told_by_number(write, read):
    *_, first, second, _ = write(fill)
    low = replace(a_loop(first.number, second.number), state="REJECTED", reason="LOW_OVERLAP")
    alike = replace(low, loop_id="alike", reason="AMBIGUOUS")
    by_hand = replace(low, loop_id="by hand", manual=True)
    write(lambda uow: uow.loops.add_all([*(replace(low, loop_id=name) for name in "xyz"), alike, by_hand]))
    numbers = {loop.loop_id: loop.number for loop in read(lambda uow: uow.loops.find(TENANT))}

    def told(tenant=TENANT, after=0, reasons=("LOW_OVERLAP", "LOW_SCORE")):
        return read(lambda uow: uow.loops.rejected(tenant, "town", reasons, after=after, limit=2))

    ends = first.number, first.session_id, second.number, second.session_id
    assert told() == [LoopEnds(numbers[name], *ends) for name in "xy"]
    assert [one.number for one in told(after=numbers["y"])] == [numbers["z"]]
    assert [one.number for one in told(reasons=["AMBIGUOUS"])] == [numbers["alike"]]
    assert told(OTHER) == [] and told(reasons=[]) == []


def test_accepted_loops_are_told_by_number_with_the_covariance_that_was_measured(write, read):
    *_, first, second, loop = write(fill)
    rng = np.random.default_rng(1)
    some = {
        "measured": {"measurement": {"rmse_m": 0.1, "covariance": rng.normal(size=(6, 6)).tolist(), "rivals": []}},
        "flat": {"recall": {"reason": "x"}, "measurement": {"covariance": rng.normal(size=36).tolist()}},
        "quoted": {"doubts": {"X": {"words": '"covariance":[1]'}}, "measurement": {"covariance": [[1.5] * 6] * 6}},
        "twice": {"covariance": 3, "measurement": {"covariance": [[0.25] * 6] * 6}},
        "none": {"measurement": {}},
    }
    made = [replace(a_loop(first.number, second.number), loop_id=one, evidence=its) for one, its in some.items()]
    rejected = replace(made[0], loop_id="rejected", state="REJECTED", reason="LOW_OVERLAP")
    write(lambda uow: uow.loops.add_all([*made, rejected]))

    def told(after=loop.number, limit=9, tenant=TENANT):
        return read(lambda uow: uow.loops.measured(tenant, "town", after=after, limit=limit))

    for one in told():
        assert one.evidence.get("measurement", {}).get("covariance", []) == some[one.loop_id]["measurement"].get(
            "covariance", []
        )
        stored = read(lambda uow, one=one: uow.loops.get(TENANT, "town", one.loop_id))
        assert replace(stored, evidence=one.evidence) == one
    assert [one.loop_id for one in told()] == list(some) and told(0, tenant=OTHER) == []
    assert [one.loop_id for one in told(after=0, limit=2)] == [loop.loop_id, "measured"]


def test_loops_are_in_the_order_in_which_they_were_accepted(write, read):
    *_, first, second, loop = write(fill)
    one, other, rejected = (replace(a_loop(first.number, second.number), loop_id=name) for name in "xyz")
    rejected = write(lambda uow: uow.loops.add(replace(rejected, state="REJECTED", reason="AMBIGUOUS")))
    write(lambda uow: uow.loops.add_all([one, other]))
    write(lambda uow: uow.loops.replace(replace(rejected, state="ACCEPTED", reason=None)))

    def accepted(**asked):
        return read(lambda uow: uow.loops.accepted(TENANT, "town", **asked))

    assert [one.loop_id for one in accepted()] == [loop.loop_id, "x", "y", "z"]
    seqs = [one.seq for one in accepted()]
    assert (
        seqs == sorted(set(seqs))
        and seqs[-1] == read(lambda uow: uow.events.last_numbers([(TENANT, "town")]))[TENANT, "town"]
    )
    assert [one.loop_id for one in accepted(after=seqs[0], limit=2)] == ["x", "y"]
    assert [one.loop_id for one in accepted(query_session_id="elsewhere")] == []
    again = accepted()[1]
    write(lambda uow: uow.loops.replace(replace(again, graph_state="SET_ASIDE")))
    assert [one.loop_id for one in accepted(graph_state=None)] == [loop.loop_id, "y", "z"]
    assert read(lambda uow: uow.loops.accepted(OTHER, "town")) == []


def test_submaps_after_a_number_of_their_map_are_told_with_their_places(write, read):
    *_, first, second, _ = write(fill)
    placed = read(lambda uow: uow.submaps.placed(TENANT, "town"))
    seqs = {one.number: one.seq for one in read(lambda uow: uow.submaps.find(TENANT))}
    assert [one.number for one in placed] == [first.number, second.number]
    later = read(lambda uow: uow.submaps.placed(TENANT, "town", after=seqs[first.number]))
    assert later == placed[1:]


def test_replace_changes_one_record_and_needs_it_to_exist(write, read):
    record = write(lambda uow: uow.maps.add(a_map()))
    write(lambda uow: uow.maps.replace(replace(record, model_version="m-1")))
    assert read(lambda uow: uow.maps.get(TENANT, "town")).model_version == "m-1"
    with pytest.raises(NotFound):
        write(lambda uow: uow.maps.replace(replace(record, number=999)))


def test_many_records_are_stored_and_revised_at_once(write, read):
    _, _, first, second, loop = write(fill)
    others = [replace(a_loop(second.number, first.number), loop_id=f"loop-{n}") for n in range(3)]
    write(lambda uow: uow.loops.add_all(others))
    stored = read(lambda uow: uow.loops.find(TENANT, map_id="town"))
    assert [one.loop_id for one in stored] == [loop.loop_id, "loop-0", "loop-1", "loop-2"]
    told = [replace(one, evidence={"told": "by its number"}) for one in stored[1:]]
    write(lambda uow: uow.loops.revise(told, graph_state="IN_MAP"))
    revised = read(lambda uow: uow.loops.find(TENANT, map_id="town"))
    assert revised == [stored[0], *(replace(one, graph_state="IN_MAP") for one in stored[1:])]
    write(lambda uow: uow.loops.add_all([]))
    with pytest.raises(AlreadyExists):
        write(lambda uow: uow.loops.add_all(others[:1]))
    write(lambda uow: uow.loops.delete(TENANT, loop_id="loop-2"))
    with pytest.raises(NotFound):
        write(lambda uow: uow.loops.revise(stored, graph_state=None))
    assert read(lambda uow: uow.loops.find(TENANT, map_id="town")) == revised[:3]


def test_delete_takes_what_find_would_give_of_this_tenant(write, read):
    write(lambda uow: uow.maps.add(a_map("a")))
    write(lambda uow: uow.maps.add(a_map("a", tenant=OTHER)))
    assert read(lambda uow: uow.maps.count_of_all_tenants(map_id="a")) == 2
    assert write(lambda uow: uow.maps.delete(TENANT, map_id="a")) == 1
    assert read(lambda uow: uow.maps.count(OTHER)) == 1
    assert read(lambda uow: (uow.maps.count_of_all_tenants(), uow.maps.count_of_all_tenants(map_id="b"))) == (1, 0)


def chosen_seqs(read, first, last, newest=None):
    scans = read(lambda uow: uow.scans.chosen_between(TENANT, "town", "monday", first, last, newest))
    return [scan.seq for scan in scans]


def test_scans_are_found_by_distance_and_by_number(write, read):
    def add(uow):
        uow.maps.add(a_map())
        uow.sessions.add(a_session())
        for seq in range(1, 6):
            uow.scans.add(a_scan(seq, travelled_m=1.5 * (seq - 1)))

    write(add)
    assert read(lambda uow: uow.scans.first_seq_from(TENANT, "town", "monday", 3.0)) == 3
    assert read(lambda uow: uow.scans.first_seq_from(TENANT, "town", "monday", 3.1)) == 4
    assert read(lambda uow: uow.scans.first_seq_from(TENANT, "town", "monday", 99.0)) is None
    write(lambda uow: uow.scans.revise(uow.scans.with_seqs(TENANT, "town", "monday", [1, 3, 5]), chosen=True))
    chosen = partial(chosen_seqs, read)
    assert (chosen(1, 5), chosen(2, 4), chosen(1, 5, 2), chosen(6, 9)) == ([1, 3, 5], [3], [3, 5], [])
    found = read(lambda uow: uow.scans.with_seqs(TENANT, "town", "monday", [4, 2, 99]))
    assert [scan.seq for scan in found] == [2, 4]


def test_the_first_that_waits_in_a_map_is_one_of_this_tenant(write, read):
    _, _, first, second, _ = write(fill)

    def first_waiting(tenant, map_id):
        return read(lambda uow: uow.submaps.first_waiting(tenant, map_id))

    assert first_waiting(TENANT, "town") == first.number
    write(lambda uow: uow.submaps.replace(replace(first, state="DESCRIBED")))
    assert first_waiting(TENANT, "town") == second.number
    assert first_waiting(TENANT, "elsewhere") is first_waiting(OTHER, "town") is None


def test_the_first_with_loops_that_are_searched_for_is_one_of_this_tenant(write, read):
    _, _, first, second, _ = write(fill)

    def first_unsearched(tenant, map_id):
        return read(lambda uow: uow.submaps.first_unsearched(tenant, map_id))

    assert first_unsearched(TENANT, "town") is None
    write(lambda uow: uow.submaps.revise([first, second], searched=False))
    assert first_unsearched(TENANT, "town") == first.number
    write(lambda uow: uow.submaps.revise([first], searched=True))
    assert first_unsearched(TENANT, "town") == second.number
    assert first_unsearched(TENANT, "elsewhere") is first_unsearched(OTHER, "town") is None


def test_the_path_of_a_session_is_read_from_a_submap_on_and_back(write, read):
    def add(uow):
        uow.maps.add(a_map())
        uow.sessions.add(a_session())
        for ordinal in (3, 0, 2, 5):
            uow.submaps.add(a_submap(submap_id=f"s{ordinal}", ordinal=ordinal, position_m=(float(ordinal), 0.0, 0.0)))

    write(add)

    def path(ordinal, limit, tenant=TENANT, **direction):
        found = read(lambda uow: uow.submaps.path(tenant, "town", "monday", ordinal, limit, **direction))
        return [(one.ordinal, one.position_m[0]) for one in found]

    assert path(0, 9) == [(2, 2.0), (3, 3.0), (5, 5.0)]
    assert path(0, 2) == [(2, 2.0), (3, 3.0)]
    assert path(5, 2, back=True) == [(3, 3.0), (2, 2.0)]
    assert path(0, 9, back=True) == path(0, 9, tenant=OTHER) == []


def test_flags_and_failures_of_a_session_are_counted_of_this_tenant(write, read):
    _, _, first, second, _ = write(fill)
    write(lambda uow: uow.submaps.replace(replace(first, flags=("pose_jump", "mirrored"))))
    write(lambda uow: uow.submaps.replace(replace(second, flags=("pose_jump",), failure_code="UNUSABLE_CLOUD")))

    def counted(tenant, session_id):
        return read(lambda uow: uow.submaps.flag_counts(tenant, "town", session_id))

    assert counted(TENANT, first.session_id) == {"pose_jump": 2, "mirrored": 1, "UNUSABLE_CLOUD": 1}
    assert counted(TENANT, "elsewhere") == counted(OTHER, first.session_id) == {}


def test_submaps_are_numbered_within_their_map_and_a_number_outlives_its_submap(write, read):
    def last(tenant, map_id="town"):
        return read(lambda uow: uow.submaps.last_seq(tenant, map_id))

    assert last(TENANT) == 0
    _, _, _, second, loop = write(fill)
    assert [one.seq for one in read(lambda uow: uow.submaps.find(TENANT))] == [1, 2]
    write(lambda uow: uow.loops.delete(TENANT, loop_id=loop.loop_id))
    write(lambda uow: uow.submaps.delete(TENANT, number=second.number))
    assert (last(TENANT), last(TENANT, "elsewhere"), last(OTHER)) == (2, 0, 0)


def test_the_change_log_tells_additions_and_removals_in_order(write, read):
    *_, first, second, _ = write(fill)
    town = read(lambda uow: uow.maps.get(TENANT, "town"))
    write(lambda uow: uow.changes.record_described(town, first.number))
    write(lambda uow: uow.changes.record_described(town, second.number))
    assert [one.entered for one in read(lambda uow: uow.submaps.find(TENANT))] == [1, 2]
    write(lambda uow: uow.changes.record_removed(town, {second.number, first.number}))
    write(lambda uow: uow.changes.record_removed(town, ()))
    changes = read(lambda uow: uow.changes.since(TENANT, town.number, 0))
    assert [change.seq for change in changes] == [1, 2, 3, 4]
    assert [change.submap_number for change in changes[2:]] == [first.number, second.number]
    assert (changes[0].vector, changes[0].ordinal, changes[0].position_m) == (b"\x00\x00\x80?", 0, (0.1, 0.2, 0.3))
    assert changes[2].vector is changes[3].vector is None
    assert [change.seq for change in read(lambda uow: uow.changes.since(TENANT, town.number, 2))] == [3, 4]
    assert [change.seq for change in read(lambda uow: uow.changes.since(TENANT, town.number, 1, limit=1))] == [2]
    assert read(lambda uow: uow.changes.since(TENANT, town.number + 1, 0)) == []
    assert read(lambda uow: uow.changes.since(OTHER, town.number, 0)) == []


def test_a_submap_that_has_gone_appears_only_as_removed(write, read):
    *_, first, _, loop = write(fill)
    town = read(lambda uow: uow.maps.get(TENANT, "town"))
    write(lambda uow: uow.changes.record_described(town, first.number))

    def remove(uow):
        uow.loops.delete(TENANT, number=loop.number)
        uow.submaps.delete(TENANT, number=first.number)
        uow.changes.record_removed(town, [first.number])

    write(remove)
    assert [change.vector for change in read(lambda uow: uow.changes.since(TENANT, town.number, 0))] == [None, None]


def test_workers_are_alive_while_they_beat(write, read, clock):
    def alive(within_ms):
        return [worker.worker_id for worker in read(lambda uow: uow.workers.alive(within_ms))]

    for worker_id, clock.ms in (("w3", 0), ("w1", 400), ("w2", 500), ("w1", 600)):
        write(lambda uow, worker_id=worker_id: uow.workers.beat(worker_id, "m"))
    assert alive(300) == ["w1", "w2"]
    assert alive(50) == ["w1"]
    assert read(lambda uow: uow.workers.silent(400)) == ["w3"]
    write(lambda uow: uow.workers.forget("w1"))
    assert alive(300) == ["w2"]


def test_the_standings_of_submaps_are_read_by_map_and_by_session(write, read):
    *_, first, second, _ = write(fill)
    write(lambda uow: uow.sessions.add(a_session("tuesday")))
    third = write(
        lambda uow: uow.submaps.add(a_submap("c", session_id="tuesday", kept_scans="NONE", described_at_ns=7))
    )
    write(lambda uow: uow.maps.add(a_map(tenant=OTHER)))
    all_of_it = read(lambda uow: uow.submaps.standings(TENANT, "town"))
    assert [one.number for one in all_of_it] == [first.number, second.number, third.number]
    (of_tuesday,) = read(lambda uow: uow.submaps.standings(TENANT, "town", "tuesday"))
    assert of_tuesday == all_of_it[-1] and (of_tuesday.kept_scans, of_tuesday.described_at_ns) == ("NONE", 7)
    assert read(lambda uow: uow.submaps.standings(OTHER, "town")) == []


@pytest.mark.parametrize(
    ("stamp_ns", "limit", "found"),
    [(20, 1, [2]), (29, 2, [2, 5]), (0, 2, [1, 2]), (70, 9, [7]), (99, 9, [7]), (0, 99, [1, 2, 5, 6, 7])],
)
def test_scans_around_a_time_are_those_from_the_last_one_before_it_on(write, read, stamp_ns, limit, found):
    def add(uow):
        uow.maps.add(a_map())
        for session in ("monday", "tuesday"):
            uow.sessions.add(a_session(session))
        for seq in (1, 2, 5, 6, 7):  # the others were not kept
            uow.scans.add(replace(a_scan(seq), stamp_ns=10 * seq))
        uow.scans.add(replace(a_scan(9), session_id="tuesday", stamp_ns=stamp_ns))

    write(add)
    scans = read(lambda uow: uow.scans.around(TENANT, "town", "monday", stamp_ns, limit))
    assert [scan.seq for scan in scans] == found
    assert read(lambda uow: uow.scans.around(TENANT, "town", "sunday", stamp_ns, limit)) == []
