"""Poses in the map, read once of a version and told for as long as its rows are there."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from revisit.core.geometry import se3
from revisit.core.geometry.se3 import pose_row
from revisit.service.domain.records import SessionPosesRecord
from revisit.service.features.graph.map_frames import KeptSessions, MapFrames
from revisit.service.features.graph.session_poses import PackedSubmaps
from revisit.service.ports.repositories import FoundSubmap
from tests.support.memory.transactions import MemoryTransactions
from tests.support.records import TENANT, a_map, a_session

AT_HOME = pose_row(np.eye(4))


@pytest.fixture
def store():
    return MemoryTransactions()


def in_version(store, session_id: str, numbers: list[int], x_m: float) -> SessionPosesRecord:
    """The row of a session in version 1 of the map; its submaps lie at x."""
    poses = np.tile(se3.from_rotation_translation(np.eye(3), (x_m, 0, 0)), (len(numbers), 1, 1))
    packed = PackedSubmaps(np.array(numbers), poses, np.zeros((len(numbers), 6, 6), np.float32)).packed()
    row = SessionPosesRecord(TENANT, "town", 1, session_id, 1, "frame-1", AT_HOME, packed, "hash", 1)
    return store.write(lambda uow: uow.session_poses.add(row)).result()


def positions_m(store, kept, found: dict[int, str]) -> dict[int, float]:
    """Where submaps of those sessions lie on the x axis; no row of a session that is kept is read."""
    submaps = {number: FoundSubmap(number, "town", name, "any", (0.0, 0.0, 0.0)) for number, name in found.items()}
    poses = store.read_here(lambda uow: MapFrames(uow, TENANT, "town", kept).submaps(submaps))
    return {number: pose.T_map[3] for number, pose in poses.items()}


def test_a_session_of_a_version_is_read_once(store, monkeypatch):
    store.write(lambda uow: uow.maps.add(replace(a_map(), map_version=1))).result()
    in_version(store, "monday", [1, 2], x_m=5.0)
    kept = KeptSessions()
    assert positions_m(store, kept, {1: "monday", 2: "monday"}) == {1: 5.0, 2: 5.0}
    monkeypatch.setattr(PackedSubmaps, "of", lambda data: pytest.fail("read again"))
    assert positions_m(store, kept, {2: "monday"}) == {2: 5.0}


def test_the_same_version_of_another_map_of_that_name_is_another(store):
    store.write(lambda uow: uow.maps.add(replace(a_map(), map_version=1))).result()
    gone, kept = in_version(store, "monday", [1], x_m=5.0), KeptSessions()
    assert positions_m(store, kept, {1: "monday"}) == {1: 5.0}
    store.write(lambda uow: uow.session_poses.delete(TENANT, number=gone.number)).result()
    store.write(lambda uow: uow.sessions.add(a_session())).result()
    assert positions_m(store, kept, {1: "monday"}) == {}
    in_version(store, "monday", [1], x_m=7.0)
    assert positions_m(store, kept, {1: "monday"}) == {1: 7.0}


def test_sessions_least_lately_asked_for_go_first(store, monkeypatch):
    store.write(lambda uow: uow.maps.add(replace(a_map(), map_version=1))).result()
    for number, name in enumerate(("a", "b", "c")):
        in_version(store, name, [10 * number, 10 * number + 1], x_m=number)
    kept, read, of = KeptSessions(most_submaps=4), [], PackedSubmaps.of
    monkeypatch.setattr(PackedSubmaps, "of", lambda data: read.append(of(data)) or read[-1])
    for number, name in ((0, "a"), (10, "b"), (0, "a"), (20, "c"), (0, "a"), (10, "b")):
        positions_m(store, kept, {number: name})
    assert [session.numbers[0] for session in read] == [0, 10, 20, 10]


def test_what_the_map_knows_of_a_loop_is_told_across_the_ground_however_the_sensor_is_mounted(store):
    """Of a sensor on its side, whose y is up: 3 m of height do not count."""
    store.write(lambda uow: uow.maps.add(replace(a_map(), map_version=1))).result()
    on_its_side = se3.exp([0.0, 0.0, 0.0, np.pi / 2.0, 0.0, 0.0])
    covariances = np.tile(np.diag([0.01, 9.0, 0.04, 0.0, 0.0, 0.0]).astype(np.float32), (2, 1, 1))
    packed = PackedSubmaps(np.array([1, 2]), np.tile(on_its_side, (2, 1, 1)), covariances).packed()
    row = SessionPosesRecord(TENANT, "town", 1, "monday", 1, "frame-1", AT_HOME, packed, "hash", 1)
    store.write(lambda uow: uow.session_poses.add(row)).result()
    loop = SimpleNamespace(query_session_id="monday", query_number=2, match_session_id="monday", match_number=1)
    spread_m = store.read_here(lambda uow: MapFrames(uow, TENANT, "town").spread_m(loop))
    assert spread_m == pytest.approx(np.sqrt(2 * 0.04))
