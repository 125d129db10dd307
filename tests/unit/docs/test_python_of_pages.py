"""Every Python block of the how-tos and quick starts runs, as it stands there, against a service with a small map."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from itertools import count, repeat
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from revisit import Client
from revisit.core.model_bundle import load_packaged_models
from revisit.formats.map_file import MapDescription, write_map_file
from revisit.sdk.anchors import NewAnchor
from revisit.sdk.resources import Event, Session
from revisit.service.features.webhooks.deliveries import signature_of
from tests.support.live_service import live_service
from tests.support.made_pictures import a_png
from tests.support.service_world import cloud_points, memory_world, pose

DOCS = Path(__file__).resolve().parents[3] / "docs"
BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)
BLOCKS = {
    f"{page.stem}-{number}": block
    for part in ("how-to", "quick-start")
    for page in sorted((DOCS / part).glob("*.md"))
    for number, block in enumerate(BLOCK.findall(page.read_text()), 1)
}

MAPS = {"town": 2, "annex": 1, "site": 1, "plant": 1, "yard": 2}
"""Maps that the pages talk of, with their drives, all past the same places; each has a version."""
PLACES = (5, 25)
DAY_NS = 86_400 * 10**9

HERE = {
    '"https://maps.example", api_key="rv_...", ca="authority.pem"': "HTTP",
    '"grpcs://maps.example:8090", api_key="rv_...", ca="authority.pem"': "GRPC",
    '"grpcs://service.local:8090", api_key="rv_...", ca="authority.pem"': "GRPC",
    '"127.0.0.1:8090"': "GRPC",
    '"http://127.0.0.1:8080"': "HTTP",
    'api_key="rv_..."': "HTTP",
    '"/var/lib/robot/drive.spool"': '"drive.spool"',
    "files/7": "files/1",
    'create_map("town"': 'create_map("new"',
    'create_session("maps/town"': 'create_session("maps/empty"',
    "        ...\n": "        break\n",
}
"""Other hosts, files and names of the pages, and those of the test; longest first."""

SILENT = {"make-one-map-2", "take-a-map-along-2"}
"""Blocks that print of each of some things, of which the maps of the test have none."""

SECRET = "whsec_c2VjcmV0"
"""Of a webhook."""

IN_A_FILE = {"take-a-map-along-2": "yard.zip", "relocalise-while-driving-2": "plant.zip"}
"""Those that describe a cloud by the method itself, in the file of a map: seconds to load its kernels."""

ENDLESS = {"watch-a-map-1": ("was taken", "DONE")}
"""Those that go on for ever, with the ends of the lines after which they have shown enough."""


class Enough(Exception):
    """A block has shown enough."""


@pytest.fixture(scope="module")
def service():
    with live_service(memory_world()) as running, Client.grpc(running.grpc) as client:
        for name, drives in MAPS.items():
            made = client.create_map(name, leave_distance_m=0)
            for day, session_id in enumerate(("monday", "tuesday")[:drives]):
                _drive(client, client.create_session(made, session_id), day)
            client.wait(client.optimise_map(made))
        client.wait(client.publish_map("maps/town"))
        client.create_session("maps/town", "2025-03-07-robot-4")
        client.create_session(client.create_map("car-park"), "monday")
        client.create_map("empty")
        yield running


def _drive(client: Client, session: Session, day: int) -> None:
    """Post a submap of each place; two poses say where a session of `site` lies on earth."""
    posted = [
        client.post_submap(session, f"at-{place}", cloud_points(place), pose(place), day * DAY_NS + place)
        for place in PLACES
    ]
    for one in posted:
        client.wait(one)
    if "/site/" in session.name:
        with client.stream(session) as stream:
            for metre in (0, 1):
                stream.send(cloud_points(metre), pose(metre), 5 * DAY_NS + metre * 10**9)
        client.sessions.post_anchors(session, [_known(day, place) for place in PLACES])


def _known(day: int, place: int) -> NewAnchor:
    return NewAnchor(
        f"at-{place}", "KNOWN_POSE", day * DAY_NS + place, (0.1, 0.1, 0.1),
        geodetic=(48.1, 11.5 + place / 74_000, 520.0), heading_rad=0.0, heading_sigma_rad=0.01,
        T_odom_sensor=pose(place),
    )  # fmt: skip


def _yours(client: Client) -> dict[str, Any]:
    """Everything that a block takes from its reader's program, by the name that it has there."""
    loop, *_ = client.loop_closures("maps/town")
    tile, *_ = client.map_tiles("maps/yard")
    at = cloud_points(PLACES[0])
    return {
        "client": client, "Client": Client, "town": "maps/town", "session": "maps/town/sessions/monday",
        "points": at, "cloud": at, "T_odom_submap": pose(70.0), "T_odom_sensor": pose(), "stamp_ns": 5 * DAY_NS,
        "robot": zip(repeat(at), map(pose, range(20))), "surveyed": (48.1, 11.5, 520.0), "anchors": [_known(0, 5)],
        "lidar": [SimpleNamespace(points=at, T_odom_sensor=pose(x), stamp_ns=x) for x in range(3)],
        "loop": loop, "query": loop.query, "match": loop.match, "guess": np.eye(4), "tile": tile, "last_week_ns": 0,
        "send": lambda action: action["actionType"], "SECRET": SECRET, "handle": print,
    }  # fmt: skip


def _file_of_no_submaps(path: Path) -> None:
    model = load_packaged_models().version
    write_map_file(path, MapDescription("yard", "1", "hash", 0, model, 1.0, 10.0, 5.0, {}), [])


@contextmanager
def _robot(client: Client) -> Iterator[None]:
    """A robot comes by the first place of `town` again and again."""
    left = threading.Event()

    def drive() -> None:
        for number in count(1):
            submap = f"again-{number}", cloud_points(PLACES[0]), pose(100.0 * number), 3 * DAY_NS + number
            client.wait(client.post_submap("maps/town/sessions/tuesday", *submap))
            if left.wait(0.2):
                return

    driving = threading.Thread(target=drive)
    driving.start()
    try:
        yield
    finally:
        left.set()
        driving.join()


@pytest.mark.parametrize("name", BLOCKS)
def test_a_block_runs_as_it_stands(name, service, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("REVISIT_HTTP", service.http)
    monkeypatch.setenv("REVISIT_GRPC", service.grpc)
    Path("ground-floor.png").write_bytes(a_png(2400, 600))
    if name in IN_A_FILE:
        _file_of_no_submaps(Path(IN_A_FILE[name]))
    awaited, printed = set(ENDLESS.get(name, ())), []

    def show(*words: object, **_: object) -> None:
        printed.append(words)
        awaited.discard(str(words[-1]))
        if name in ENDLESS and not awaited:
            raise Enough

    block = BLOCKS[name]
    for there, here in HERE.items():
        block = block.replace(there, {"HTTP": repr(service.http), "GRPC": repr(service.grpc)}.get(here, here))
    with Client() as client, suppress(Enough), _robot(client) if name in ENDLESS else nullcontext():
        exec(compile(block, name, "exec"), _yours(client) | {"print": show})
    assert bool(printed) == ("print(" in block and name not in SILENT)


def test_the_receiver_of_webhooks_passes_an_event_on_once():
    body, at = b'{"events": [{"map": "maps/town", "number": "7"}]}', str(int(time.time()))
    headers = {"webhook-id": "1", "webhook-timestamp": at, "webhook-signature": signature_of(SECRET, "1", at, body)}
    handled: list[Event] = []
    names: dict[str, Any] = {"SECRET": SECRET, "handle": handled.append}
    exec(BLOCKS["receive-webhooks-2"], names)
    seen: set[tuple[str, int]] = set()
    for _ in range(2):
        names["receive"](headers, body, seen)
    assert [(one.map, one.number) for one in handled] == [("maps/town", 7)] == [*seen]


def test_no_exception_is_made_for_what_no_page_says():
    text = "".join(BLOCKS.values())
    assert [there for there in HERE if there not in text] == []
    assert SILENT | IN_A_FILE.keys() | ENDLESS.keys() <= BLOCKS.keys()
