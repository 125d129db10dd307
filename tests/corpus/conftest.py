"""One service over SQLite and files for the whole corpus, and the doors through which a case is sent."""

from __future__ import annotations

import asyncio
import itertools
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import grpc
import httpx
import pytest

from revisit.service.features.ingest.posting import PostSubmap
from tests.support.live_service import LiveService, live_service
from tests.support.patience import PATIENCE_S
from tests.support.service_world import SESSION, TENANT, SubmapKey, cloud, open_session, pose, sqlite_world

MAP = f"maps/{SESSION.map_id}"


@dataclass
class Service:
    """The running service with clients of both transports; its worker takes no jobs, so that counts stand still."""

    live: LiveService
    http: httpx.Client
    channel: grpc.Channel
    home: Path
    numbers: Any = field(default_factory=lambda: itertools.count(1))

    def new_session(self) -> str:
        """The name of a session of its own."""
        session_id = f"s{next(self.numbers)}"
        answer = self.http.post(f"/v1/{MAP}/sessions", json={"session_id": session_id})
        assert answer.status_code == 201, answer.text
        return f"{MAP}/sessions/{session_id}"

    def stored(self) -> tuple[tuple[int, ...], int]:
        """Rows and blobs."""
        blobs = sum(1 for path in (self.home / "blobs").rglob("*") if path.is_file())
        return self.live.stored(), blobs

    def places(self) -> dict[str, str]:
        """What {names} in expected.toml stand for."""
        session = self.new_session()
        return {
            "map": MAP,
            "map_path": f"/v1/{MAP}",
            "empty": "maps/empty",
            "empty_path": "/v1/maps/empty",
            "session": session,
            "submaps": f"/v1/{session}/submaps",
            "described": f"/v1/{SESSION.name}/submaps/described",
        }


@pytest.fixture(scope="session")
def corpus_service(tmp_path_factory):
    home = tmp_path_factory.mktemp("corpus")
    world = sqlite_world(home, max_queued_jobs=1_000_000)
    asyncio.run(_seed(world))
    with (
        live_service(world) as live,
        httpx.Client(base_url=live.http, trust_env=False, timeout=PATIENCE_S) as http,
        grpc.insecure_channel(live.grpc, options=[("grpc.max_send_message_length", -1)]) as channel,
    ):
        live.working.clear()
        assert http.post("/v1/maps", json={"map_id": "empty"}).status_code == 201
        yield Service(live, http, channel, home)
    world.context.transactions.close()


async def _seed(world):
    """One described submap, so that searches have something to find."""
    await open_session(world)
    key = SubmapKey(SESSION.map_id, SESSION.session_id, "described")
    await world.use_cases.posting.post(TENANT, PostSubmap(key, pose(), 1, cloud(1)))
    assert world.work_off() == 1
