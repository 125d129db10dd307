"""One map with one session on a service that runs in processes: what tests post there, look up, and wait for."""

from __future__ import annotations

import socket
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx

from revisit.formats import KITTI, encode_kitti
from tests.support.patience import PATIENCE_S, eventually
from tests.support.processes import ForkedService, ServiceProcess
from tests.support.service_world import cloud_points

SESSION = "maps/town/sessions/monday"
EMPTY: Mapping[str, Any] = {}
NEVER_TOO_NEAR = {"leave_distance_m": 0}
"""Of a map: a drive need not leave a place."""


def half_a_post(service: ServiceProcess) -> socket.socket:
    """A connection that has sent the head of a post and never sends the rest."""
    host, port = service.url.removeprefix("http://").split(":")
    connection = socket.create_connection((host, int(port)))
    connection.sendall(
        b"POST /v1/maps HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: 999\r\n\r\n{"
    )
    return connection


class Town:
    """The map `town` with the session `monday`, over REST; each call is made once, on a connection that is kept."""

    def __init__(self, service: ServiceProcess, **of_map: Any) -> None:
        """Makes the map, with its own rules, and the session."""
        self.service = service
        self._client = httpx.Client(base_url=service.url, timeout=PATIENCE_S, trust_env=False)
        assert self.http.post("/v1/maps", json={"map_id": "town", **of_map}).status_code == 201
        assert self.http.post("/v1/maps/town/sessions", json={"session_id": "monday"}).status_code == 201

    @property
    def http(self) -> httpx.Client:
        """A client of the service, which may have started again on another port."""
        if self._client.base_url != httpx.URL(self.service.url):
            self._client.close()
            self._client = httpx.Client(base_url=self.service.url, timeout=PATIENCE_S, trust_env=False)
        return self._client

    def post(self, submap_id: str, place: int, points: int = 300) -> httpx.Response:
        """Post the submap of a place."""
        asked = {"submap_id": submap_id, "stamp_ns": place, "T_odom_submap": f"{place},0,0,0,0,0,1"}
        return self._send("submaps", place, points, asked)

    def posted(self, submap_id: str, place: int, points: int = 300) -> str:
        """Post one that is taken; the name of its operation."""
        answer = self.post(submap_id, place, points)
        assert answer.status_code == 202, answer.text
        return str(answer.json()["operation"]["name"])

    def append(self, seq: int) -> int:
        """Send a scan; the last one that is stored."""
        return int(self.send_scan(seq).json()["committed_seq"])

    def send_scan(self, seq: int) -> httpx.Response:
        """Send a scan, one metre behind the last."""
        asked = {"seq": seq, "stamp_ns": seq, "T_odom_sensor": f"{seq - 1},0,0,0,0,0,1"}
        return self._send("scans", seq, 300, asked)

    def states(self) -> dict[str, str]:
        """The state of every submap, in their order."""
        listed = self.http.get(f"/v1/{SESSION}/submaps", params={"page_size": 500}).json()["submaps"]
        return {submap["name"].rpartition("/")[2]: submap["state"] for submap in listed}

    def worked_off(self) -> dict[str, str]:
        """The states once no submap waits any more."""
        eventually(lambda: "QUEUED" not in self.states().values(), "jobs are left")
        return self.states()

    def operation(self, name: str, wait_s: float = 0.0) -> dict[str, Any]:
        """An operation as it is, or as it is once it has ended or `wait_s` are over."""
        return dict(self.http.get(f"/v1/{name}:wait", params={"timeout_s": wait_s}).json())

    def ended(self, name: str) -> dict[str, Any]:
        """An operation that ends."""
        eventually(lambda: self.operation(name, wait_s=5.0)["state"] in ("DONE", "FAILED"), f"{name} goes on")
        return self.operation(name)

    def _send(self, kind: str, place: int, points: int, asked: dict[str, Any]) -> httpx.Response:
        body = encode_kitti(cloud_points(place, points))
        headers = {"Content-Type": KITTI}
        return self.http.post(f"/v1/{SESSION}/{kind}", params=asked, content=body, headers=headers)


@contextmanager
def running_town(
    home: Path, kind: type[ServiceProcess] = ForkedService, *, of_map: Mapping[str, Any] = EMPTY, **settings: Any
) -> Iterator[Town]:
    """A service of its own until the block ends; `of_map`: the map's own rules."""
    service = kind(home, **settings)
    try:
        yield Town(service, **of_map)
    finally:
        service.close()
