"""What changed between the drives of a map, and surfaces at a moment, the same over REST and gRPC. Made up."""

from __future__ import annotations

import itertools
import json
import time
from dataclasses import replace

import pytest
from typer.testing import CliRunner

from revisit.cli.app import app
from revisit.sdk.errors import InvalidArgument, NotFound
from revisit.service.capacity.limits import POINTS_PER_S
from revisit.service.domain.states import WebhookState
from revisit.service.features.changes import job
from revisit.service.features.changes.rows import FoundChanges
from revisit.service.features.optimisation.rows import forget_versions
from revisit.service.features.tiles import rows as tile_rows
from tests.support.patience import eventually
from tests.support.service_world import TENANT, cloud_points, pose

DAY_NS = 86_400 * 10**9
MONDAY, TUESDAY = 20_000 * DAY_NS, 20_001 * DAY_NS
_numbers = itertools.count(1)
WATCH = ["watch", "--after", "0", "--kind", "map_changed", "--count", "1"]


@pytest.fixture
def driven_twice(client):
    """A map that was driven on two days along the same way, 60 m long; the name of its version."""
    made = client.create_map(f"years-{next(_numbers)}", leave_distance_m=0)
    drive_twice(client, made)
    return client.wait(client.optimise_map(made)).result["version"]


def drive_twice(client, made, places=(5, 25, 45, 65)):
    """The names of the sessions of two days."""
    sessions = []
    for session_id, day_ns in (("monday", MONDAY), ("tuesday", TUESDAY)):
        sessions.append(client.create_session(made, session_id))
        for place in places:
            submap = (f"at-{place}", cloud_points(place), pose(place), day_ns + place)
            client.wait(client.post_submap(sessions[-1], *submap))
    return [one.name for one in sessions]


def comparisons(client, made):
    return [
        one for one in client.list_operations() if one.kind == "FIND_CHANGES" and one.subject.startswith(f"{made}/")
    ]


def test_a_drive_that_found_changes_is_told_once_where_a_webhook_asks_for_it(client, service, monkeypatch):
    monkeypatch.setattr(job, "PORTION_MS", -1)  # a square a job
    made = client.create_map(f"years-{next(_numbers)}", leave_distance_m=0).name
    client.create_webhook(made[5:], "https://hooks.example.com/revisit", map_=made, kinds=["MAP_CHANGED"])
    _, tuesday = sessions = drive_twice(client, made)
    client.wait(client.optimise_map(made))
    assert comparisons(client, made) == []  # nobody has ended
    for session in sessions:
        client.finish_session(session)
    (event,) = itertools.islice(client.watch(made, after=0, kinds=["MAP_CHANGED"]), 1)
    told, found = event.drive_changes, client.map_changes(event.drive_changes.map_version)
    assert (told.session, told.map_version) == (tuesday, f"{made}/versions/1")
    assert (told.appeared, told.vanished, told.moved, told.back) == (0, len(found), 0, 0) and len(found) > 1
    eventually(lambda: all(one.done for one in comparisons(client, made)))
    before = [one.name for one in comparisons(client, made)]
    assert len(before) >= len(found)
    client.wait(client.optimise_map(made))
    assert [one.name for one in comparisons(client, made)] == before
    shown = CliRunner().invoke(app, [*WATCH, "--map", made[5:], "--http", service.http])
    assert shown.stdout.strip().endswith(f"tuesday found {len(found)} vanished"), shown.output
    client.delete(tuesday)
    client.wait(client.post_submap(client.create_session(made, "wednesday"), "a", cloud_points(5), pose(5.0), MONDAY))
    (later,) = itertools.islice(client.watch(made, after=event.number - 1, kinds=["MAP_CHANGED", "OPERATION"]), 1)
    assert later.operation is not None  # of a drive that was deleted nothing is told any more


def test_drives_are_not_compared_that_ended_before_a_webhook_asked_for_changes(client, service):
    made = client.create_map(f"years-{next(_numbers)}", leave_distance_m=0).name
    client.create_webhook(made[5:], "https://hooks.example.com/revisit", map_=made, kinds=["MAP_VERSION"])
    for session in drive_twice(client, made, (5, 25)):
        client.finish_session(session)
    client.wait(client.optimise_map(made))
    service.world.clock.ms += 1
    client.create_webhook(f"{made[5:]}-2", "https://hooks.example.com/revisit", map_=made, kinds=["MAP_CHANGED"])
    client.wait(client.optimise_map(made))
    assert comparisons(client, made) == []


def change_store(service, work):
    return service.world.context.transactions.write(work).result()


def test_a_suspended_webhook_is_told_later_of_drives_that_ended_meanwhile_though_another_asks_by_then(client, service):
    made = client.create_map(f"years-{next(_numbers)}", leave_distance_m=0).name
    asked = {"url": "https://hooks.example.com/revisit", "map_": made, "kinds": ["MAP_CHANGED"]}
    first = client.create_webhook(made[5:], **asked)

    def suspend(uow):
        row = uow.webhooks.get(TENANT, made[5:])
        uow.webhooks.replace(replace(row, state=WebhookState.SUSPENDED.value))

    change_store(service, suspend)
    for session in drive_twice(client, made, (5, 25)):
        client.finish_session(session)
    service.world.clock.ms += 1
    client.create_webhook(f"{made[5:]}-2", **asked)
    client.wait(client.optimise_map(made))
    assert comparisons(client, made) == []
    client.resume_webhook(first)
    client.wait(client.optimise_map(made))
    assert comparisons(client, made) != []
    (event,) = itertools.islice(client.watch(made, after=0, kinds=["MAP_CHANGED"]), 1)
    assert event.drive_changes.session.endswith("/tuesday")


def test_a_drive_is_compared_once_a_version_has_its_end(client, service):
    made = client.create_map(f"years-{next(_numbers)}", leave_distance_m=0).name
    client.create_webhook(made[5:], "https://hooks.example.com/revisit", map_=made, kinds=["MAP_CHANGED"])
    sessions = drive_twice(client, made, (5, 25))
    client.wait(client.optimise_map(made))
    client.wait(client.post_submap(sessions[1], "at-45", cloud_points(45), pose(45), TUESDAY + 45))
    client.finish_session(sessions[1])
    assert comparisons(client, made) == []
    client.wait(client.optimise_map(made))
    assert [one.subject for one in comparisons(client, made)] == [f"{made}/versions/2"]


def test_a_drive_is_told_though_the_version_it_waits_with_has_left(client, service):
    made = client.create_map(f"years-{next(_numbers)}", leave_distance_m=0).name
    client.create_webhook(made[5:], "https://hooks.example.com/revisit", map_=made, kinds=["MAP_CHANGED"])
    sessions = drive_twice(client, made, (5, 25))
    client.wait(client.optimise_map(made))
    client.wait(client.optimise_map(made))
    service.working.clear()
    for session in sessions:
        client.finish_session(session)
    assert [one.subject for one in comparisons(client, made)] == [f"{made}/versions/2"]
    client.revert_map(made, 1)
    change_store(service, lambda uow: forget_versions(uow, TENANT, made[5:], 2))
    service.working.set()
    eventually(lambda: f"{made}/versions/3" in [one.subject for one in comparisons(client, made)])
    (event,) = itertools.islice(client.watch(made, after=0, kinds=["MAP_CHANGED"]), 1)
    told = event.drive_changes
    assert (told.session, told.map_version) == (f"{made}/sessions/tuesday", f"{made}/versions/3")


def test_what_a_drive_found_changed_is_told_with_that_drive_and_the_time_in_between(client, driven_twice):
    found = client.map_changes(driven_twice)
    frame, session = (
        client.map_tiles(driven_twice)[0].frame,
        f"{driven_twice.partition('/versions/')[0]}/sessions/tuesday",
    )
    assert found and {(one.kind, one.frame, one.session) for one in found} == {("VANISHED", frame, session)}
    first = found[0]
    assert MONDAY <= first.before_ns < TUESDAY <= first.stamp_ns
    assert (first.extent_m, first.points, first.moved_from_m) == ((4.0, 2.0, 1.5), 40, None)
    assert client.map_changes(driven_twice.partition("/versions/")[0]) == found


def test_drives_are_compared_once_and_the_changes_kept(client, service, driven_twice):
    found, before = client.map_changes(driven_twice), service.world.tiler.compared
    assert client.map_changes(driven_twice) == found and service.world.tiler.compared == before


def test_whoever_lists_changes_is_charged_the_time_that_reading_them_takes(client, service, driven_twice, monkeypatch):
    client.map_changes(driven_twice)
    charged, read = [], FoundChanges.of
    monkeypatch.setattr(FoundChanges, "of", lambda blob: busy_s(0.02) or read(blob))
    monkeypatch.setattr(service.world.context.in_flight, "charge_call", lambda _, points: charged.append(points))
    assert client.map_changes(driven_twice)
    assert max(charged) >= 0.02 * POINTS_PER_S


def test_whoever_asks_for_a_moment_is_charged_the_time_that_reading_its_submaps_takes(
    client, service, driven_twice, monkeypatch
):
    tile = next(one for one in client.map_tiles(driven_twice) if one.name.endswith(".0.0"))
    client.download_tile(tile, "mesh", as_of_ns=TUESDAY)
    charged, plan = [], tile_rows.read_plan
    monkeypatch.setattr(tile_rows, "read_plan", lambda *asked: busy_s(0.02) or plan(*asked))
    monkeypatch.setattr(service.world.context.in_flight, "charge_call", lambda _, points: charged.append(points))
    client.download_tile(tile, "mesh", as_of_ns=TUESDAY + 1)
    assert max(charged) >= 0.02 * POINTS_PER_S


def busy_s(seconds: float) -> None:
    """Take so much time of a core."""
    until_s = time.thread_time() + seconds
    while time.thread_time() < until_s:
        pass


def test_changes_are_those_found_between_two_moments(client, driven_twice):
    every = client.map_changes(driven_twice)
    last_ns = max(one.stamp_ns for one in every)
    assert client.map_changes(driven_twice, after_ns=TUESDAY - 1, until_ns=last_ns) == every
    assert client.map_changes(driven_twice, after_ns=last_ns) == []
    assert client.map_changes(driven_twice, until_ns=TUESDAY - 1) == []


def test_a_map_of_one_drive_has_no_changes(client):
    session = client.create_session(client.create_map(f"years-{next(_numbers)}", leave_distance_m=0), "monday")
    client.wait(client.post_submap(session, "a", cloud_points(5), pose(5.0), MONDAY))
    version = client.wait(client.optimise_map(session.name.partition("/sessions/")[0])).result["version"]
    assert client.map_changes(version) == []


def test_changes_go_with_a_submap_that_is_deleted(client, service, driven_twice):
    client.map_changes(driven_twice)
    before = service.world.tiler.compared
    client.delete(f"{driven_twice.partition('/versions/')[0]}/sessions/monday/submaps/at-65")
    assert client.map_changes(driven_twice) and service.world.tiler.compared > before


def test_the_surface_of_a_moment_is_made_of_what_was_seen_by_then(client, service, driven_twice):
    tile = next(one for one in client.map_tiles(driven_twice) if one.name.endswith(".0.0"))
    drives = service.world.tiler.drives
    for asked, made_of in (
        ({}, {"monday", "tuesday"}), ({"as_of_ns": TUESDAY}, {"monday"}), ({"ever": True}, {""}),
        ({"as_of_ns": TUESDAY, "ever": True}, {""}),
    ):  # fmt: skip
        client.download_tile(tile, "mesh", **asked)
        assert len(drives[-1]) == len(made_of)
        assert (drives[-1] == {0}) == ("" in made_of)
    assert b"element face 0" in client.download_tile(tile, "mesh", as_of_ns=MONDAY - 1)
    assert client.map_points(driven_twice, (13.0, 13.0, 0.0), 40.0, as_of_ns=MONDAY - 1).total == 0
    assert client.map_distances(driven_twice, [[10.0, 10.0, 0.4]], ever=True).distance_m[0] == pytest.approx(0.4)


def test_what_cannot_be_asked_of_changes_is_told(client, driven_twice):
    with pytest.raises(InvalidArgument) as refused:
        client.map_changes(driven_twice, after_ns=-1)
    assert refused.value.field == "after_ns"
    with pytest.raises(InvalidArgument) as refused:
        client.download_tile(client.map_tiles(driven_twice)[0], "mesh", as_of_ns=-1)
    assert refused.value.field == "as_of_ns"
    with pytest.raises(NotFound):
        client.map_changes(f"{driven_twice}99")


def test_the_command_line_lists_changes_and_asks_for_a_moment(service, client, driven_twice, tmp_path):
    of_map = ["--map", driven_twice.split("/")[1], "--http", service.http]
    listed = CliRunner().invoke(app, ["map", "changes", *of_map, "--json"])
    assert listed.exit_code == 0, listed.output
    assert [one["kind"] for one in json.loads(listed.stdout)] == ["VANISHED"] * len(client.map_changes(driven_twice))
    of_day = ["--since", "2024-10-05", "--until", "2024-10-05"]
    listed_of_day = CliRunner().invoke(app, ["map", "changes", *of_map, *of_day, "--json"])
    assert json.loads(listed_of_day.stdout) == json.loads(listed.stdout)
    none = CliRunner().invoke(app, ["map", "changes", *of_map, "--until", "2024-10-04", "--json"])
    assert json.loads(none.stdout) == []
    tile_id, out = client.map_tiles(driven_twice)[0].name.rpartition("/")[2], tmp_path / "then.ply"
    asked = ["map", "tiles", tile_id, "--out", str(out), "--format", "mesh", "--as-of", "2024-10-04T12:00", *of_map]
    assert CliRunner().invoke(app, asked).exit_code == 0 and out.exists()
    assert CliRunner().invoke(app, [*asked[:-4], "--as-of", "yesterday", *of_map]).exit_code == 1
    assert CliRunner().invoke(app, ["map", "changes", *of_map, "--geojson", str(tmp_path / "c.json")]).exit_code == 1


def test_surfaces_of_moments_between_which_nothing_was_seen_are_one(client, service, driven_twice):
    tile = next(one for one in client.map_tiles(driven_twice) if one.name.endswith(".0.0"))
    now = client.download_tile(tile, "mesh")
    before = service.world.tiler.made
    assert client.download_tile(tile, "mesh", as_of_ns=TUESDAY + DAY_NS) == now
    assert client.map_points(driven_twice, (13.0, 13.0, 0.0), 5.0, as_of_ns=2**63 - 1).total > 0
    assert service.world.tiler.made == before
    for then in (MONDAY + 1000, MONDAY + 2000, TUESDAY - 1):
        client.download_tile(tile, "mesh", as_of_ns=then)
    assert service.world.tiler.made == before + 1


def test_of_more_drives_than_a_tile_is_made_of_the_latest_count(client, service, monkeypatch):
    monkeypatch.setattr(tile_rows, "MOST_SUBMAPS", 3)
    made = client.create_map(f"years-{next(_numbers)}", leave_distance_m=0)
    for number, places in enumerate(((5, 25, 45), (5, 25, 45), (5, 45))):
        session, day_ns = client.create_session(made, f"day-{number}"), MONDAY + number * DAY_NS
        for place in places:
            client.wait(client.post_submap(session, f"at-{place}", cloud_points(place), pose(place), day_ns + place))
    version = client.wait(client.optimise_map(made)).result["version"]
    tile, drives = (
        next(one for one in client.map_tiles(version) if one.name.endswith(".0.0")),
        service.world.tiler.drives,
    )
    client.download_tile(tile, "mesh")
    latest = max(drives[-1])
    assert (
        len(drives[-1]) == 2
    )  # both places of the last drive, and the one where it did not come by, of the day before
    client.download_tile(tile, "mesh", as_of_ns=MONDAY + 2 * DAY_NS)
    assert latest not in drives[-1] and len(drives[-1]) == 1
    client.download_tile(tile, "mesh", ever=True)


def test_changes_of_clocks_that_stand_still_are_listed(client):
    made = client.create_map(f"years-{next(_numbers)}", leave_distance_m=0)
    for session_id in ("monday", "tuesday"):
        session = client.create_session(made, session_id)
        for place in (5, 25, 45, 65):
            client.wait(client.post_submap(session, f"at-{place}", cloud_points(place), pose(place), 0))
    version = client.wait(client.optimise_map(made)).result["version"]
    found = client.map_changes(version)
    assert found and {one.stamp_ns for one in found} == {0}
    assert client.map_changes(version, after_ns=1) == []
