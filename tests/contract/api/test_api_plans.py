"""Plans of maps, the same over REST and gRPC: pictures underneath a map, each held by two pins."""

from __future__ import annotations

import itertools
import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import httpx
import numpy as np
import pytest
from typer.testing import CliRunner

from revisit.cli.app import app
from revisit.core.geometry import se3
from revisit.sdk.earth import OnEarth
from revisit.sdk.errors import AlreadyExists, ApiError, InvalidArgument, NotFound
from revisit.sdk.groups.maps import Maps
from revisit.service.domain import limits
from revisit.service.features.graph.session_poses import PackedSubmaps
from revisit.service.ports.blobs import PLAN_BLOB
from tests.support.made_pictures import PNG_BEGIN, a_jpeg, a_png, header, part
from tests.support.service_world import TENANT, cloud_points, pose

PINS = [((0, 0), (10.0, 20.0)), ((40, 0), (10.0, 24.0))]
_places = itertools.count(70_000)


@pytest.fixture(scope="module")
def http():
    with httpx.Client(trust_env=False) as opened:
        yield opened


def rows(service):
    return service.world.context.transactions.read(lambda uow: uow.plans.find(TENANT)).result()


def pictures(service):
    return {blob for blob in service.world.context.blobs.stored(0.0) if blob.kind == PLAN_BLOB}


def ground(pin):
    return pin.x_m, pin.y_m


def test_a_picture_lies_underneath_a_map_until_it_is_deleted(client, town, service):
    image = a_png()
    made = client.plans.create(town, "ground", image, PINS, display_name="Ground floor", storey="0")
    assert (made.name, made.display_name, made.storey) == (f"{town}/plans/ground", "Ground floor", "0")
    assert (made.media_type, made.width_px, made.height_px, made.size_bytes) == ("image/png", 40, 30, len(image))
    assert [(pin.pixel_x, pin.pixel_y, *ground(pin)) for pin in made.pins] == [(0, 0, 10, 20), (40, 0, 10, 24)]
    assert made.metres_per_pixel == pytest.approx(0.1) and made.turn_rad == pytest.approx(math.pi / 2)
    assert client.plans.list(town) == [client.plans.get(made)] == [made]
    assert client.plans.download(made) == image
    client.plans.delete(made)
    assert client.plans.list(town) == []
    for gone in (client.plans.get, client.plans.delete, client.plans.download):
        with pytest.raises(NotFound):
            gone(made)
    actions = [
        row.action for row in service.world.context.transactions.read(lambda u: u.audit.since(0, 10**6)).result()
    ]
    assert {"plan_created", "plan_deleted"} <= set(actions)


def test_the_same_again_is_passed_over_and_anything_else_refused(client, town):
    made = client.plans.create(town, "ground", a_jpeg(), PINS)
    assert client.plans.create(town, "ground", a_jpeg(), PINS) == made
    for other in ({"image": a_png()}, {"pins": PINS[::-1]}, {"storey": "1"}):
        with pytest.raises(AlreadyExists):
            client.plans.create(town, "ground", **{"image": a_jpeg(), "pins": PINS, **other})
    assert len(client.plans.list(town)) == 1


def test_other_pins_hold_a_plan_and_a_bad_pair_changes_nothing(client, town):
    made = client.plans.create(town, "ground", a_png(), PINS)
    moved = client.plans.pin(made, [((0, 30), (0.0, 0.0)), ((40, 30), (80.0, 0.0))])
    assert (moved.metres_per_pixel, moved.turn_rad) == (2.0, 0.0)
    for bad in (
        [PINS[0]],
        [*PINS, PINS[0]],
        [PINS[0], PINS[0]],
        [PINS[0], ((1, 1), (5.0, 5.0))],
        [PINS[0], ((40, 0), PINS[0][1])],
        [PINS[0], ((41, 0), (5.0, 5.0))],
        [PINS[0], ((-1, 0), (5.0, 5.0))],
        [PINS[0], ((40, 0), (2e6, 5.0))],
        [PINS[0], ((40, 0), (math.nan, 5.0))],
    ):
        with pytest.raises((InvalidArgument, ValueError)):
            client.plans.pin(made, bad)
        with pytest.raises((InvalidArgument, ValueError)):
            client.plans.create(town, "bad", a_png(), bad)
    assert client.plans.list(town) == [moved]


HOSTILE = {
    "a drawing": (b'<svg xmlns="http://www.w3.org/2000/svg" onload="alert(1)"/>', "UNSUPPORTED_ENCODING"),
    "a page behind a picture": (a_png() + b"<script>alert(1)</script>", "MALFORMED_BODY"),
    "2^31 wide": (PNG_BEGIN + header(2**31 - 1, 1) + part(b"IDAT", b"x") + part(b"IEND"), "TOO_LARGE"),
}


@pytest.mark.parametrize(("image", "reason"), HOSTILE.values(), ids=HOSTILE)
def test_a_file_that_is_no_plain_picture_is_refused_with_its_reason(client, town, service, image, reason):
    before = pictures(service)
    with pytest.raises(ApiError) as refused:
        client.plans.create(town, "bad", image, PINS)
    assert refused.value.reason == reason
    assert client.plans.list(town) == []
    assert pictures(service) == before


def test_a_file_that_is_too_large_is_refused(client, town, monkeypatch):
    monkeypatch.setattr(limits, "PLAN_IMAGE_BYTES", 1000)
    with pytest.raises(ApiError) as refused:
        client.plans.create(town, "large", a_png(40, 30, part(b"noTh", bytes(2000))), PINS)
    assert refused.value.reason == "TOO_LARGE"


@pytest.mark.parametrize("name", ["x" * 2**20, "two\nlines", "x" * 257])
def test_a_name_that_is_no_line_is_refused(client, town, name):
    with pytest.raises((ApiError, httpx.InvalidURL)):
        client.plans.create(town, "named", a_png(), PINS, display_name=name)
    assert client.plans.list(town) == []


def test_a_name_with_markup_is_a_name(client, town):
    name = "<img src=x onerror=alert(1)>"
    assert client.plans.create(town, "named", a_png(), PINS, display_name=name).display_name == name


def test_a_picture_is_served_as_what_it_is_and_nothing_else(client, town, service, http):
    made, image = client.plans.create(town, "ground", a_png(), PINS), a_png()
    url = f"{service.http}/v1/{made.name}:download"
    answer = http.get(url)
    assert answer.content == image and answer.headers["content-type"] == "image/png"
    assert answer.headers["x-content-type-options"] == "nosniff"
    assert answer.headers["content-security-policy"] == "default-src 'none'; sandbox"
    assert answer.headers["content-disposition"].startswith("attachment;")
    assert answer.headers["cache-control"] == "private, no-cache"
    again = http.get(url, headers={"if-none-match": answer.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")


def test_a_body_is_of_the_kind_that_it_is_sent_as(town, service, http):
    query = {"plan_id": "ground", "pins": ["0,0,0,0", "40,0,4,0"]}
    url = f"{service.http}/v1/{town}/plans"
    for kind in ("text/html", "image/svg+xml", "image/jpeg", "application/octet-stream"):
        answer = http.post(url, params=query, content=a_png(), headers={"content-type": kind})
        assert (answer.status_code, answer.json()["reason"]) == (415, "UNSUPPORTED_ENCODING")
    png = {"content": a_png(), "headers": {"content-type": "image/png"}}
    for bad in ("0,0,0", "0,0,0,nan", "a,b,c,d", "0,0,0,1e999"):
        assert http.post(url, params={**query, "pins": [bad, "40,0,4,0"]}, **png).status_code == 422
    made = http.post(url, params=query, **png)
    assert (made.status_code, made.json()["name"]) == (201, f"{town}/plans/ground")
    assert http.post(url, params=query, **png).headers["idempotent-replay"] == "true"


def test_a_map_has_a_bounded_number_of_plans_and_bytes(client, town, monkeypatch):
    monkeypatch.setattr(limits, "PLANS_OF_MAP", 2)
    for number in range(2):
        client.plans.create(town, f"p{number}", a_png(red=number), PINS)
    with pytest.raises(ApiError, match="at most 2 plans"):
        client.plans.create(town, "p2", a_png(), PINS)
    monkeypatch.setattr(limits, "PLANS_OF_MAP", 20)
    stored = sum(plan.size_bytes for plan in client.plans.list(town))
    monkeypatch.setattr(limits, "PLAN_BYTES_OF_MAP", stored + len(a_png()) - 1)
    with pytest.raises(ApiError, match="together"):
        client.plans.create(town, "p2", a_png(), PINS)
    monkeypatch.setattr(limits, "PLAN_BYTES_OF_MAP", stored + len(a_png()))
    client.plans.create(town, "p2", a_png(), PINS)


def test_one_of_many_who_create_at_the_same_time_wins_and_all_may_pin(client, town):
    images = [a_png(red=red) for red in range(4)]

    def create(image):
        try:
            client.plans.create(town, "ground", image, PINS)
        except AlreadyExists:
            return False
        return True

    with ThreadPoolExecutor(4) as pool:
        assert sum(pool.map(create, images)) == 1
        (made,) = client.plans.list(town)
        pairs = [[PINS[0], ((40, 0), (10.0, 24.0 + number))] for number in range(4)]
        pinned = [*pool.map(lambda pins: client.plans.pin(made, pins), pairs)]
    assert client.plans.get(made) in pinned
    assert client.plans.download(made) in images


def test_plans_go_with_their_map(client, town, service):
    client.plans.create(town, "ground", a_png(), PINS)
    client.delete(town)
    with pytest.raises(NotFound):
        client.plans.list(town)
    assert [row for row in rows(service) if f"maps/{row.map_id}" == town] == []


def drive_of_two(client, session):
    """A map with a version: two submaps that look alike, half a metre apart, and their loop."""
    place = next(_places)
    for number in range(2):
        client.wait(client.post_submap(session, f"s{number}", cloud_points(place), pose(20.0 * number), number + 1))


def test_pins_go_with_the_submaps_that_they_are_nearest_to(client, session, town, service):
    drive_of_two(client, session)
    early = client.plans.create(town, "early", a_png(), [((0, 0), (0.5, 0.0)), ((40, 0), (20.5, 0.0))])
    assert (early.frame, early.map_version) == ("", 0)
    client.wait(client.optimise_map(town))
    first, second = (client.get_submap(f"{session.name}/submaps/s{number}").in_map for number in range(2))
    places = [tuple(one.T_map[:2, 3] + 0.25) for one in (first, second)]
    made = client.plans.create(town, "ground", a_png(), [((0, 0), places[0]), ((40, 0), places[1])])
    assert (made.frame, made.map_version) == (first.frame, 1)
    assert np.allclose([ground(pin) for pin in made.pins], places)
    shifted(service, town, session, "s1", 3.0)
    after = client.plans.get(made)
    assert ground(after.pins[0]) == pytest.approx(ground(made.pins[0]))
    assert ground(after.pins[1]) == pytest.approx(np.add(ground(made.pins[1]), (3.0, 0.0)))
    early = client.plans.get(early)
    offs = np.subtract([ground(pin) for pin in early.pins], [one.T_map[:2, 3] for one in (first, second)])
    assert early.frame == first.frame and np.allclose(offs, [(0.5, 0.0), (3.5, 0.0)])
    client.delete(f"{session.name}/submaps/s1")
    assert np.allclose([ground(pin) for pin in client.plans.get(made).pins], places)


def shifted(service, town, session, submap, metres):
    """As another version of the map would: a submap lies elsewhere."""
    map_id, session_id = town.partition("/")[2], session.name.rpartition("/")[2]

    def work(uow):
        (row,) = uow.session_poses.find(TENANT, map_id=map_id, session_id=session_id)
        poses = PackedSubmaps.of(row.submaps)
        number = uow.submaps.get(TENANT, map_id, session_id, submap).number
        T_map_submap = poses.T_map_submap.copy()
        T_map_submap[poses.place_of(number), 0, 3] += metres
        uow.session_poses.replace(replace(row, submaps=replace(poses, T_map_submap=T_map_submap).packed()))

    service.world.context.transactions.write(work).result()


def test_plans_are_put_underneath_pinned_listed_and_removed_from_the_command_line(service, town, client, tmp_path):
    file, map_id = tmp_path / "ground.png", town.partition("/")[2]
    file.write_bytes(a_png())

    def revisit(*arguments):
        done = CliRunner().invoke(app, ["plans", *arguments, "--http", service.http])
        return done.exit_code, done.output

    pins = ["--pin", "0,0=10,20", "--pin", "40,0=10,24"]
    assert revisit("add", map_id, str(file), "--storey", "0", *pins) == (
        0, f"{town}/plans/ground: 0.1 m a pixel, turned by 90.0 degrees counter-clockwise.\n"
    )  # fmt: skip
    assert revisit("pin", map_id, "ground", "--pin", "0,0=0,0", "--pin", "40,0=-8,0", "--json")[0] == 0
    (made,) = client.plans.list(town)
    assert (made.metres_per_pixel, made.storey) == (pytest.approx(0.2), "0")
    code, listed = revisit("list", map_id)
    assert code == 0 and "40 x 30" in listed and "180.0 deg" in listed
    code, said = revisit("add", map_id, str(file), "--pin", "0,0:1,1", *pins[:2])
    assert code != 0 and "0,0:1,1" in said
    assert revisit("remove", map_id, "ground", "--yes")[0] == 0
    assert client.plans.list(town) == []


def test_pins_on_earth_are_places_of_the_frame_that_anchors_hold(service, town, client, tmp_path, monkeypatch):
    file, map_id = tmp_path / "site.png", town.partition("/")[2]
    file.write_bytes(a_png())
    earth = OnEarth((48.0, 11.0, 500.0), se3.from_yaw(0.5, (3.0, -2.0, 0.0)))
    held = {"frame-1": earth}
    monkeypatch.setattr(Maps, "on_earth", lambda *_: held)
    corners = [earth.pose(se3.from_yaw(0.0, (x, y, 0.0))) for x, y in ((10.0, 20.0), (50.0, 20.0))]
    pins = [f"--pin={40 * n},0={at.latitude_deg!r},{at.longitude_deg!r}" for n, at in enumerate(corners)]
    command = ["plans", "add", map_id, str(file), "--on-earth", "--http", service.http]
    assert CliRunner().invoke(app, [*command, *pins]).exit_code == 0
    (made,) = client.plans.list(town)
    assert np.allclose([ground(pin) for pin in made.pins], [(10.0, 20.0), (50.0, 20.0)], atol=1e-3)
    exchanged = [f"--pin={40 * n},0={at.longitude_deg!r},{at.latitude_deg!r}" for n, at in enumerate(corners)]
    refused = CliRunner().invoke(app, [*command, *exchanged])
    assert refused.exit_code != 0 and "100 km from the map" in str(refused.exception)
    held.clear()
    refused = CliRunner().invoke(app, [*command, *pins])
    assert refused.exit_code != 0 and "has 0 frames on earth" in refused.output
