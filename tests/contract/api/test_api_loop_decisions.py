"""What people decide about loop closures, the same over REST and gRPC: each change is an event with who and why."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from revisit.core.geometry import se3
from revisit.sdk import explanations
from revisit.sdk.errors import AlreadyExists, FailedPrecondition, InvalidArgument, NotFound
from revisit.sdk.resources import LoopClosure, SearchHit
from tests.support.service_world import cloud_points, pose


@pytest.fixture
def loops(client, session, town):
    """The loops of three submaps in a row, by their state; a and c show one place, to which the drive comes back."""
    for name, place, x_m in (("a", 1, 0.0), ("b", 2, 20.0), ("c", 1, 1.0)):
        operation = client.post_submap(session, name, cloud_points(place), pose(x_m), 1)
        client.wait(operation)
    return {loop.state: loop for loop in client.loop_closures(town, state="ALL")}


def history(client, loop):
    return [(event.kind, event.state, event.reason) for event in client.loop_closure_events(loop)]


def test_a_verdict_is_the_first_event_of_a_loop(client, loops):
    (event,) = client.loop_closure_events(loops["ACCEPTED"])
    assert (event.kind, event.state, event.actor, event.note) == ("VERIFIED", "ACCEPTED", "service", "")
    told = {name: loops["ACCEPTED"].evidence[name] for name in ("model_version", "thresholds", "thresholds_version")}
    assert event.details == told and told["model_version"] == "fake-1"
    assert event.at_ns == loops["ACCEPTED"].created_at_ns
    np.testing.assert_allclose(event.T_match_query, loops["ACCEPTED"].T_match_query)


def test_a_client_that_names_no_state_is_told_the_accepted_loops_alone(client, session, loops, town):
    client.wait(client.post_submap(session, "d", cloud_points(3), pose(20.5), 1))  # back at b, and unlike it
    rejected = client.loop_closures(town, state="REJECTED")[0]
    assert {loop.state for loop in client.loop_closures(town, state="ALL")} == {"ACCEPTED", "REJECTED"}
    assert [loop.name for loop in client.loop_closures(town)] == [loops["ACCEPTED"].name]
    assert rejected.name in {loop.name for loop in client.loop_closures(town, reason=rejected.reason)}


def test_a_loop_is_rejected_taken_back_and_rejected_again(client, loops, town):
    loop = loops["ACCEPTED"]
    rejected = client.reject_loop_closure(loop, note="two halls that look alike")
    assert (rejected.state, rejected.reason, rejected.name) == ("REJECTED", "OVERRULED", loop.name)
    assert loop.name not in {one.name for one in client.loop_closures(town, state="ACCEPTED")}
    assert client.reject_loop_closure(loop).state == "REJECTED"
    again = client.revert_loop_closure(loop, note="they are one hall")
    assert again.number > loop.number  # it is accepted once more, and watches tell it again
    assert replace(again, number=loop.number) == loop
    client.reject_loop_closure(loop)
    assert history(client, loop) == [
        ("VERIFIED", "ACCEPTED", None),
        ("REJECTED", "REJECTED", "OVERRULED"),
        ("REVERTED", "ACCEPTED", None),
        ("REJECTED", "REJECTED", "OVERRULED"),
    ]
    events = client.loop_closure_events(loop)
    assert [event.note for event in events] == ["", "two halls that look alike", "they are one hall", ""]
    assert [event.actor for event in events] == ["service", "anyone", "anyone", "anyone"]


def test_nobody_takes_back_what_nobody_decided(client, loops):
    with pytest.raises(InvalidArgument):
        client.revert_loop_closure(loops["ACCEPTED"])
    client.reject_loop_closure(loops["ACCEPTED"])
    client.revert_loop_closure(loops["ACCEPTED"])
    with pytest.raises(InvalidArgument):
        client.revert_loop_closure(loops["ACCEPTED"])


def test_a_loop_that_a_person_rejected_moves_nothing(client, loops, town):
    first = client.wait(client.optimise_map(town))
    assert first.result["loops_in_map"] == 1
    assert client.get_loop_closure(loops["ACCEPTED"].name).graph_state == "IN_MAP"
    rejected = client.reject_loop_closure(loops["ACCEPTED"])
    assert rejected.graph_state is None
    second = client.wait(client.optimise_map(town))
    assert (second.result["loops_in_map"], second.result["loops_set_aside"]) == (0, 0)
    kinds = [event.kind for event in client.loop_closure_events(loops["ACCEPTED"])]
    assert kinds == ["VERIFIED", "JUDGED", "REJECTED"]
    judged = client.loop_closure_events(loops["ACCEPTED"])[1]
    assert (judged.graph_state, judged.map_version) == ("IN_MAP", 1)
    assert 0.0 <= judged.details["squared_distance"] < 22.5


def test_a_loop_without_an_alignment_cannot_be_accepted(client, session, loops):
    done = client.wait(client.create_loop_closure(f"{session.name}/submaps/b", f"{session.name}/submaps/a"))
    with pytest.raises(InvalidArgument) as refused:
        client.accept_loop_closure(done.subject)
    assert "alignment" in refused.value.message


def test_a_loop_by_hand_is_verified_around_the_pose_that_the_person_named(client, session, loops):
    a, c = (f"{session.name}/submaps/{name}" for name in "ac")
    near = se3.from_yaw(0.3, (2.0, -1.0, 0.0))
    done = client.wait(client.create_loop_closure(c, a, T_match_query=near, note="seen by eye"))
    loop = client.get_loop_closure(done.subject)
    assert (done.kind, done.result["state"]) == ("VERIFY_LOOP", "ACCEPTED")
    assert (loop.state, loop.manual, loop.query, loop.match) == ("ACCEPTED", True, c, a)
    np.testing.assert_allclose(loop.T_match_query, near, rtol=0, atol=1e-12)
    assert loop.similarity == pytest.approx(1.0)
    proposed, verified = client.loop_closure_events(loop)
    assert (proposed.kind, proposed.state, proposed.note) == ("PROPOSED", "PROPOSED", "seen by eye")
    assert (verified.kind, verified.actor) == ("VERIFIED", "service")
    assert verified.details["model_version"] == "fake-1"


def test_a_loop_by_hand_that_geometry_rejects_may_be_accepted_all_the_same(client, session, loops):
    a, b = (f"{session.name}/submaps/{name}" for name in "ab")
    done = client.wait(client.create_loop_closure(b, a, T_match_query=pose(1.0)))
    rejected = client.get_loop_closure(done.subject)
    assert (rejected.state, rejected.reason) == ("REJECTED", "LOW_OVERLAP")
    accepted = client.accept_loop_closure(rejected, note="the wall was painted")
    assert (accepted.state, accepted.reason) == ("ACCEPTED", None)
    assert client.revert_loop_closure(accepted) == replace(rejected, number=accepted.number)
    without = client.wait(client.create_loop_closure(b, a))
    assert without.subject != done.subject


def test_the_same_loop_by_hand_again_answers_again_and_another_one_is_a_conflict(client, session, loops):
    a, c = (f"{session.name}/submaps/{name}" for name in "ac")
    first = client.create_loop_closure(c, a, T_match_query=pose(1.0), note="x")
    assert client.create_loop_closure(c, a, T_match_query=pose(1.0), note="x").name == first.name
    client.wait(first)
    assert client.create_loop_closure(c, a, T_match_query=pose(1.0), note="x").subject == first.subject
    for query, match in ((c, a), (a, c)):
        with pytest.raises(AlreadyExists):
            client.create_loop_closure(query, match, T_match_query=pose(2.0))


def test_a_loop_by_hand_needs_two_described_submaps_of_one_map(client, service, session, town, loops):
    a = f"{session.name}/submaps/a"
    with pytest.raises(InvalidArgument):
        client.create_loop_closure(a, a)
    with pytest.raises(NotFound):
        client.create_loop_closure(a, f"{session.name}/submaps/nowhere")
    with pytest.raises(InvalidArgument) as refused:
        client.create_loop_closure(a, "maps/elsewhere/sessions/monday/submaps/a")
    assert refused.value.field == "match"
    service.working.clear()
    try:
        client.post_submap(session, "late", cloud_points(4), pose(90.0), 9)
        with pytest.raises(FailedPrecondition):
            client.create_loop_closure(a, f"{session.name}/submaps/late")
    finally:
        service.working.set()


def test_a_note_is_bounded_and_printable(client, loops):
    assert client.reject_loop_closure(loops["ACCEPTED"], note="x" * 1000).state == "REJECTED"
    for note in ("x" * 1001, "two\nlines"):
        with pytest.raises(InvalidArgument) as refused:
            client.revert_loop_closure(loops["ACCEPTED"], note=note)
        assert refused.value.field == "note"


def test_near_misses_are_explained_by_the_gate_that_stopped_them(client, session, town, loops):
    a, b, c = (f"{session.name}/submaps/{name}" for name in "abc")
    found = {miss.submap: miss for miss in client.explain(a)}
    assert found.keys() == {b}
    assert (found[b].gate, found[b].threshold) == ("TOO_NEAR", client.get_map(town).leave_distance_m)
    assert found[b].remedy.startswith("leave_distance_m below ")
    client.reject_loop_closure(loops["ACCEPTED"])
    assert {miss.submap: miss.gate for miss in client.explain(c)} == {a: "OVERRULED", b: "TOO_NEAR"}


MATCH = SearchHit(submap="match", similarity=0.9, position_m=(0.0, 0.0, 0.0))


def test_what_would_have_passed_a_gate_is_the_value_that_was_measured():
    measured = {"score": 0.41, "overlap": 0.3}
    evidence = {"measurement": measured, "thresholds": {"min_score": 0.5}}
    loop = LoopClosure(query="query", match="match", reason="LOW_SCORE", score=0.41, evidence=evidence)
    miss = explanations._rejected(MATCH, loop)
    assert (miss.gate, miss.measured, miss.threshold, miss.remedy) == ("LOW_SCORE", 0.41, 0.5, "min_score = 0.41")
    aside = {"common_share": 0.12, "enough_share": 0.35}
    apart = replace(loop, reason="NO_COMMON_REGION", evidence={**evidence, "measurement": {**measured, **aside}})
    miss = explanations._rejected(MATCH, apart)
    assert (miss.measured, miss.threshold, miss.remedy) == (0.12, 0.35, "no setting passes it")
    tilted = replace(loop, reason="IMPLAUSIBLE_TILT")
    miss = explanations._rejected(MATCH, tilted)
    assert (miss.measured, miss.rule, miss.remedy) == (None, None, "no setting passes it")


@pytest.mark.parametrize(("rank", "gate"), [(20, "KNOWN_ALREADY"), (21, "NOT_VERIFIED")])
def test_a_similar_submap_that_was_not_compared_beside_accepted_loops_was_known_already(rank, gate):
    accepted = LoopClosure(query="query", match="match", state="ACCEPTED", score=0.9, evidence={})
    map_ = SimpleNamespace(loop_policy=SimpleNamespace(candidates=20))
    hit = replace(MATCH, submap="maps/m/sessions/t/submaps/b")
    assert explanations._near_miss(None, map_, rank, hit, {"match": accepted}).gate == gate
    assert explanations._near_miss(None, map_, rank, hit, {}).gate == "NOT_VERIFIED"


def test_events_go_with_their_loop(client, service, session, town, loops):
    client.reject_loop_closure(loops["ACCEPTED"])
    client.delete(f"{session.name}/submaps/c")
    with pytest.raises(NotFound):
        client.loop_closure_events(loops["ACCEPTED"])
    map_id = town.removeprefix("maps/")
    left = service.world.context.transactions.read(lambda uow: uow.loop_events.find("default", map_id=map_id))
    assert {event.loop_id for event in left.result()} == {
        loop.name.rpartition("/")[2] for loop in client.loop_closures(town, state="ALL")
    }
