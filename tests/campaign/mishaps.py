"""What happens in an episode: to its processes, disk, clock and links, and what its operator does."""

from __future__ import annotations

import os
import signal
import socket
import time
from collections.abc import Callable
from contextlib import suppress

from revisit.service import VERSION
from revisit.service.engines.local.sqlite.backup import make_backup
from tests.campaign.episode import Episode
from tests.faults.faulty_disk import Trouble
from tests.faults.proxy import WHOLE, Fault
from tests.support.patience import PATIENCE_S, eventually
from tests.support.processes import is_running
from tests.support.town import SESSION

Mishap = Callable[[Episode], object]

HOUR_S = 3600
PLACES = 12
MOST_SESSIONS = 4


def kill_gateway(it: Episode) -> None:
    """kill -9; its workers notice."""
    orphans = it.service.worker_pids()
    it.service.kill()
    it.fleet.start_again()
    eventually(lambda: not any(is_running(pid) for pid in orphans), "a worker outlived its gateway")


def kill_worker(it: Episode) -> None:
    """kill -9 of one of them, where one runs."""
    pids = it.service.worker_pids()
    with suppress(ProcessLookupError, IndexError):
        os.kill(it.rng.choice(pids), signal.SIGKILL)


def stop_and_start(it: Episode) -> None:
    """SIGTERM: it ends well and in time."""
    status, _ = it.service.terminate()
    if status != 0:
        it.surprises.append(f"a service that was told to end ended with {status}")
    it.fleet.start_again()


def bad_disk(it: Episode) -> None:
    """Writes and syncs fail now and then, find no room, or are slow."""
    how = it.rng.choice(list(Trouble))
    with it.disk.failing(how):
        time.sleep(it.rng.uniform(0.2, 3.0))
    it.until_it_runs()


def step_clock(it: Episode) -> None:
    """The wall clock goes an hour back or ahead, or is right again."""
    it.clock.step(it.rng.choice((-HOUR_S, 0, HOUR_S)))


def dark_links(it: Episode) -> None:
    """Nothing passes for a while; then all does, or the connections are forgotten."""
    links = (it.fleet.http, it.fleet.grpc)
    for link in links:
        link.dark = True
    time.sleep(it.rng.uniform(0.2, 3.0))
    for link in links:
        link.heal(forgotten=it.rng.random() < 0.5)


def bad_links(it: Episode) -> None:
    """For a while connections are cut at a byte by chance, or go silent."""
    links = (it.fleet.http, it.fleet.grpc)
    for link in links:
        link.fault = lambda: Fault(cut_after=it.rng.randrange(1, 4000), half_open=it.rng.random() < 0.2)
    time.sleep(it.rng.uniform(0.2, 3.0))
    for link in links:
        link.fault = lambda: WHOLE


def leave_calls(it: Episode) -> None:
    """Begin calls and hang up: before they are whole, and while they wait."""
    host, port = it.service.url.removeprefix("http://").split(":")
    requests = (
        "GET /v1/maps/town/events?timeout_s=30 HTTP/1.1\r\nHost: localhost\r\n\r\n",
        f"GET /v1/{SESSION}/submaps?page_size=500 HTTP/1.1\r\nHost: localhost\r\n\r\n",
        "GET /v1/maps/town/loopClosures?page_size=500 HTTP/1.1\r\nHost: localhost\r\n\r\n",
        f"POST /v1/{SESSION}/submaps?submap_id=half HTTP/1.1\r\nHost: localhost\r\nContent-Length: 9999\r\n\r\nx",
    )
    for _ in range(it.rng.randrange(5, 60)):
        with suppress(OSError), socket.create_connection((host, int(port)), timeout=PATIENCE_S) as connection:
            connection.sendall(it.rng.choice(requests).encode())
            time.sleep(it.rng.choice((0.0, 0.0, 0.01)))


def post_aside(it: Episode) -> None:
    """A few submaps for a session of the yard, which is opened where it is not there."""
    names = list(it.yard)
    fresh = len(names) < MOST_SESSIONS and it.rng.random() < 0.5
    session_id = it.rng.choice(names) if names and not fresh else it.new_id("session")
    drift = it.rng.choice(({}, {"drift": "WHEEL"})) if fresh or not names else {}
    it.call("POST", "maps/yard/sessions", session_id=session_id, **drift)
    it.post_aside(session_id, [it.rng.randrange(PLACES) for _ in range(it.rng.randrange(1, 6))])


def anchor(it: Episode) -> None:
    """Anchors for a session of the yard, now and then one that is there already, and one of them is deleted."""
    if it.yard:
        session_id = it.rng.choice(list(it.yard))
        it.anchor(session_id, it.rng.randrange(1, 5))
        if it.anchors.get(session_id) and it.rng.random() < 0.3:
            it.remove_anchor(session_id, it.rng.choice(it.anchors[session_id]))


def ask(it: Episode) -> None:
    """Ask what changed in a map, and for a tile as of a moment, and do not wait for long. Submaps of the fake method
    have no surfaces: a worker that looks at them cannot read them.
    """
    version = f"maps/{it.rng.choice(('town', 'yard'))}/versions/{it.rng.randrange(1, 6)}"
    it.call("GET", f"{version}/changes", it.rng.uniform(0.1, 3.0), known="DATA_LOSS")
    answer = it.call("GET", f"{version}/tiles")
    tiles = answer.json().get("map_tiles", []) if answer is not None and answer.status_code == 200 else []
    if tiles:
        moment = it.rng.choice(("", "&as_of_ns=5", "&ever=true"))
        path = f"{it.rng.choice(tiles)['name']}:download?format=mesh{moment}"
        it.call("GET", path, it.rng.uniform(0.1, 3.0), known="DATA_LOSS")


def delete_submap(it: Episode) -> None:
    """Delete one of a session of the yard."""
    if session_id := it.rng.choice([name for name, ids in it.yard.items() if ids] or [""]):
        submap_id = it.yard[session_id].pop(it.rng.randrange(len(it.yard[session_id])))
        it.remove(f"maps/yard/sessions/{session_id}/submaps/{submap_id}", [f"submap/{submap_id}"])


def delete_session(it: Episode) -> None:
    """Delete a session of the yard."""
    if it.yard:
        session_id = it.rng.choice(list(it.yard))
        gone = [f"submap/{one}" for one in it.yard.pop(session_id)]
        gone += [f"anchor/{one}" for one in it.anchors.pop(session_id, [])]
        it.remove(f"maps/yard/sessions/{session_id}", gone)


def look(it: Episode) -> None:
    """Look up submaps of the yard."""
    for session_id, submap_ids in it.yard.items():
        for submap_id in submap_ids[-3:]:
            it.read(f"maps/yard/sessions/{session_id}/submaps/{submap_id}", submap_id)


def optimise(it: Episode) -> None:
    """Optimise a map."""
    it.call("POST", f"maps/{it.rng.choice(('town', 'yard'))}:optimise")


def go_back(it: Episode) -> None:
    """Bring an earlier version of a map back, where there is one."""
    it.call("POST", f"maps/{it.rng.choice(('town', 'yard'))}:revert", version=it.rng.randrange(1, 4))


def merge(it: Episode) -> None:
    """Merge the yard into the town."""
    it.call("POST", "maps/town:merge", source="maps/yard")


def take_back(it: Episode) -> None:
    """Take the last merge back."""
    answer = it.call("GET", "maps/town/merges")
    merges = answer.json().get("merges", []) if answer is not None and answer.status_code == 200 else []
    if merges:
        it.call("POST", f"{merges[-1]['name']}:revert")


def retain(it: Episode) -> None:
    """The yard keeps the best two submaps of a place, or everything again."""
    it.may_go([submap_id for ids in it.yard.values() for submap_id in ids])
    policy = it.rng.choice(({"best_submaps": 2}, {"keep_scans": "NONE"}, {}))
    it.call("POST", "maps/yard:setRetention", policy=policy)


def back_up(it: Episode) -> None:
    """Make a backup while everything goes on."""
    if not it.service.upgraded:
        known, out = it.known_now(), it.folder / it.new_id("backup")
        make_backup(it.home, out, VERSION)
        it.backups.append((out, known))


def upgrade(it: Episode) -> None:
    """The next release takes over, in the middle of everything."""
    if not it.service.upgraded:
        it.service.upgrade(it.next_release())
        stop_and_start(it)


MISHAPS: dict[Mishap, int] = {
    kill_gateway: 4,
    kill_worker: 8,
    stop_and_start: 2,
    bad_disk: 6,
    step_clock: 3,
    dark_links: 3,
    bad_links: 3,
    leave_calls: 4,
    post_aside: 12,
    anchor: 6,
    ask: 6,
    delete_submap: 4,
    delete_session: 2,
    look: 4,
    optimise: 3,
    go_back: 2,
    merge: 2,
    take_back: 2,
    retain: 1,
    back_up: 2,
    upgrade: 1,
}
"""Each with how often it happens among the others."""


def clear(it: Episode) -> None:
    """End every trouble."""
    it.clock.step(0)
    for link in (it.fleet.http, it.fleet.grpc):
        link.fault = lambda: WHOLE
