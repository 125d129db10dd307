"""A search process: holds the maps that fall to it, and shows which they are."""

from __future__ import annotations

import secrets
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import structlog

from revisit.service.domain.errors import Unavailable
from revisit.service.domain.placement import owners
from revisit.service.domain.processes import LivingProcess, ProcessRole
from revisit.service.domain.records import MapRecord
from revisit.service.features.index.caught_up_index import CaughtUpIndex
from revisit.service.features.index.keeping import IndexHealth, IndexKeeper
from revisit.service.ports.disk import UnlimitedDisk
from revisit.service.ports.index import VectorIndex
from revisit.service.ports.storage import Storage
from revisit.service.ports.transactions import Transactions
from revisit.service.search.client import search_processes
from revisit.service.search.load import MapLoad
from revisit.service.search.server import PlaceSearchServer

SHOWN_EVERY_S = 1.0
"""How often a process shows itself."""

TENDED_EVERY_S = 2.0
"""How often it looks which maps there are, and which fall to it."""

log = structlog.get_logger(__name__)


AUDITED_EVERY_S = 1.0
"""How often a window of a held map is compared with the database."""

GRACE_S = 5.0
"""Time for running answers to end."""

FAILED = 70
"""Exit status where a round failed (EX_SOFTWARE)."""


@dataclass(frozen=True)
class HeldIndex:
    """The index of a search process, and what brings it up to date."""

    storage: Storage
    index: VectorIndex
    caught_up: CaughtUpIndex

    @property
    def transactions(self) -> Transactions:
        """Those of the store."""
        return self.storage.transactions


class HeldMaps:
    """The maps that a search process holds: those that fall to it, loaded, and no others."""

    def __init__(self, held: HeldIndex, process_id: str, address: str, load: MapLoad) -> None:
        """Others ask it under `address`."""
        self._held = held
        self._load = load
        self._me = LivingProcess(process_id, ProcessRole.SEARCH, address)
        self._maps: dict[int, MapRecord] = {}
        self._mine: frozenset[int] = frozenset()
        self._shown_at_s = time.monotonic()

    def show(self) -> None:
        """Show itself: ready once the maps are loaded that fell to it at first."""
        now_s = time.monotonic()
        busy = self._load.busy(max(now_s - self._shown_at_s, 1e-3))
        self._shown_at_s = now_s
        me = replace(self._me, busy=busy)
        self._held.transactions.write(lambda uow: uow.processes.announce(me)).result()

    def leave(self) -> None:
        """Nobody asks it any more."""
        self._held.transactions.write(lambda uow: uow.processes.forget(self._me.process_id)).result()

    def tend(self) -> None:
        """Load the maps that fall to it, and let others go."""
        self._read_maps()
        alive = self._held.transactions.read_here(search_processes)
        mine = {number for number in self._maps if self._holds(number, alive)}
        for number in sorted(mine):
            self._held.caught_up.catch_up(self._maps[number].tenant, number)
        for number in self._maps.keys() - mine:
            if self._held.index.size(number):
                self._held.index.drop(number)  # who still asks for it loads it again
        self._mine = frozenset(mine)
        if not self._me.ready:
            self._me = replace(self._me, ready=True)
            log.info("search_ready", maps=len(mine), address=self._me.address)
            self.show()

    def holds(self, map_number: int) -> bool:
        """Whether the map is loaded here."""
        return map_number in self._mine

    def _read_maps(self) -> None:
        records = self._held.transactions.read_here(lambda uow: uow.maps.of_all_tenants())
        for number in self._maps.keys() - {record.number for record in records}:
            self._held.index.drop(number)
        self._maps = {record.number: record for record in records}

    def _holds(self, number: int, alive: list[LivingProcess]) -> bool:
        """Whether a map falls to this process, or did before those came that are still loading."""
        settled = [one for one in alive if one.ready]
        return any(one.process_id == self._me.process_id for one in (*owners(number, alive), *owners(number, settled)))


@contextmanager
def put_off() -> Iterator[None]:
    """A database that does not answer is asked again with the next round; the maps that are held stay in memory."""
    try:
        yield
    except Unavailable as error:
        log.warning("search_round_put_off", reason=error.reason)


class Rounds:
    """Repeats a piece of work in a thread of its own until told to stop.

    Where the database is away, a round is put off. Where one fails otherwise, all end, as others ask this process; the
    chores of a gateway (`Upkeep`) go on.
    """

    def __init__(self, work: Callable[[], object], every_s: float, failed: Callable[[], None]) -> None:
        """`failed` is called where the work raises anything but Unavailable."""
        self._work = work
        self._every_s = every_s
        self._failed = failed
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End after the piece that runs."""
        self._stopping.set()
        self._thread.join()

    def _run(self) -> None:
        try:
            while not self._stopping.is_set():
                with put_off():
                    self._work()
                self._stopping.wait(self._every_s)
        except Exception:
            log.exception("search_round_failed")
            self._failed()
            raise


class SearchService:
    """One run of a search process."""

    def __init__(self, held: HeldIndex, secret: bytes, host: str, port: int) -> None:
        """Listens on `host:port`; port 0 takes a free one."""
        self._held = held
        self._load = MapLoad()
        self._server = PlaceSearchServer(held.caught_up, secret, self._load)
        self._listen_on = host, port
        self._status = 0

    def run(self, stopping: threading.Event) -> int:
        """Answer until told to stop; the exit status."""
        host, wanted = self._listen_on
        port = self._server.start(f"{host}:{wanted}")
        address = f"{_reachable(host)}:{port}"
        log.info("search_listening", address=address)
        maps = HeldMaps(self._held, f"search-{secrets.token_hex(4)}", address, self._load)

        def failed() -> None:
            self._status = FAILED
            stopping.set()

        held = self._held
        keeper = IndexKeeper(held.storage, held.index, held.caught_up, IndexHealth(), UnlimitedDisk(), maps.holds)
        rounds = [
            Rounds(maps.show, SHOWN_EVERY_S, failed),
            Rounds(maps.tend, TENDED_EVERY_S, failed),
            Rounds(keeper.audit_here, AUDITED_EVERY_S, failed),
        ]
        stopping.wait()
        for one in rounds:
            one.stop()
        with put_off():
            maps.leave()
        self._server.stop(GRACE_S)
        return self._status


def _reachable(host: str) -> str:
    """The name under which others reach this process; on every address it is that of this machine's name."""
    return socket.gethostbyname(socket.gethostname()) if host in ("0.0.0.0", "::") else host
