"""Poses and evidence are packed with their migration, meshes forgotten, and all of it is JSON again on the way back."""

from __future__ import annotations

import asyncio
import json
from dataclasses import asdict

import pytest

from revisit.service.adapters.sqlite.migration import migrate
from tests.support.service_world import TENANT, described, scan, sqlite_world
from tests.support.stored_rows import columns, run

EVIDENCE = {"measurement": {"overlap": 0.25}, "thresholds": {}, "model_version": "fake-1"}


@pytest.fixture
def before(tmp_path):
    """A store of the revision before, with two described submaps, a loop between them and scans; and its records."""
    world = sqlite_world(tmp_path)
    asyncio.run(described(world, a=1, b=2, again=1))
    asyncio.run(world.use_cases.scans.append(TENANT, scan(1, 0.0)))
    known = records(world)
    world.context.transactions.close()
    migrate(tmp_path / "revisit.db", "0019")
    return tmp_path / "revisit.db", known


def records(world) -> dict[str, list[dict]]:
    def read(uow):
        return {
            name: [asdict(one) for one in getattr(uow, name).find(TENANT)]
            for name in ("scans", "submaps", "loops", "loop_events")
        }

    return world.context.transactions.read(read).result()


def test_the_revision_before_has_poses_and_evidence_as_json(before):
    database, known = before
    rows = run(database, "SELECT T_match_query, evidence FROM loop_closures")
    for (pose, evidence), loop in zip(rows, known["loops"], strict=True):
        assert json.loads(evidence) == loop["evidence"]
        assert (None if pose is None else tuple(json.loads(pose))) == loop["T_match_query"]
    assert "mesh_sha256" in columns(database, "submaps")


def test_what_was_stored_before_is_read_as_it_was_and_what_comes_then_is_packed(before, tmp_path):
    database, known = before
    run(database, f"UPDATE loop_closures SET evidence = '{json.dumps(EVIDENCE)}' WHERE number = 1")
    known["loops"][0]["evidence"] = EVIDENCE
    migrate(database)
    assert "mesh_sha256" not in columns(database, "submaps")
    world = sqlite_world(tmp_path)
    assert records(world) == known
    asyncio.run(world.use_cases.scans.append(TENANT, scan(2, 1.0)))
    assert records(world)["scans"][0] == known["scans"][0]
    world.context.transactions.close()
    assert [len(pose) for (pose,) in run(database, "SELECT T_odom_sensor FROM scans")][1] == 97
