"""The grid of the map in the ROS 2 bridge: made of the version in force, anew with the next one, without ROS."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="in the extra `dev`: gives the messages' types")

from revisit_bridge.map_grid import MapGrids, MapSurface, ServiceMap
from revisit_bridge.publishing import MessageTypes, grid_message

from revisit import Client
from revisit.core.geometry import se3
from revisit.formats.occupancy_grid import UNKNOWN
from revisit.sdk.errors import ApiError, ErrorDetails
from revisit.sdk.resources import SubmapPose
from revisit.service.features.retention import removal
from tests.support.live_service import live_service
from tests.support.page_town import EACH_BY_ITSELF, fill
from tests.support.patience import eventually
from tests.support.ros_messages import message_classes, ros_store
from tests.support.service_world import TENANT

OWN, OTHER = "maps/yard/sessions/own", "maps/yard/sessions/other"


def at(submap: str, x_m: float, frame: str = "frame-1") -> SubmapPose:
    return SubmapPose(submap=submap, T_map_submap=se3.from_yaw(0.0, (x_m, 0.0, 0.0)), frame=frame, covariance=None)


class Yard:
    """Two submaps of the robot, one of another frame; each is a floor of 1 m with a post in its middle."""

    def __init__(self) -> None:
        self.now, self.asked, self.refused = 0, [], False
        self.placed = [at(f"{OWN}/submaps/a", 0.0), at(f"{OTHER}/submaps/x", 50.0, "frame-2")]

    def version(self) -> int:
        return self.now

    def poses(self, version: int) -> list[SubmapPose]:
        return self.placed

    def points(self, submap: str) -> np.ndarray:
        self.asked.append(submap)
        floor = np.stack(np.meshgrid(np.arange(0.05, 1, 0.1), np.arange(0.05, 1, 0.1), [0.0]), -1).reshape(-1, 3)
        return np.vstack([floor, [(0.55, 0.55, height) for height in (0.5, 1.0, 1.5)]]).astype(np.float32)

    def surface(self, version: int, frame: str, *, ever: bool) -> MapSurface:
        """Of now the post of the first metre is gone."""
        if self.refused:
            raise ApiError(ErrorDetails("DEADLINE_EXCEEDED", "NO_ANSWER", "no worker made the tile"))
        floor = [(x, 0.5, 0.0) for x in np.arange(0.2, 4.0, 0.4)]
        posts = [0.5, 2.5] if ever else [2.5]
        return MapSurface(np.array([*floor, *((x, 0.6, 1.0) for x in posts)]), 0.4)


def followed(grids: MapGrids, version: int):
    """The grid of a version, once it is made."""

    def there() -> bool:
        grids.follow(OWN)
        return grids.made is not None and grids.made.version == version

    eventually(there)
    return grids.made


def test_a_grid_is_made_for_each_version_and_told_once() -> None:
    yard = Yard()
    grids = MapGrids(yard, 0.1)
    grids.follow(OWN)
    assert grids.news() is None
    yard.now = 1
    made = followed(grids, 1)
    assert made.frame == "frame-1" and made.grid.cells.shape == (10, 10)
    assert (made.grid.cells == 0).sum() == 1 and (made.grid.cells == 254).sum() == 99
    assert grids.news() is made and grids.news() is None
    yard.now, yard.placed = 2, [*yard.placed, at(f"{OWN}/submaps/b", 1.0)]
    assert followed(grids, 2).grid.cells.shape == (10, 20)
    assert yard.asked == [f"{OWN}/submaps/a", f"{OWN}/submaps/b"], "a submap is downloaded once"
    grids.close()


def obstacles(grids: MapGrids) -> list[float]:
    """Where obstacles stand, metres along x."""
    grid = followed(grids, 1).grid
    return ((np.nonzero(grid.cells == 0)[1] + 0.5) * grid.resolution_m + grid.origin[0]).round(6).tolist()


def test_an_obstacle_that_a_later_drive_looked_through_leaves_the_grid() -> None:
    yard = Yard()
    yard.now, yard.placed = 1, [at(f"{OWN}/submaps/a", 0.0), at(f"{OTHER}/submaps/x", 2.0)]
    grids = MapGrids(yard, 0.1)
    assert obstacles(grids) == [2.55]
    assert (followed(grids, 1).grid.cells == 254).sum() == 199, "the cell of the post is free"
    assert obstacles(MapGrids(yard, 0.1, ever=True)) == [0.55, 2.55]
    yard.placed.reverse()
    assert obstacles(MapGrids(yard, 0.1)) == [0.55, 2.55], "the newest drive has seen the post"


def test_a_grid_keeps_what_the_service_does_not_judge() -> None:
    yard = Yard()
    yard.now, yard.placed = 1, [at(f"{OWN}/submaps/a", 0.0), at(f"{OTHER}/submaps/x", 2.0)]
    yard.refused = True
    assert obstacles(MapGrids(yard, 0.1)) == [0.55, 2.55]
    yard.refused, yard.placed = False, [at(f"{OWN}/submaps/a", 0.0), at(f"{OWN}/submaps/b", 2.0)]
    assert obstacles(MapGrids(yard, 0.1)) == [0.55, 2.55], "a drive says nothing against its own points"


def test_a_map_too_large_for_its_surface_has_a_grid_all_the_same(monkeypatch) -> None:
    yard = Yard()
    yard.now, yard.placed = 1, [at(f"{OWN}/submaps/a", 0.0), at(f"{OTHER}/submaps/x", 2.0)]
    far = MapSurface(np.array([(0.0, 0.0, 0.0), (4_000.0, 4_000.0, 0.0)]), 0.4)
    monkeypatch.setattr(yard, "surface", lambda *_, **__: far)
    assert obstacles(MapGrids(yard, 0.1)) == [0.55, 2.55]


def test_the_message_has_its_rows_from_the_bottom_and_says_where_it_lies() -> None:
    yard = Yard()
    yard.now, grids = 1, MapGrids(yard, 0.1)
    made = followed(grids, 1)
    types = MessageTypes(**message_classes(ros_store()), ok=b"\x00", warning=b"\x01")
    message = grid_message(types, made, "map", 5)
    assert (message.info.width, message.info.height, message.info.resolution) == (10, 10, 0.1)
    assert (message.info.origin.position.x, message.info.origin.position.y) == (0.0, 0.0)
    assert np.flatnonzero(message.data == 100).tolist() == [55]


def retire(world, submap: str) -> str:
    """Retire a submap, as retention does."""
    _, map_id, _, session_id, _, submap_id = submap.split("/")

    def work(uow):
        record, row = uow.maps.get(TENANT, map_id), uow.submaps.get(TENANT, map_id, session_id, submap_id)
        return removal.retire(uow, record, [row.number])

    assert world.context.transactions.write(work).result().rows == 1
    return submap


def test_the_map_of_a_service_is_followed() -> None:
    with live_service(pipeline=EACH_BY_ITSELF) as service, Client(service.http) as client:
        fill(client)
        source = ServiceMap(client, "maps/town")
        grids = MapGrids(source, 0.5)
        assert source.version() == 0
        client.wait(client.optimise_map("maps/town"))
        made = followed(grids, 1)
        assert made.grid.cells.size > 100
        now, ever = (source.surface(1, made.frame, ever=ever) for ever in (False, True))
        assert now.voxel_m == ever.voxel_m == pytest.approx(0.4)
        assert 0 < len(now.points) <= len(ever.points)
        retired = retire(service.world, source.poses(1)[0].submap)
        assert len(source.points(retired)) == 0
        anew = MapGrids(source, 0.5)
        before, after = ((one.grid.cells != UNKNOWN).sum() for one in (made, followed(anew, 1)))
        assert before > after > 0, "the others are told"
        anew.close()
        grids.close()
