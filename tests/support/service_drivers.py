"""The same calls to the use cases themselves and over HTTP: each says in a word how it ended."""

from __future__ import annotations

import asyncio
import tempfile
import time
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import numpy as np

from revisit.core.errors import RevisitError
from revisit.formats import NPY, encode_npy
from revisit.service.domain.identity import SessionKey, SubmapKey
from revisit.service.features.catalogue.maps import CreateMap
from revisit.service.features.catalogue.sessions import CreateSession
from revisit.service.features.index.answers import SearchCriteria
from revisit.service.features.resources.paging import PageRequest
from revisit.service.use_cases import UseCases
from tests.support.live_service import live_service
from tests.support.memory.vector_index import MemoryVectorIndex
from tests.support.patience import PATIENCE_S
from tests.support.service_world import TENANT, World, cloud_points, memory_world, scan, sqlite_world, submap

STEP_M = 0.1
DESCRIPTOR = [1.0, *[0.0] * 63]


class UseCaseDriver:
    """Calls the use cases over the stores in memory, or over SQLite and files."""

    def __init__(self, stores: str) -> None:
        self._home = tempfile.TemporaryDirectory()
        self._runner = asyncio.Runner()
        self._world = memory_world() if stores == "memory" else self._opened()

    def _opened(self) -> World:
        return sqlite_world(Path(self._home.name))

    def _outcome(self, call: Any) -> str:
        try:
            done = self._runner.run(call)
        except RevisitError as error:
            return error.code.value
        return "REPLAY" if getattr(done, "replay", False) else "OK"

    def create_map(self, map_id: str) -> str:
        """OK or REPLAY."""
        return self._outcome(self._world.use_cases.maps.create(TENANT, CreateMap(map_id)))

    def delete_map(self, map_id: str) -> str:
        """OK or NOT_FOUND."""
        return self._outcome(self._world.use_cases.maps.delete(TENANT, map_id))

    def create_session(self, session: SessionKey) -> str:
        """OK, REPLAY or NOT_FOUND."""
        command = CreateSession(session.map_id, session.session_id)
        return self._outcome(self._world.use_cases.sessions.create(TENANT, command))

    def finish_session(self, session: SessionKey) -> str:
        """OK or NOT_FOUND."""
        return self._outcome(self._world.use_cases.sessions.finish(TENANT, session))

    def delete_session(self, session: SessionKey) -> str:
        """OK or NOT_FOUND."""
        return self._outcome(self._world.use_cases.sessions.delete(TENANT, session))

    def post_submap(self, session: SessionKey, submap_id: str, place: int) -> str:
        """OK, REPLAY, ALREADY_EXISTS, SESSION_FINISHED or NOT_FOUND."""
        return self._outcome(self._world.use_cases.posting.post(TENANT, submap(submap_id, place, session)))

    def append_scan(self, session: SessionKey, seq: int) -> str:
        """OK, REPLAY, SEQ_GAP, SESSION_FINISHED or NOT_FOUND."""
        return self._outcome(self._world.use_cases.scans.append(TENANT, scan(seq, seq * STEP_M, session)))

    def delete_submap(self, key: SubmapKey) -> str:
        """OK or NOT_FOUND."""
        return self._outcome(self._world.use_cases.submaps.delete(TENANT, key))

    def maps(self) -> set[str]:
        """The ids of all maps."""
        return {view.map_id for view in self._page(self._world.use_cases.maps.list, TENANT)}

    def sessions(self, map_id: str) -> dict[str, tuple[int, bool]]:
        """committed_seq and whether it is finished, of each session of a map."""
        views = self._page(self._world.use_cases.sessions.list, TENANT, map_id)
        return {view.key.session_id: (view.committed_seq, view.state == "FINISHED") for view in views}

    def submaps(self, session: SessionKey) -> dict[str, str]:
        """The state of each submap of a session."""
        views = self._page(self._world.use_cases.submaps.list, TENANT, session)
        return {view.key.submap_id: view.state for view in views}

    def searched(self, map_id: str) -> int:
        """How many submaps of the map a search went through."""
        vector = np.array(DESCRIPTOR, np.float32)
        call = self._world.use_cases.searches.by_descriptor(TENANT, map_id, vector, "fake-1", SearchCriteria())
        return int(self._runner.run(call).searched)

    def work(self) -> None:
        """Let a worker describe all that waits."""
        self._world.work_off()

    def restart(self) -> None:
        """Forget all but what the stores hold."""
        if isinstance(self._world.context.blobs, type(memory_world().context.blobs)):
            context = replace(self._world.context, index=MemoryVectorIndex())
            self._world = World(context, UseCases.over(context, "test"), self._world.clock)
        else:
            self._world.context.transactions.close()
            self._world = self._opened()

    def close(self) -> None:
        """Let go of everything."""
        self._world.context.transactions.close()
        self._runner.close()
        self._home.cleanup()

    def _page(self, listing: Any, *arguments: Any) -> tuple[Any, ...]:
        return self._runner.run(listing(*arguments, PageRequest(500))).items


class RestDriver:
    """Calls a service over HTTP that runs over SQLite and files."""

    def __init__(self) -> None:
        self._home = tempfile.TemporaryDirectory()
        self._open()

    def _open(self) -> None:
        self._world = sqlite_world(Path(self._home.name))
        self._running = ExitStack()
        self._live = self._running.enter_context(live_service(self._world))
        self._live.working.clear()
        http = httpx.Client(base_url=f"{self._live.http}/v1", trust_env=False, timeout=PATIENCE_S)
        self._http = self._running.enter_context(http)

    def _outcome(self, answer: httpx.Response) -> str:
        if answer.is_error:
            return str(answer.json()["reason"])
        return "REPLAY" if "idempotent-replay" in answer.headers else "OK"

    def create_map(self, map_id: str) -> str:
        """See `UseCaseDriver`."""
        return self._outcome(self._http.post("/maps", json={"map_id": map_id}))

    def delete_map(self, map_id: str) -> str:
        """See `UseCaseDriver`."""
        return self._outcome(self._http.delete(f"/maps/{map_id}"))

    def create_session(self, session: SessionKey) -> str:
        """See `UseCaseDriver`."""
        path = f"/maps/{session.map_id}/sessions"
        return self._outcome(self._http.post(path, json={"session_id": session.session_id}))

    def finish_session(self, session: SessionKey) -> str:
        """See `UseCaseDriver`."""
        return self._outcome(self._http.post(f"/{session.name}:finish"))

    def delete_session(self, session: SessionKey) -> str:
        """See `UseCaseDriver`."""
        return self._outcome(self._http.delete(f"/{session.name}"))

    def post_submap(self, session: SessionKey, submap_id: str, place: int) -> str:
        """See `UseCaseDriver`."""
        query = {"submap_id": submap_id, "stamp_ns": 1000 + place, "T_odom_submap": f"{place},0,0,0,0,0,1"}
        return self._cloud(f"/{session.name}/submaps", place, query)

    def append_scan(self, session: SessionKey, seq: int) -> str:
        """See `UseCaseDriver`."""
        query = {"seq": seq, "stamp_ns": seq * 100, "T_odom_sensor": f"{seq * STEP_M},0,0,0,0,0,1"}
        return self._cloud(f"/{session.name}/scans", seq, query)

    def delete_submap(self, key: SubmapKey) -> str:
        """See `UseCaseDriver`."""
        return self._outcome(self._http.delete(f"/{key.name}"))

    def maps(self) -> set[str]:
        """See `UseCaseDriver`."""
        return {one["name"].rpartition("/")[2] for one in self._list("/maps", "maps")}

    def sessions(self, map_id: str) -> dict[str, tuple[int, bool]]:
        """See `UseCaseDriver`."""
        listed = self._list(f"/maps/{map_id}/sessions", "sessions")
        return {s["name"].rpartition("/")[2]: (int(s["committed_seq"]), s["state"] == "FINISHED") for s in listed}

    def submaps(self, session: SessionKey) -> dict[str, str]:
        """See `UseCaseDriver`."""
        listed = self._list(f"/{session.name}/submaps", "submaps")
        return {one["name"].rpartition("/")[2]: one["state"] for one in listed}

    def searched(self, map_id: str) -> int:
        """See `UseCaseDriver`."""
        body = {"descriptor": DESCRIPTOR, "model_version": "fake-1"}
        return int(self._http.post(f"/maps/{map_id}/submaps:search", json=body).json()["searched"])

    def work(self) -> None:
        """Let the worker work until it has nothing left to do."""
        self._live.working.set()
        deadline = time.monotonic() + 60
        while True:
            status = self._http.get("/status").json()
            if status["queued_jobs"] == status["running_jobs"] == 0:
                break
            assert time.monotonic() < deadline, "the worker did not come to an end"
            time.sleep(0.01)
        self._live.working.clear()

    def restart(self) -> None:
        """See `UseCaseDriver`."""
        self._end()
        self._open()

    def close(self) -> None:
        """See `UseCaseDriver`."""
        self._end()
        self._home.cleanup()

    def _end(self) -> None:
        self._running.close()
        self._world.context.transactions.close()

    def _cloud(self, path: str, place: int, query: dict[str, Any]) -> str:
        headers = {"content-type": NPY}
        return self._outcome(
            self._http.post(path, params=query, content=encode_npy(cloud_points(place)), headers=headers)
        )

    def _list(self, path: str, what: str) -> list[dict[str, Any]]:
        return list(self._http.get(path, params={"page_size": 500}).json()[what])
