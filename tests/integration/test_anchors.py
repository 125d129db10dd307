"""A fleet with fixes of satellites in the service: on earth in one version, undone to the byte. Simulated."""

from __future__ import annotations

import itertools
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from revisit.cli.app import app
from revisit.core.errors import BadField
from revisit.core.geometry import geodesy, se3
from revisit.core.geometry.se3 import pose_matrix
from revisit.service.adapters.core_map_optimiser import CoreMapOptimiser
from revisit.service.calls.mapping import version_fields
from revisit.service.domain.identity import SessionKey
from revisit.service.domain.states import AnchorFrame, AnchorKind, EventKind
from revisit.service.features.anchors import calls
from revisit.service.features.anchors.rules import DrivePoses, NewAnchor
from revisit.service.features.events.calls import events_of
from revisit.service.features.graph.anchor_verdicts import anchor_verdicts, frames_on_earth
from revisit.service.features.graph.anchors import SubmapsInTime
from revisit.service.features.graph.session_poses import PackedSubmaps
from revisit.service.features.merging.calls import MergeMap
from revisit.service.features.optimisation import rows as optimisation_rows
from revisit.service.features.resources.paging import PageRequest
from revisit.service.features.webhooks.calls import CreateWebhook
from revisit.service.ports.repositories import PlacedSubmap
from tests.support.fleet_in_service import fleet_in, fleet_in_two
from tests.support.live_service import connected, live_service
from tests.support.made_up_anchors import ORIGIN, new_anchors, sent, with_stamps
from tests.support.records import a_scan
from tests.support.service_world import SESSION, TENANT, memory_world, open_session, sqlite_world


@pytest.fixture(params=["memory", "sqlite"])
async def world(request, tmp_path):
    made = memory_world() if request.param == "memory" else sqlite_world(tmp_path)
    yield made
    if request.param == "sqlite":
        made.context.transactions.close()


async def posted(world, made) -> None:
    for session in made.truth:
        await world.use_cases.anchors.post(TENANT, SessionKey("town", session), new_anchors(made, session))


async def optimised(world):
    await world.use_cases.map_versions.optimise(TENANT, "town")
    world.work_off()
    page = await world.use_cases.map_versions.list(TENANT, "town", PageRequest(100))
    return page.items[-1]


async def listed(world, made):
    pages = [
        await world.use_cases.anchors.list(TENANT, SessionKey("town", one), PageRequest(500)) for one in made.truth
    ]
    return list(itertools.chain.from_iterable(page.items for page in pages))


def rows(world, name, **equals):
    return world.context.transactions.read(
        lambda uow: getattr(uow, name).find(TENANT, map_id="town", **equals)
    ).result()


def error_m(world, made, version) -> float:
    """Root mean square of the position errors on earth of a version."""
    row = rows(world, "map_versions", version=version.version)[0]
    ((frame, T_enu_map),) = frames_on_earth(row.summary).items()
    (origin,) = {one.origin for one in rows(world, "maps")}
    errors = []
    for poses in rows(world, "session_poses", version=version.version):
        assert poses.frame == frame
        found = se3.apply(T_enu_map, PackedSubmaps.of(poses.submaps).T_map_submap[:, :3, 3])
        true = geodesy.enu(origin, geodesy.geodetic_of_enu(ORIGIN, made.truth[poses.session_id][:, :3, 3]))
        errors.append(((found - true) ** 2).sum(axis=1))
    return float(np.sqrt(np.concatenate(errors).mean()))


async def test_a_version_lies_on_earth_and_its_reflected_fixes_are_set_aside(world):
    made = fleet_in(world, "town", 0.2, sessions=3, submaps=50).fleet
    with_stamps(world)
    before = await optimised(world)
    await posted(world, made)
    assert {one.state for one in await listed(world, made)} == {None}
    after = await optimised(world)
    found = await listed(world, made)
    states = {(one.record.anchor_id.partition("-")[0], one.state.value, one.reason) for one in found}
    assert states == {("right", "IN_MAP", None), ("wrong", "SET_ASIDE", "DISAGREES")}
    assert all(np.linalg.norm(one.residual_m) > 15.0 for one in found if one.state == "SET_ASIDE")
    assert error_m(world, made, after) < 0.8
    (georeference,) = after.summary["georeferences"]
    assert (georeference["anchors"], georeference["of_anchors"]) == (120, 150)
    assert "georeferences" not in before.summary


async def test_maps_without_anchors_have_the_same_versions_bit_for_bit(world):
    made = fleet_in(world, "town", 0.2, sessions=2, submaps=30).fleet
    with_stamps(world)
    before = await optimised(world)
    await posted(world, made)
    on_earth = await optimised(world)
    assert on_earth.content_hash != before.content_hash
    for one in await listed(world, made):
        await world.use_cases.anchors.delete(TENANT, "town", one.record.session_id, one.record.anchor_id)
    without = await optimised(world)
    assert without.content_hash == before.content_hash
    assert "georeferences" in on_earth.summary and rows(world, "maps")[0].origin is not None


async def test_a_version_on_earth_comes_back_to_the_byte(world):
    made = fleet_in(world, "town", 0.2, sessions=2, submaps=30).fleet
    with_stamps(world)
    before = await optimised(world)
    await posted(world, made)
    on_earth, states = await optimised(world), await listed(world, made)
    back = await world.use_cases.map_versions.revert(TENANT, "town", before.version)
    assert back.content_hash == before.content_hash
    assert {one.state for one in await listed(world, made)} == {None}
    again = await world.use_cases.map_versions.revert(TENANT, "town", on_earth.version)
    assert again.content_hash == on_earth.content_hash and again.summary == on_earth.summary
    kept = rows(world, "map_versions")
    assert kept[-1].anchors == kept[1].anchors
    assert [(one.state, one.reason) for one in await listed(world, made)] == [(one.state, one.reason) for one in states]


def told(world, after: int = 0):
    """The anchors of the events behind a number: id, state and reason of each."""

    def events(uow):
        return events_of(uow, uow.events.following(TENANT, "town", after, 1000))

    found = [one.anchor for one in world.context.transactions.read(events).result() if one.kind is EventKind.ANCHOR]
    return {(one.record.anchor_id, one.state and one.state.value, one.reason and one.reason.value) for one in found}


def last_event(world) -> int:
    return world.context.transactions.read(lambda uow: uow.events.last_numbers([(TENANT, "town")])).result()[
        TENANT, "town"
    ]


async def test_an_anchor_that_is_set_aside_or_used_again_is_an_event(world):
    made = fleet_in(world, "town", 0.0, sessions=2, submaps=30).fleet
    with_stamps(world)
    before = await optimised(world)
    sent_anchors = new_anchors(made, "s0")
    right = next(one for one in sent_anchors if one.anchor_id.startswith("right"))
    door = replace(right, anchor_id="door", kind=AnchorKind.CONTROL_POINT)
    await world.use_cases.anchors.post(TENANT, SessionKey("town", "s0"), [*sent_anchors, door])
    on_earth = await optimised(world)
    aside = {(one.anchor_id, "SET_ASIDE", "DISAGREES") for one in sent_anchors if one.anchor_id.startswith("wrong")}
    assert len(aside) == 6 and told(world) == aside | {("door", "IN_MAP", None)}
    seen = last_event(world)
    await optimised(world)
    assert told(world, seen) == set()
    await world.use_cases.map_versions.revert(TENANT, "town", before.version)
    assert told(world, seen) == {(name, None, None) for name, *_ in [*aside, ("door",)]}
    seen = last_event(world)
    await world.use_cases.map_versions.revert(TENANT, "town", on_earth.version)
    assert told(world, seen) == aside | {("door", "IN_MAP", None)}


async def test_a_version_tells_so_many_anchors_at_most_and_fixes_last(monkeypatch):
    world = memory_world()
    made = fleet_in(world, "town", 0.0, sessions=2, submaps=30).fleet
    with_stamps(world)
    monkeypatch.setattr(optimisation_rows, "TOLD_ANCHORS", 3)
    fixes = new_anchors(made, "s0")
    wrong, right = ([one for one in fixes if one.anchor_id.startswith(side)] for side in ("wrong", "right"))
    doors = [replace(one, anchor_id=f"door-{n}", kind=AnchorKind.CONTROL_POINT) for n, one in enumerate(right[:2])]
    await world.use_cases.anchors.post(TENANT, SessionKey("town", "s0"), [*fixes, *doors])
    await optimised(world)
    first = (wrong[0].anchor_id, "SET_ASIDE", "DISAGREES")
    assert told(world) == {("door-0", "IN_MAP", None), ("door-1", "IN_MAP", None), first}


async def test_a_preview_says_what_anchors_would_do_and_keeps_nothing(world):
    made = fleet_in(world, "town", 0.0, sessions=2, submaps=30).fleet
    with_stamps(world)
    before, key = await optimised(world), SessionKey("town", "s0")
    asked = new_anchors(made, "s0")
    posted = await world.use_cases.anchors.preview(TENANT, key, asked)
    again = await world.use_cases.anchors.preview(TENANT, key, [*asked, asked[0]])
    assert again.replay and again.operation.operation_id == posted.operation.operation_id
    world.work_off()
    done = await world.use_cases.operations.get(TENANT, posted.operation.operation_id)
    assert rows(world, "anchors") == [] and [one.version for one in rows(world, "map_versions")] == [before.version]
    assert [one.origin for one in rows(world, "maps")] == [None]
    await world.use_cases.anchors.post(TENANT, key, asked)
    after = await optimised(world)
    (found,) = after.summary["georeferences"]
    assert [one["T_enu_map"] for one in done.result["georeferences"]] == [found["T_enu_map"]]
    assert done.result["max_change_m"] == after.summary["max_change_m"] > 0.01
    judged = {
        one.record.name: (one.state.value, one.reason, one.residual_m.tolist()) for one in await listed(world, made)
    }
    assert {
        one["name"]: (one["state"], one["reason"] or None, one["residual_m"]) for one in done.result["anchors"]
    } == judged
    assert done.result["others"] == []


async def test_a_preview_solves_the_loops_of_a_map_once(world):
    made = fleet_in(world, "town", 0.0, sessions=2, submaps=30).fleet
    with_stamps(world)
    solutions = []

    class Counting(CoreMapOptimiser):
        def by_loops(self, graph, progress):
            solutions.append(len(graph.loops))
            return super().by_loops(graph, progress)

    world.optimiser = Counting()
    await world.use_cases.anchors.preview(TENANT, SessionKey("town", "s0"), new_anchors(made, "s0", sigma_m=0.2))
    world.work_off()
    assert len(solutions) == 1


async def test_a_preview_names_the_anchors_that_others_would_set_aside():
    world = memory_world()
    made = fleet_in(world, "town", 0.0, sessions=2, submaps=30).fleet
    with_stamps(world)
    key = SessionKey("town", "s0")
    fixes = [one for one in new_anchors(made, "s0", sigma_m=0.3) if one.anchor_id.startswith("right")]
    lied = [replace(one, position=(one.position[0], one.position[1] + 4e-4, one.position[2])) for one in fixes[::4]]
    await world.use_cases.anchors.post(TENANT, key, lied)
    await optimised(world)
    assert {one.state.value for one in await listed(world, made)} == {"IN_MAP"}
    asked = [one for one in fixes if one.anchor_id not in {other.anchor_id for other in lied}]
    posted = await world.use_cases.anchors.preview(TENANT, key, asked)
    world.work_off()
    result = (await world.use_cases.operations.get(TENANT, posted.operation.operation_id)).result
    assert {one["state"] for one in result["anchors"]} == {"IN_MAP"}
    assert {one["name"] for one in result["others"]} == {f"{key.name}/anchors/{one.anchor_id}" for one in lied}
    assert {one["state"] for one in result["others"]} == {"SET_ASIDE"}


async def test_a_deleted_session_leaves_no_verdict_on_its_anchors(world):
    made = fleet_in(world, "town", 0.0, sessions=2, submaps=30).fleet
    with_stamps(world)
    await posted(world, made)
    await optimised(world)
    await world.use_cases.sessions.delete(TENANT, SessionKey("town", "s1"))
    left = {one.number for one in rows(world, "anchors")}
    assert len(left) == 30
    (version,) = rows(world, "map_versions")
    assert anchor_verdicts(version.anchors).keys() == left
    await world.use_cases.maps.delete(TENANT, "town")
    assert world.context.transactions.read(lambda uow: uow.everything.anchors.count(TENANT)).result() == 0


async def test_a_version_tells_a_session_whose_anchors_lie_elsewhere_until_that_is_deleted(world):
    made = fleet_in(world, "town", 0.0, sessions=3, submaps=20).fleet
    with_stamps(world)
    for session in made.truth:
        fixes = new_anchors(made, session)
        above_the_sea = [
            replace(one, position=(*one.position[:2], one.position[2] - 47.0 * (session == "s2"))) for one in fixes
        ]
        await world.use_cases.anchors.post(TENANT, SessionKey("town", session), above_the_sea)
    await optimised(world)

    async def told():
        page = await world.use_cases.map_versions.list(TENANT, "town", PageRequest())
        (frame,) = version_fields(page.items[-1])["summary"]["georeferences"]
        return [(one["session"], one["elsewhere"], -49.0 < one["offset_m"]["z"] < -45.0) for one in frame["sessions"]]

    assert await told() == [("maps/town/sessions/s2", True, True)]
    await world.use_cases.sessions.delete(TENANT, SessionKey("town", "s2"))
    assert await told() == []


async def test_a_merge_leaves_a_map_on_earth_and_brings_the_anchors_of_the_other():
    world = memory_world()
    made = fleet_in_two(world, ("town", "annex"), seed=4, sessions=2, submaps=60, per_pair=0).fleet
    for map_id, session in (("town", "s0"), ("annex", "s1")):
        with_stamps(world, map_id)
        await world.use_cases.anchors.post(TENANT, SessionKey(map_id, session), new_anchors(made, session))
    alone = await optimised(world)
    await world.use_cases.map_merges.merge(TENANT, MergeMap("town", "annex"))
    world.work_off()
    assert [one.sessions for one in rows(world, "map_merges")] == [("s1",)]
    versions = rows(world, "map_versions")
    held = [one.summary["georeferences"][0] for one in versions]
    assert [one["frame"] for one in held] == [alone.summary["georeferences"][0]["frame"]] * len(held)
    assert [one["of_anchors"] for one in held[:2]] == [60, 60]
    assert versions[1].summary["sessions"] == 2
    after = await optimised(world)
    (found,) = after.summary["georeferences"]
    assert (found["anchors"], found["of_anchors"]) == (96, 120)
    assert error_m(world, made, after) < 1.0


async def test_a_map_that_lay_on_earth_by_a_merge_alone_does_not_when_that_is_taken_back():
    world = memory_world()
    made = fleet_in_two(world, ("town", "annex"), seed=4, sessions=2, submaps=60, per_pair=0).fleet
    with_stamps(world), with_stamps(world, "annex")
    before = await optimised(world)
    await world.use_cases.anchors.post(TENANT, SessionKey("annex", "s1"), new_anchors(made, "s1"))
    await world.use_cases.map_merges.merge(TENANT, MergeMap("town", "annex"))
    world.work_off()
    merged = await optimised(world)
    assert "georeferences" in merged.summary
    (merge,) = rows(world, "map_merges")
    await world.use_cases.map_merges.revert(TENANT, "town", merge.merge_id)
    back = (await world.use_cases.map_versions.list(TENANT, "town", PageRequest(100))).items[-1]
    assert back.content_hash == before.content_hash
    assert [one.origin for one in rows(world, "maps")] == [None]
    assert [one.version for one in rows(world, "map_versions") if "georeferences" in one.summary] == []


async def test_a_drive_that_came_by_a_merge_is_compared_where_a_webhook_asks_for_changes():
    world = memory_world()
    made = fleet_in_two(world, ("town", "annex"), seed=4, sessions=2, submaps=60, per_pair=0).fleet
    hook = CreateWebhook("changes", "https://hooks.example.com/revisit", "town", (EventKind.MAP_CHANGED,))
    await world.use_cases.webhooks.create(TENANT, hook)
    await optimised(world)
    for map_id, session in zip(("town", "annex"), made.truth, strict=True):
        await world.use_cases.sessions.finish(TENANT, SessionKey(map_id, session))
    assert comparisons(world) == []
    await world.use_cases.map_merges.merge(TENANT, MergeMap("town", "annex"))
    world.work_off()
    (merge,) = rows(world, "map_merges")
    assert comparisons(world)[:1] == [f"maps/town/versions/{merge.version}"]


async def test_where_a_version_lacks_the_end_of_a_drive_that_is_to_be_compared_the_next_one_follows():
    world = memory_world(optimise_after_loops=1)
    fleet_in(world, "town", 0.0, sessions=2, submaps=10)
    hook = CreateWebhook("changes", "https://hooks.example.com/revisit", "town", (EventKind.MAP_CHANGED,))
    await world.use_cases.webhooks.create(TENANT, hook)
    await optimised(world)
    last = rows(world, "submaps", session_id="s1")[-1]
    end = replace(last, submap_id="end", ordinal=last.ordinal + 1, number=0)
    world.context.transactions.write(lambda uow: uow.submaps.add(end)).result()
    await world.use_cases.sessions.finish(TENANT, SessionKey("town", "s1"))
    assert [one.state for one in rows_of_jobs(world)] == ["DONE", "QUEUED"] and comparisons(world) == []
    world.clock.ms += 600_000
    world.work_off()
    assert [one.state for one in rows_of_jobs(world)] == ["DONE", "DONE"]
    assert comparisons(world)[:1] == ["maps/town/versions/2"]


def comparisons(world):
    jobs = world.context.transactions.read(lambda uow: uow.jobs.find(TENANT, kind="FIND_CHANGES")).result()
    return [one.subject for one in jobs]


async def test_anchors_that_are_posted_again_change_nothing_and_queue_nothing():
    world = memory_world(optimise_after_loops=1)
    made = fleet_in(world, "town", 0.0, sessions=1, submaps=10).fleet
    await world.use_cases.sessions.finish(TENANT, SessionKey("town", "s0"))
    await posted(world, made)
    queued = [one.operation_id for one in rows_of_jobs(world)]
    assert len(queued) == 1
    world.clock.ms += 600_000
    world.work_off()
    await posted(world, made)
    assert [one.operation_id for one in rows_of_jobs(world)] == queued


async def test_of_a_long_drive_those_scans_are_read_that_anchors_lie_between(world, monkeypatch):
    await open_session(world)
    long = [a_scan(seq, float(seq)) for seq in range(1, 1001)]
    T_odom = [tuple(se3.from_yaw(0.0, (float(one.seq), 0.0, 0.0)).ravel().tolist()) for one in long]
    scans = [replace(one, T_odom_sensor=pose) for one, pose in zip(long, T_odom, strict=True)]
    world.context.transactions.write(lambda uow: uow.scans.add_all(scans)).result()
    read = []
    monkeypatch.setattr(calls, "DrivePoses", lambda *drive: read.append(len(drive[0])) or DrivePoses(*drive))
    ends = [fix_at(stamp_ns) for stamp_ns in (50_050, 150, 99_950)]
    found = await world.use_cases.anchors.post(TENANT, SESSION, ends)
    assert [pose_matrix(one.record.T_odom_sensor)[0, 3] for one in found] == [500.5, 1.5, 999.5]
    assert 0 < sum(read) <= 3 * calls.SCANS_AT_ONCE
    with pytest.raises(BadField, match="no scans are stored before and after"):
        await world.use_cases.anchors.post(TENANT, SESSION, [fix_at(100_001)])


def rows_of_jobs(world):
    return world.context.transactions.read(lambda uow: uow.jobs.find(TENANT, kind="OPTIMISE_MAP")).result()


def fix_at(stamp_ns: int) -> NewAnchor:
    covariance = tuple(np.eye(3).ravel().tolist())
    return NewAnchor(f"at-{stamp_ns}", AnchorKind.GNSS, AnchorFrame.WGS84, stamp_ns, ORIGIN, covariance)


def test_an_anchor_is_of_the_submap_nearest_in_time_and_of_several_of_the_first():
    rng = np.random.default_rng(2)
    for _ in range(200):
        drive = [
            PlacedSubmap(n, 1, n, (), int(stamp)) for n, stamp in enumerate(rng.integers(0, 12, rng.integers(1, 9)))
        ]
        for stamp_ns in range(-1, 14):
            nearest = min(drive, key=lambda one: abs(one.stamp_ns - stamp_ns))
            assert SubmapsInTime.of(drive).nearest(stamp_ns) == nearest


async def test_a_fix_lies_on_the_drive_between_the_scans_around_it():
    drive = DrivePoses([10, 20], [tuple(np.eye(4).ravel()), tuple(se3.from_yaw(0.4, (2.0, 0.0, 0.0)).ravel())])
    assert np.allclose(drive.at(10), np.eye(4)) and np.allclose(drive.at(20), pose_matrix(drive.T_odom[1]))
    assert se3.yaw(drive.at(15)) == pytest.approx(0.2)
    assert drive.at(9) is None and drive.at(21) is None


def test_drives_are_exported_on_earth_where_anchors_hold_the_map(tmp_path):
    world, out = memory_world(), tmp_path / "town.geojson"
    made = fleet_in(world, "town", 0.0, sessions=2, submaps=30).fleet
    with_stamps(world)
    with live_service(world) as running, connected(running, "rest") as client:
        asked = ["export", "--map", "town", "--format", "geojson", "--out", str(out), "--http", running.http]
        client.wait(client.optimise_map("maps/town"))
        refused = CliRunner().invoke(app, asked)
        assert refused.exit_code != 0 and "does not lie on earth" in refused.output
        for session in made.truth:
            found = [sent(one) for one in new_anchors(made, session)]
            client.sessions.post_anchors(f"maps/town/sessions/{session}", found)
        client.wait(client.optimise_map("maps/town"))
        (found,) = client.map_versions("maps/town")[-1].summary.georeferences
        assert (found.anchors, found.of_anchors) == (48, 60) and found.covariance.shape == (6, 6)
        events = list(itertools.islice(client.watch("maps/town", after=0, kinds=["ANCHOR"]), 12))
        assert {(one.anchor.state, one.anchor.reason) for one in events} == {("SET_ASIDE", "DISAGREES")}
        watched = [
            "watch",
            "--map",
            "town",
            "--after",
            "0",
            "--kind",
            "anchor",
            "--count",
            "12",
            "--http",
            running.http,
        ]
        said = CliRunner().invoke(app, watched)
        assert re.search(r"anchor set aside: s0/wrong-s0-\d+, [23]\d\.\d\d m off, DISAGREES", said.output), said.output
        client.create_webhook("aside", "https://hooks.example.com/revisit", kinds=["ANCHOR"])
        poses = client.maps.on_earth("maps/town")[found.frame]
        at, origin = poses.pose(np.linalg.inv(found.T_enu_map)), client.get_map("maps/town").origin
        assert (at.latitude_deg, at.longitude_deg) == pytest.approx((origin.latitude_deg, origin.longitude_deg))
        assert at.heading_deg == pytest.approx(90.0)
        assert client.maps.on_earth(client.create_map("elsewhere")) == {}
        written = CliRunner().invoke(app, asked)
        assert written.exit_code == 0, written.output
    features = {one["properties"]["session"]: one for one in json.loads(out.read_text())["features"]}
    for session, poses in made.truth.items():
        line = np.array(features[session]["geometry"]["coordinates"])
        true = geodesy.geodetic_of_enu(ORIGIN, poses[:, :3, 3])
        north, east = (111_195.0 * (line[:, 1 - axis] - true[:, axis]) for axis in (0, 1))
        assert np.hypot(north, np.cos(np.radians(48.1)) * east).max() < 3.0
