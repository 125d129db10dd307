"""Over a link that is cut at any byte: a stream has no gap and no scan twice, a repeated submap is stored once."""

from __future__ import annotations

import random
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from revisit import Client, Cloud
from revisit.core.config import SubmapConfig
from revisit.core.scan_marks import ScanMarks, way_along
from revisit.formats import KITTI
from tests.faults.history import History, Kind, Operation, Outcome
from tests.faults.proxy import WHOLE, BadLink, Fault, bad_link
from tests.faults.robots import Crew, Poster, Scanner, body, content
from tests.faults.survey import survey
from tests.support.campaigns import Campaign, sizes
from tests.support.figures import publish
from tests.support.live_service import LiveService, live_service
from tests.support.patience import PATIENCE_S, eventually, in_time
from tests.support.service_world import pose, sqlite_world
from tests.support.town import SESSION

CLIENTS = 6
ATTEMPTS = 100
WINDOW_SCANS = 32
TAU_M = 1000.0
MARKS = ScanMarks.of(SubmapConfig(tau=TAU_M))


@pytest.fixture
def service(folder):
    """Both transports over SQLite and files; no worker takes the jobs, what counts here is what is stored."""
    world = sqlite_world(folder / "home", max_queued_jobs=1_000_000)
    with live_service(world) as running:
        running.working.clear()
        with Client(running.http) as client:
            client.create_session(client.create_map("town", tau_m=TAU_M), "monday")
        yield running
    world.context.transactions.close()


def random_cuts(rng: random.Random, most_bytes: int, share: float = 1.0):
    return lambda: Fault(cut_after=rng.randint(0, most_bytes)) if rng.random() < share else WHOLE


@pytest.mark.parametrize("cuts", sizes("STREAM_CUTS", 30, 10_000))
@pytest.mark.timeout(3600)
def test_a_stream_that_is_cut_again_and_again_has_no_gap_and_no_scan_twice(service, folder, cuts):
    history = History()
    scanner = Scanner(SESSION, history)
    with bad_link(service.grpc, random_cuts(random.Random(4), most_bytes=60_000)) as link:
        campaign = Campaign("P4", cuts)
        for _ in campaign:
            # Far enough ahead that every connection meets its cut: 100 scans have 190 kB.
            assert not scanner.stream(link.address, scanner.committed_seq + 100)
        link.fault = lambda: WHOLE
        last = scanner.committed_seq + 5
        assert scanner.stream(link.address, last)
    assert scanner.surprises == []
    assert scanner.most_resent <= WINDOW_SCANS
    found = survey(folder / "home")
    assert found.against(history) == []
    assert found.committed == {"monday": last}
    assert link.cuts > 0.9 * campaign.done
    assert len(found.rows) == last > campaign.done / 10
    again = f"at most {scanner.most_resent} sent again after a cut"
    campaign.publish(f"{link.cuts} cuts: 0 gaps, 0 twice in {last} scans, {again}")


class Repeater:
    """Sends every submap 1 to 5 times at once, now and then one of them with other content; then until all are told."""

    def __init__(self, service: LiveService, links: tuple[BadLink, BadLink], seed: int) -> None:
        self.history = History()
        self.poster = Poster("robot", SESSION, self.history)
        self.sent = 0
        self._places: dict[str, set[int]] = {}
        self._service = service
        self._http, self._grpc = links
        self._rng = random.Random(seed)

    def run(self, campaign: Campaign) -> None:
        with ThreadPoolExecutor(CLIENTS) as pool:
            for batch in iter(lambda: [] if campaign.over else self._batch(campaign.left), []):
                campaign.done += len(list(pool.map(lambda task: self._attempt(*task), batch)))
            list(pool.map(self._settle, self._places))

    def _batch(self, most: int) -> list[tuple[str, int, bool]]:
        """Copies of a dozen submaps, shuffled: (submap_id, place, over gRPC)."""
        tasks = []
        for _ in range(12):
            submap_id, place = f"s{self.sent + len(tasks)}", self._rng.randrange(1000)
            for _ in range(self._rng.randint(1, 5)):
                other = place + 1000 if self._rng.random() < 0.05 else place
                tasks.append((submap_id, other, self._rng.random() < 0.2))
        self._rng.shuffle(tasks)
        for submap_id, place, _ in tasks[:most]:
            self._places.setdefault(submap_id, set()).add(place)
        self.sent += len(tasks[:most])
        return tasks[:most]

    def _attempt(self, submap_id: str, place: int, over_grpc: bool) -> Outcome:
        if over_grpc:
            return self.poster.create(self._grpc.address, submap_id, place)
        return self.poster.post(f"http://{self._http.address}", submap_id, place)

    def _settle(self, submap_id: str) -> None:
        """Over a good link, exactly one of the contents that were sent is acknowledged; any other is refused."""
        outcomes = [self._told(submap_id, place) for place in self._places[submap_id]]
        assert sorted(outcomes) == [Outcome.FAIL] * (len(outcomes) - 1) + [Outcome.OK]

    def _told(self, submap_id: str, place: int) -> Outcome:
        """Posts that were cut off may still hold the places of the tenant: then the service asks to come back."""
        for _ in range(ATTEMPTS):
            outcome = self.poster.post(self._service.http, submap_id, place)
            if outcome is not Outcome.UNKNOWN:
                return outcome
            time.sleep(0.1)
        return Outcome.UNKNOWN


@pytest.mark.parametrize("operations", sizes("REPEATED_REQUESTS", 200, 100_000))
@pytest.mark.timeout(7200)
def test_requests_that_are_repeated_over_a_bad_link_store_each_submap_once(service, folder, operations):
    rng = random.Random(5)
    cuts = random_cuts(rng, most_bytes=6_000, share=0.3)
    with bad_link(service.http.removeprefix("http://"), cuts) as http, bad_link(service.grpc, cuts) as grpc:
        repeater = Repeater(service, (http, grpc), seed=6)
        campaign = Campaign("P3", operations)
        repeater.run(campaign)
        cuts_made = http.cuts + grpc.cuts
        assert cuts_made > campaign.done / 10
    assert repeater.poster.surprises == []
    for bodies in repeater.poster.bodies.values():
        told = [{"submap": body["submap"], "operation": body["operation"]} for body in bodies]
        assert all(body == told[0] for body in told)
    found = survey(folder / "home")
    assert found.against(repeater.history) == []
    assert len(found.rows) == len({operation.key for operation in repeater.history.operations})
    campaign.publish(f"{len(found.rows)} submaps, each stored once; {cuts_made} cuts, 0 answers that differ")


def test_a_client_that_was_cut_off_recovers_when_the_link_does(service, folder):
    """Half a second of delay, then a link that swallows everything, then a good one."""
    history = History()
    scanner = Scanner(SESSION, history)
    with bad_link(service.grpc, lambda: Fault(delay_s=0.25)) as link:
        assert scanner.stream(link.address, 3)
        link.fault = lambda: Fault(cut_after=3_000, half_open=True)
        assert not scanner.stream(link.address, 30)
        link.fault = lambda: Fault(bytes_per_s=200_000.0)
        assert scanner.stream(link.address, 30)
    assert scanner.surprises == []
    found = survey(folder / "home")
    assert (found.against(history), found.committed) == ([], {"monday": 30})


RECOVERED_WITHIN_S = 5.0
POSTERS = 2
STEP_M = 0.5


class Driver:
    """A robot that sends a scan now and then through its spool, whatever becomes of the link."""

    def __init__(self, client: Client, session: str, spool: Path, history: History) -> None:
        self.sent = 0
        self.session = session
        self._history = history
        self._open: list[Operation] = []
        self._opened = client.spooled_stream(session, spool, send="all")
        self.stream = self._opened.__enter__()

    def send(self) -> None:
        self.sent += 1
        self._open.append(self._history.invoke("driver", Kind.PUT, f"scan/{self.sent}", content(self.sent)))
        self.stream.send(Cloud(body(self.sent), KITTI), pose(STEP_M * self.sent), self.sent)
        time.sleep(0.05)

    def close(self) -> None:
        """Once all is acknowledged."""
        self.stream.flush(timeout_s=PATIENCE_S)
        for operation in self._open:
            self._history.settle(operation, Outcome.OK)
        self._opened.__exit__(None, None, None)


class Repeating:
    """A robot that posts one submap after another, each until it is acknowledged."""

    def __init__(self, number: int, address: str, history: History) -> None:
        self.poster = Poster(f"poster{number}", SESSION, history)
        self.posted = 0
        self._number = number
        self._address = address

    def post(self) -> None:
        # Every submap has a place of its own, by which its content is known.
        place = 1 + self._number + POSTERS * self.posted
        if self.poster.post(f"http://{self._address}", f"p{place}", place) is Outcome.OK:
            self.posted += 1


def recoveries_s(links: list[BadLink], driver: Driver, posters: list[Repeating], dark_s: float, forgotten: bool):
    """Let the links be dark for so long; how long after that the stream and each poster got on, seconds."""
    eventually(lambda: driver.stream.committed_seq >= 5 and all(p.posted >= 2 for p in posters))
    for link in links:
        link.dark = True
    time.sleep(dark_s)
    committed, posted = driver.stream.committed_seq, [poster.posted for poster in posters]
    eventually(lambda: driver.stream.state.pending > 3, "nothing waits in the spool")
    for link in links:
        link.heal(forgotten=forgotten)
    began_s = time.monotonic()
    eventually(lambda: driver.stream.committed_seq > committed)
    stream_s = time.monotonic() - began_s
    eventually(lambda: all(p.posted > before for p, before in zip(posters, posted, strict=True)))
    return stream_s, time.monotonic() - began_s


@pytest.mark.parametrize("forgotten", [False, True])
@pytest.mark.parametrize("dark_s", sizes("DARK_S", 1, 30))
@pytest.mark.timeout(300)
def test_a_link_that_was_dark_takes_nothing_and_is_used_again_at_once(service, folder, dark_s, forgotten):
    """Dark in both directions; then what was held back arrives, or the connections of before are forgotten."""
    history, crew = History(), Crew()
    with (
        bad_link(service.grpc) as grpc,
        bad_link(service.http.removeprefix("http://")) as http,
        Client.grpc(grpc.address) as client,
    ):
        driver = Driver(client, client.create_session("maps/town", "driven").name, folder / "spool", history)
        posters = [Repeating(number, http.address, history) for number in range(POSTERS)]
        for work in (driver.send, *(poster.post for poster in posters)):
            crew.start(work)
        stream_s, posts_s = recoveries_s([grpc, http], driver, posters, dark_s, forgotten)
        crew.end()
        driver.close()
        stored = client.get_session(driver.session)
    way = way_along((pose(STEP_M * number) for number in range(1, driver.sent + 1)), MARKS)
    assert (stored.committed_seq, stored.travelled_m) == (driver.sent, pytest.approx(way.travelled_m))
    assert driver.stream.error is None and [poster.poster.surprises for poster in posters] == [[]] * POSTERS
    assert survey(folder / "home").against(history) == []
    assert in_time(max(stream_s, posts_s), RECOVERED_WITHIN_S)
    how = "connections forgotten" if forgotten else "connections kept"
    recovered = f"the stream got on {stream_s:.2f} s, posts {posts_s:.2f} s after {dark_s} s of darkness, {how}"
    publish("dark link", promise="P25", figure=f"0 of {driver.sent} scans lost or twice; {recovered}")
