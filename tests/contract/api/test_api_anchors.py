"""Anchors of sessions, the same over REST and gRPC."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from revisit.cli.anchor_files import EARTH, POSE, SIGMAS
from revisit.cli.app import app
from revisit.sdk.anchors import NewAnchor
from revisit.sdk.errors import AlreadyExists, InvalidArgument, NotFound
from revisit.service.capacity.limits import ANCHOR_POINTS, CREATION_POINTS
from revisit.service.domain import limits
from tests.support.bag_layouts import Layout
from tests.support.service_world import cloud_points, pose

FIX = NewAnchor(
    "fix-1", "GNSS", 1_000, np.array([1.0, 1.0, 2.0]), geodetic=(48.0, 11.0, 500.0), offset_m=(0.1, 0.0, 1.5),
    T_odom_sensor=np.eye(4),
)  # fmt: skip
POINT = NewAnchor("door", "CONTROL_POINT", 2_000, 0.01 * np.eye(3), local_m=(1.0, 2.0, 3.0), T_odom_sensor=np.eye(4))
TAG = NewAnchor(
    "seen-17", "FIDUCIAL", 3_000, np.array([0.03, 0.03, 0.05]), offset_m=(2.0, 1.0, 0.5), T_odom_sensor=np.eye(4),
    tag="tag36h11:17",
)  # fmt: skip
START = replace(POINT, anchor_id="start", kind="KNOWN_POSE", heading_rad=0.5, heading_sigma_rad=0.01)


def test_anchors_are_stored_in_their_order_and_the_first_on_earth_gives_the_origin(client, session, town):
    assert client.get_map(town).origin is None
    posted = client.sessions.post_anchors(session, [POINT, FIX, START])
    assert [one.name for one in posted] == [f"{session.name}/anchors/{name}" for name in ("door", "fix-1", "start")]
    listed = client.sessions.anchors(session)
    assert listed == posted
    door, fix, start = listed
    assert (door.kind, door.local_m, door.geodetic, door.state, door.residual_m) == (
        "CONTROL_POINT", (1.0, 2.0, 3.0), None, None, None,
    )  # fmt: skip
    assert fix.geodetic is not None and fix.geodetic.latitude_deg == 48.0 and fix.offset_m == (0.1, 0.0, 1.5)
    assert np.diag(np.reshape(fix.covariance_enu, (3, 3))).tolist() == [1.0, 1.0, 4.0]
    assert (start.heading_rad, start.heading_sigma_rad) == (0.5, 0.01)
    origin = client.get_map(town).origin
    assert (origin.latitude_deg, origin.longitude_deg, origin.altitude_m) == (48.0, 11.0, 500.0)


def test_a_fiducial_has_its_tag_and_no_place_and_is_passed_over_again(client, session, town):
    (posted,) = client.sessions.post_anchors(session, [TAG])
    assert (posted.kind, posted.tag, posted.offset_m) == ("FIDUCIAL", "tag36h11:17", (2.0, 1.0, 0.5))
    assert (posted.geodetic, posted.local_m, posted.state) == (None, None, None)
    assert client.sessions.post_anchors(session, [TAG]) == [posted] == client.sessions.anchors(session)
    with pytest.raises(AlreadyExists):
        client.sessions.post_anchors(session, [replace(TAG, tag="tag36h11:18")])
    assert client.get_map(town).origin is None


def test_the_same_anchor_again_is_passed_over_and_another_of_its_id_is_refused(client, session):
    first = client.sessions.post_anchors(session, [FIX])
    assert client.sessions.post_anchors(session, [FIX, POINT])[0] == first[0]
    with pytest.raises(AlreadyExists):
        client.sessions.post_anchors(session, [START, replace(FIX, stamp_ns=5)])
    assert len(client.sessions.anchors(session)) == 2


def test_anchors_that_are_there_are_passed_over_though_the_session_has_room_for_no_more(client, session, monkeypatch):
    monkeypatch.setattr(limits, "ANCHORS_OF_SESSION", 2)
    posted = client.sessions.post_anchors(session, [FIX, POINT])
    assert client.sessions.post_anchors(session, [FIX, POINT]) == posted
    with pytest.raises(InvalidArgument, match="at most 2 anchors"):
        client.sessions.post_anchors(session, [FIX, START])
    with pytest.raises(InvalidArgument, match="at most 2 anchors"):
        client.sessions.preview_anchors(session, [FIX, START])
    assert client.sessions.preview_anchors(session, [FIX]).kind == "PREVIEW_ANCHORS"
    assert client.sessions.anchors(session) == posted


def test_as_many_anchors_are_taken_at_once_as_a_request_may_have(client, session):
    most = [replace(FIX, anchor_id=f"fix-{n}", offset_m=np.full(3, 1 / 3)) for n in range(int(limits.ANCHORS.most))]
    assert client.sessions.preview_anchors(session, most).kind == "PREVIEW_ANCHORS"
    assert len(client.sessions.post_anchors(session, most)) == 200


def test_anchors_are_charged_each_and_so_is_looking_for_their_poses(client, service, session, monkeypatch):
    charged = []
    monkeypatch.setattr(service.world.context.in_flight, "charge_call", lambda _, points: charged.append(points))
    client.sessions.post_anchors(session, [FIX, POINT, START])
    assert max(charged) == CREATION_POINTS + 3 * ANCHOR_POINTS
    charged.clear()
    with pytest.raises(InvalidArgument, match="no scans are stored"):
        client.sessions.post_anchors(session, [replace(FIX, anchor_id="sought", T_odom_sensor=None)])
    assert sorted(charged)[-1] == CREATION_POINTS + ANCHOR_POINTS and 0 < sorted(charged)[-2] < CREATION_POINTS


def test_a_deleted_anchor_is_gone(client, session):
    (posted,) = client.sessions.post_anchors(session, [FIX])
    client.sessions.delete_anchor(posted)
    assert client.sessions.anchors(session) == []
    with pytest.raises(NotFound):
        client.sessions.delete_anchor(posted)


def test_a_false_first_fix_is_no_origin_any_more_once_it_is_deleted(client, session, town):
    def latitude_deg():
        origin = client.get_map(town).origin
        return origin and origin.latitude_deg

    zero, other = replace(FIX, anchor_id="zero", geodetic=(0.0, 0.0, 0.0)), client.create_session(town, "other")
    client.sessions.post_anchors(other, [zero])
    (false, fix) = client.sessions.post_anchors(session, [replace(zero, geodetic=(1.0, 0.0, 0.0)), FIX])
    assert latitude_deg() == 0.0
    client.delete(other)
    assert latitude_deg() == 1.0
    client.sessions.delete_anchor(false)
    assert latitude_deg() == 48.0
    (door,) = client.sessions.post_anchors(session, [POINT])
    client.sessions.delete_anchor(fix)
    assert latitude_deg() == 48.0  # the door is measured from there
    client.sessions.delete_anchor(door)
    client.sessions.delete_anchor(client.sessions.post_anchors(session, [FIX])[0])
    assert latitude_deg() is None


def test_a_first_fix_that_lies_on_another_continent_than_the_others_is_no_origin(client, session, town):
    zero = replace(FIX, anchor_id="zero", geodetic=(0.0, 0.0, 0.0))
    others = [replace(FIX, anchor_id=f"fix-{n}", geodetic=(48.0, 11.0, 500.0 + n)) for n in range(3)]
    client.sessions.post_anchors(session, [zero])
    client.sessions.post_anchors(session, others)
    assert (client.get_map(town).origin.latitude_deg, client.get_map(town).origin.altitude_m) == (48.0, 500.0)
    town_beside = client.create_map("beside")
    client.sessions.post_anchors(client.create_session(town_beside, "drive"), [zero, *others])
    assert client.get_map(town_beside).origin.latitude_deg == 48.0
    client.sessions.post_anchors(session, [replace(zero, anchor_id="zero-again")])
    assert client.get_map(town).origin.latitude_deg == 48.0


def test_a_preview_of_anchors_is_an_operation_that_keeps_none(client, session):
    asked = client.sessions.preview_anchors(session, [POINT, FIX])
    assert (asked.kind, asked.subject) == ("PREVIEW_ANCHORS", session.name)
    done = client.wait(asked)
    assert done.result == {"outcome": "the map holds no submaps"}
    assert client.sessions.anchors(session) == []
    client.sessions.post_anchors(session, [FIX])
    with pytest.raises(AlreadyExists):
        client.sessions.preview_anchors(session, [replace(FIX, stamp_ns=5)])
    with pytest.raises(AlreadyExists):
        client.sessions.preview_anchors(session, [POINT, replace(POINT, stamp_ns=5)])
    with pytest.raises(InvalidArgument):
        client.sessions.preview_anchors(session, [replace(FIX, T_odom_sensor=None)])


@pytest.mark.parametrize(
    ("one", "change", "field"),
    [
        (TAG, {"tag": None}, "tag"),
        (TAG, {"tag": ""}, "tag"),
        (TAG, {"tag": 65 * "7"}, "tag"),
        (TAG, {"tag": " 7"}, "tag"),
        (TAG, {"local_m": (0.0, 0.0, 0.0)}, "tag"),
        (TAG, {"heading_rad": 1.0, "heading_sigma_rad": 0.1}, "heading_rad"),
        (FIX, {"tag": "tag36h11:17"}, "tag"),
    ],
)
def test_a_tag_without_its_id_or_with_a_place_is_refused(client, session, one, change, field):
    with pytest.raises(InvalidArgument) as refused:
        client.sessions.post_anchors(session, [replace(one, **change)])
    assert (refused.value.field or "").endswith(field)


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"geodetic": (91.0, 0.0, 0.0)}, "latitude_deg"),
        ({"geodetic": (0.0, 181.0, 0.0)}, "longitude_deg"),
        ({"geodetic": (0.0, 0.0, 1e6)}, "altitude_m"),
        ({"local_m": (0.0, 0.0, 0.0)}, "geodetic"),
        ({"geodetic": None}, "geodetic"),
        ({"covariance_enu": np.zeros((3, 3))}, "covariance_enu"),
        ({"covariance_enu": np.eye(2)}, "covariance_enu"),
        ({"covariance_enu": np.diag([1.0, 1.0, 1e9])}, "covariance_enu"),
        ({"offset_m": (0.0, 2000.0, 0.0)}, "offset_m"),
        ({"heading_rad": 1.0, "heading_sigma_rad": 0.1}, "heading_rad"),
        ({"kind": "KNOWN_POSE"}, "heading_rad"),
        ({"T_odom_sensor": None}, "t_odom_sensor"),
        ({"anchor_id": "a b"}, "anchor_id"),
        ({"stamp_ns": -1}, "stamp_ns"),
    ],
)
def test_an_anchor_out_of_bounds_is_refused(client, session, change, field):
    with pytest.raises(InvalidArgument) as refused:
        client.sessions.post_anchors(session, [replace(FIX, **change)])
    assert (refused.value.field or "").endswith(field)
    assert client.sessions.anchors(session) == []


def test_a_session_that_is_not_there_has_no_anchors(client, town):
    with pytest.raises(NotFound):
        client.sessions.anchors(f"{town}/sessions/sunday")
    with pytest.raises(NotFound):
        client.sessions.post_anchors(f"{town}/sessions/sunday", [FIX])


def test_fixes_in_a_bag_become_anchors_of_its_session(service, client, tmp_path):
    layout = Layout().raw("/points", "base").odometry("/odom", "odom", "base")
    bag = layout.fixes("/gps/fix", lambda stamp: (48.0, 11.0, 500.0)).write2(tmp_path / "drive")
    where = ["--grpc", service.grpc, "--map", f"bag-{type(client._transport).__name__}", "--json"]

    def ingested(*more: str) -> dict[str, object]:
        done = CliRunner().invoke(app, ["ingest", str(bag), *where, *more])
        assert done.exit_code == 0, done.output
        return json.loads(done.stdout)

    assert ingested("--session", "without", "--no-gnss")["anchors"] == 0
    done = ingested("--antenna", "0.5 0 1.2")
    again = ingested("--antenna", "0.5 0 1.2")
    assert (done["anchors"], again["anchors"], again["scans_sent"]) == (2, 2, 0)
    kept = client.sessions.anchors(done["session"])
    assert [one.kind for one in kept] == ["GNSS", "GNSS"] and kept[0].offset_m == (0.5, 0.0, 1.2)


def test_anchors_are_added_tried_listed_and_removed_from_the_command_line(service, session, client, tmp_path):
    table = tmp_path / "anchors.csv"
    head = ",".join(["anchor_id", "kind", "time", *EARTH, *SIGMAS, *POSE])
    table.write_text("\n".join([head, *(f"fix-{n},GNSS,{n},48,11,500,1,1,2,{n},0,0,0,0,0,1" for n in range(3))]))
    _, town, _, monday = session.name.split("/")
    at = ["--http", service.http, "--map", town]
    of_session = [*at, "--session", monday]

    def invoked(*arguments: str, status: int = 0) -> str:
        done = CliRunner().invoke(app, ["anchors", *map(str, arguments)])
        assert done.exit_code == status, done.output
        return done.output

    assert "the map holds no submaps" in invoked("preview", table, *of_session, status=1)
    client.wait(client.post_submap(session, "a", cloud_points(1), pose(0.0), 1))
    told = json.loads(invoked("preview", table, *of_session, "--json"))
    assert [(one["name"][-5:], one["state"], one["reason"]) for one in told["anchors"]] == [
        (f"fix-{n}", "NOT_ALIGNED", "TOO_FEW") for n in range(3)
    ]
    assert "TOO_FEW" in invoked("preview", table, *of_session)
    assert client.sessions.anchors(session) == []

    assert f"{session.name} has 3 anchors of anchors.csv." in invoked("add", table, *of_session)
    listed = json.loads(invoked("list", *at, "--json"))
    assert [one["name"][-5:] for one in listed] == ["fix-0", "fix-1", "fix-2"]
    again = tmp_path / "again.json"
    again.write_text(json.dumps(listed))
    assert len(json.loads(invoked("add", again, *of_session, "--json"))) == 3, "an answer is a file, too"
    assert "0 of 3 anchors hold the map" in invoked("list", *of_session)

    assert f"{session.name} has lost 1 anchor." in invoked("remove", "fix-1", *of_session, "--yes")
    assert [one.name[-5:] for one in client.sessions.anchors(session)] == ["fix-0", "fix-2"]
    assert "give --session and either ID... or --all" in invoked("remove", *of_session, status=1)
    invoked("remove", "--all", *of_session, "--yes")
    assert client.sessions.anchors(session) == []
