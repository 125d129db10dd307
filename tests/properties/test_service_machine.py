"""Any order of calls, work and restarts leaves the service as a model of three dictionaries says."""

from __future__ import annotations

import os
from dataclasses import dataclass, field

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule, run_state_machine_as_test

from revisit.service.domain.identity import SessionKey, SubmapKey
from tests.support.campaigns import Campaign
from tests.support.service_drivers import RestDriver, UseCaseDriver

EXAMPLES = int(os.environ.get("REVISIT_MACHINE_EXAMPLES", "4"))
STEPS = int(os.environ.get("REVISIT_MACHINE_STEPS", "40"))
MAPS = st.sampled_from(["town", "yard"])
SESSIONS = st.builds(SessionKey, MAPS, st.sampled_from(["monday", "tuesday"]))
SUBMAPS = st.sampled_from(["a", "b", "c"])
PLACES = st.integers(1, 3)


@dataclass
class ModelSession:
    """What a session should hold: the last scan, whether it is finished, and the place of each submap."""

    committed_seq: int = 0
    finished: bool = False
    submaps: dict[str, int] = field(default_factory=dict)
    described: set[str] = field(default_factory=set)


class ServiceMachine(RuleBasedStateMachine):
    """Says what each call must answer, and compares all that is listed after each step."""

    driver_of = staticmethod(lambda: UseCaseDriver("memory"))

    def __init__(self) -> None:
        super().__init__()
        self.driver = self.driver_of()
        self.maps: dict[str, dict[str, ModelSession]] = {}

    def session(self, key: SessionKey) -> ModelSession | None:
        return self.maps.get(key.map_id, {}).get(key.session_id)

    @rule(map_id=MAPS)
    def create_map(self, map_id):
        expected = "REPLAY" if map_id in self.maps else "OK"
        assert self.driver.create_map(map_id) == expected
        self.maps.setdefault(map_id, {})

    @rule(map_id=MAPS)
    def delete_map(self, map_id):
        expected = "OK" if map_id in self.maps else "NOT_FOUND"
        assert self.driver.delete_map(map_id) == expected
        self.maps.pop(map_id, None)

    @rule(key=SESSIONS)
    def create_session(self, key):
        known = self.maps.get(key.map_id)
        expected = "NOT_FOUND" if known is None else "REPLAY" if key.session_id in known else "OK"
        assert self.driver.create_session(key) == expected
        if known is not None:
            known.setdefault(key.session_id, ModelSession())

    @rule(key=SESSIONS, submap_id=SUBMAPS, place=PLACES)
    def post_submap(self, key, submap_id, place):
        session = self.session(key)
        if session is None:
            expected = "NOT_FOUND"
        elif submap_id in session.submaps:
            expected = "REPLAY" if session.submaps[submap_id] == place else "ALREADY_EXISTS"
        else:
            expected = "SESSION_FINISHED" if session.finished else "OK"
        assert self.driver.post_submap(key, submap_id, place) == expected
        if expected == "OK":
            session.submaps[submap_id] = place

    @rule(key=SESSIONS, ahead=st.integers(-1, 2))
    def append_scan(self, key, ahead):
        session = self.session(key)
        seq = max(1, (session.committed_seq if session else 0) + ahead)
        if session is None:
            expected = "NOT_FOUND"
        elif seq <= session.committed_seq:
            expected = "REPLAY"
        elif session.finished:
            expected = "SESSION_FINISHED"
        else:
            expected = "OK" if seq == session.committed_seq + 1 else "SEQ_GAP"
        assert self.driver.append_scan(key, seq) == expected
        if expected == "OK":
            session.committed_seq = seq

    @rule(key=SESSIONS)
    def finish_session(self, key):
        session = self.session(key)
        assert self.driver.finish_session(key) == ("NOT_FOUND" if session is None else "OK")
        if session is not None and not session.finished:
            session.finished = True
            if session.committed_seq:
                # Fewer than 100 scans, 0.1 m apart: all of them are the rest of one window.
                session.submaps[f"scans-1-{session.committed_seq}"] = 0

    @rule(key=SESSIONS)
    def delete_session(self, key):
        assert self.driver.delete_session(key) == ("NOT_FOUND" if self.session(key) is None else "OK")
        self.maps.get(key.map_id, {}).pop(key.session_id, None)

    @rule(key=SESSIONS, submap_id=SUBMAPS)
    def delete_submap(self, key, submap_id):
        session = self.session(key)
        known = session is not None and submap_id in session.submaps
        assert self.driver.delete_submap(SubmapKey(key.map_id, key.session_id, submap_id)) == (
            "OK" if known else "NOT_FOUND"
        )
        if known:
            del session.submaps[submap_id]
            session.described.discard(submap_id)

    @rule()
    def work(self):
        self.driver.work()
        for session in (session for known in self.maps.values() for session in known.values()):
            session.described = set(session.submaps)

    @rule()
    def restart(self):
        self.driver.restart()

    @invariant()
    def what_is_listed_is_what_was_acknowledged(self):
        assert self.driver.maps() == set(self.maps)
        for map_id, known in self.maps.items():
            assert self.driver.sessions(map_id) == {
                session_id: (session.committed_seq, session.finished) for session_id, session in known.items()
            }
            for session_id, session in known.items():
                assert self.driver.submaps(SessionKey(map_id, session_id)).keys() == session.submaps.keys()

    @invariant()
    def a_search_goes_through_what_is_described_and_nothing_else(self):
        for map_id, known in self.maps.items():
            assert self.driver.searched(map_id) == sum(len(session.described) for session in known.values())

    def teardown(self):
        self.driver.close()


def run(driver, examples: int, steps: int) -> None:
    campaign = Campaign("P3", examples * steps)
    machine = type("Machine", (ServiceMachine,), {"driver_of": staticmethod(driver)})
    run_state_machine_as_test(
        machine,
        settings=settings(
            max_examples=examples,
            stateful_step_count=steps,
            deadline=None,
            report_multiple_bugs=False,
            database=None,
            suppress_health_check=list(HealthCheck),
        ),
    )
    campaign.done = examples * steps
    campaign.publish("steps at most, with restarts: every answer and every list as the model says")


@pytest.mark.parametrize("stores", ["memory", "sqlite"])
def test_any_order_of_calls_and_restarts_agrees_with_the_model(stores):
    run(lambda: UseCaseDriver(stores), EXAMPLES, STEPS)


@pytest.mark.slow
def test_any_order_of_calls_over_rest_agrees_with_the_model():
    run(RestDriver, max(2, EXAMPLES // 6), STEPS // 2)


def test_the_model_notices_a_call_without_effect():
    class Forgetful(UseCaseDriver):
        def append_scan(self, session, seq):
            return "OK"

    with pytest.raises(AssertionError):
        run(lambda: Forgetful("memory"), 50, STEPS)
