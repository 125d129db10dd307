"""The model of a fleet over several installations: its waiting lines, its directory, and the tables of its page."""

from __future__ import annotations

import numpy as np
import pytest

from lab.installations.affinity import COLD_S, PLACES_KEPT, Claim, Job, Worker, simulated
from lab.installations.directory import SITES, as_they_come, by_directory, by_hash, divided, site_sizes
from lab.installations.parts import bytes_a_day, parts
from lab.installations.queueing import arrivals, served, waits
from lab.installations.tables import affinity_table, fleet_table, parts_table, waits_table
from tests.support.processes import ROOT

PAGE = (ROOT / "docs/explanation/beyond-one-database.md").read_text()


def test_a_line_before_one_server_waits_as_the_formula_says():
    rng = np.random.default_rng(3)
    came = np.cumsum(rng.exponential(1.0, 400_000))
    took_s = served(came, rng.exponential(0.6, len(came)), 1) - came
    # M/M/1: service over what is left of the server.
    assert took_s.mean() == pytest.approx(0.6 / (1 - 0.6), rel=0.03)


def test_a_customer_goes_to_the_server_that_is_free_first():
    assert served(np.array([0.0, 0.0, 1.0, 1.0]), np.array([5.0, 2.0, 1.0, 1.0]), 2).tolist() == [5.0, 2.0, 3.0, 4.0]


def test_robots_send_as_often_as_they_are_said_to():
    came = arrivals(100, 5.0, 1000.0, np.random.default_rng(1))
    assert len(came) == 100 * 200
    assert np.all(np.diff(came) >= 0) and came[-1] == pytest.approx(1000.0, rel=0.05)


def test_workers_that_cannot_keep_up_let_submaps_wait_longer_and_longer():
    enough, too_few = waits(200, 25, 60.0).row()[3], waits(200, 10, 60.0).row()[3]
    assert enough < 2.0 < too_few


def test_every_robot_of_a_fleet_has_one_installation():
    sizes = site_sizes(10_000)
    assert sum(sizes) == 10_000 and len(sizes) == SITES
    for loads in (by_hash(sizes, 12), by_directory(sizes, 12, as_they_come()), by_directory(sizes, 12, range(SITES))):
        assert sum(loads) == 10_000 and len(loads) == 12


def test_a_site_that_is_too_large_is_several_and_others_stay_as_they_are():
    assert divided([1_000, 700, 3], 400) == [350, 350, 334, 333, 333, 3]
    assert divided(site_sizes(10_000), 10_000) == site_sizes(10_000)


def test_a_directory_that_knows_sizes_is_the_most_even():
    sizes = site_sizes(10_000)
    most = [
        max(by_hash(sizes, 10)),
        max(by_directory(sizes, 10, as_they_come())),
        max(by_directory(sizes, 10, range(SITES))),
    ]
    assert most == sorted(most, reverse=True)


def test_the_database_is_the_first_part_that_cannot_be_added_to():
    carried = {part.robots: part.then for part in parts() if part.then == "installation"}
    assert f"{min(carried):,}" in PAGE
    kept, raw = bytes_a_day(10_000)
    assert f"{kept / 1e12:.1f} TB a day" in PAGE and f"{raw / 1e12:.0f} TB" in PAGE


def test_a_worker_reads_a_place_anew_once_it_has_used_as_many_others_as_it_keeps():
    worker = Worker(0)
    assert [worker.cold(Job(0.0, 0, asked)) for asked in ((1, 2), (2, 3), tuple(range(3, 99)), (1, 98))] == [
        2,
        1,
        95,
        1,
    ]
    assert len(worker.places) == PLACES_KEPT


def test_a_worker_prefers_its_last_map_among_some_or_waits_for_the_jobs_of_its_own():
    worker, waiting = Worker(1, last_map=7), [Job(0.0, one, ()) for one in (2, 7, 5)]
    assert [worker.chosen(claim, waiting, 4) for claim in Claim] == [0, 1, 2]
    assert [worker.chosen(claim, waiting[:1], 4) for claim in Claim] == [0, 0, None]


def test_jobs_of_a_map_that_wait_for_its_own_worker_wait_longer_than_the_places_take_that_it_has_read():
    anyone, own = (simulated(claim, 8, 8, 0.5, 60.0).row() for claim in (Claim.ANY, Claim.OWN_ONLY))
    saved_s = COLD_S * (anyone[0] - own[0])
    assert 0.0 < saved_s < own[1] - anyone[1]


TABLES = {"parts": parts_table, "waits": waits_table, "fleet": fleet_table, "affinity": affinity_table}


@pytest.mark.parametrize("table", TABLES.values(), ids=TABLES)
def test_a_table_of_the_page_is_what_the_model_gives(table):
    assert table() in PAGE
