"""Over a link that is cut at any byte: a stream has no gap and no scan twice, a repeated submap is stored once."""

from __future__ import annotations

import random
from concurrent.futures import ThreadPoolExecutor

import pytest

from revisit import Client
from tests.faults.history import History, Outcome
from tests.faults.proxy import WHOLE, BadLink, Fault, bad_link
from tests.faults.robots import Poster, Scanner
from tests.faults.survey import survey
from tests.support.campaigns import Campaign, sizes
from tests.support.live_service import LiveService, live_service
from tests.support.service_world import sqlite_world

SESSION = "maps/town/sessions/monday"
CLIENTS = 6
WINDOW_SCANS = 32


@pytest.fixture
def service(folder):
    """Both transports over SQLite and files; no worker takes the jobs, what counts here is what is stored."""
    world = sqlite_world(folder / "home", max_queued_jobs=1_000_000)
    with live_service(world) as running:
        running.working.clear()
        with Client(running.http) as client:
            client.create_session(client.create_map("town", tau_m=1000.0), "monday")
        yield running
    world.context.transactions.close()


def random_cuts(rng: random.Random, most_bytes: int, share: float = 1.0):
    return lambda: Fault(cut_after=rng.randint(0, most_bytes)) if rng.random() < share else WHOLE


@pytest.mark.parametrize("cuts", sizes("STREAM_CUTS", 50, 10_000))
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
        outcomes = [self.poster.post(self._service.http, submap_id, place) for place in self._places[submap_id]]
        assert sorted(outcomes) == [Outcome.FAIL] * (len(outcomes) - 1) + [Outcome.OK]


@pytest.mark.parametrize("operations", sizes("REPEATED_REQUESTS", 500, 100_000))
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
