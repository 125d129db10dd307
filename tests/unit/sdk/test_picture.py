"""A map as a picture: SVG that a notebook shows."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import pytest

from revisit import Client, picture
from tests.support.live_service import live_service
from tests.support.page_town import EACH_BY_ITSELF, fill

SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="module")
def client():
    with live_service(pipeline=EACH_BY_ITSELF) as service, Client(service.http) as opened:
        fill(opened)
        opened.create_map("empty")
        yield opened


def drawn(client, name):
    return ET.fromstring(picture(client, name)._repr_svg_())


def test_a_map_without_a_version_shows_its_first_session_as_odometry_has_it(client):
    image = drawn(client, "town")
    assert [text.text for text in image.iter(f"{SVG}text")][:-1] == ["monday"]
    assert len(list(image.iter(f"{SVG}circle"))) == 5


def test_every_submap_is_within_the_picture_and_both_axes_have_one_scale(client, tmp_path):
    image = drawn(client, "town")
    width, height = (float(image.get(side)) for side in ("width", "height"))
    places = [(float(dot.get("cx")), float(dot.get("cy"))) for dot in image.iter(f"{SVG}circle")]
    assert all(0 < x < width and 0 < y < height for x, y in places)
    odometry = [submap.T_odom_submap[:2, 3] for submap in client.list_submaps("maps/town/sessions/monday")]
    scales = [(a - b) / (c - d) for a, b, c, d in zip(places[1], places[0], odometry[1], odometry[0], strict=True)]
    assert scales[0] == pytest.approx(-scales[1], rel=0.01)
    picture(client, "maps/town").save(tmp_path / "town.svg")
    assert (tmp_path / "town.svg").read_text().startswith("<svg")


def test_a_map_with_a_version_shows_the_sessions_of_its_largest_frame(client):
    client.wait(client.optimise_map("town"))
    assert len(list(drawn(client, "town").iter(f"{SVG}circle"))) >= 5


def test_an_empty_map_is_an_empty_picture(client):
    assert list(drawn(client, "empty").iter(f"{SVG}circle")) == []
