"""While one in 20 syncs and one in 20 writes fail, in SQLite's files too, every answer means what it says (P2).

A 4xx was not stored. Anything else but a success is open: repeated with the same id once the disk is sound, it turns
out to be stored, or not, and the answer agrees with what could be read before.
"""

from __future__ import annotations

from collections import Counter
from contextlib import closing

import httpx
import pytest

from tests.faults.faulty_disk import FaultyDisk, OnFaultyDisk
from tests.faults.fleet import Fleet, Robot, fleet_of
from tests.faults.history import Outcome
from tests.faults.preloaded import COMPILER
from tests.faults.robots import EXPECTED, TOO_FEW_POINTS
from tests.support.campaigns import Campaign, sizes
from tests.support.patience import PATIENCE_S
from tests.support.town import SESSION

pytestmark = pytest.mark.skipif(COMPILER is None, reason="no C compiler here: a disk cannot be made to fail")

STORAGE_FAILED = 74
QUICK = 1
ATTEMPTS = 3

REFUSED_ON_A_BAD_DISK = EXPECTED | {422, 507}
NACKED_ON_A_BAD_DISK = frozenset({"STORAGE_FULL", "STORAGE_UNCERTAIN"})


def post_and_be_refused(robot: Robot) -> None:
    """Post the next submap, and something under its id that must be refused."""
    submap_id, place = robot.post_next(ATTEMPTS)
    if submap_id not in robot.open:
        robot.attempt(submap_id, place + 1)
    robot.attempt(f"{submap_id}-thin", place, TOO_FEW_POINTS)


def settle(fleet: Fleet, robot: Robot) -> Counter[str]:
    """Repeat what is open, on a sound disk, and hold the answer against what is there before; what it was."""
    found: Counter[str] = Counter()
    not_refused = {operation.key for operation in fleet.history.operations if operation.had_effect}
    with httpx.Client(base_url=fleet.service.url, timeout=PATIENCE_S) as client:
        for submap_id, place in robot.open.items():
            stored = client.get(f"/v1/{SESSION}/submaps/{submap_id}").status_code == 200
            assert not stored or f"submap/{submap_id}" in not_refused, "stored although each attempt was refused"
            assert robot.poster.post(fleet.service.url, submap_id, place) is Outcome.OK
            assert robot.poster.replays[submap_id] is stored
            found["stored" if stored else "not stored"] += 1
    robot.open.clear()
    return found


def until_it_ends(fleet: Fleet, disk: FaultyDisk) -> Counter[str]:
    """Use the failing disk until the service ends; what was open is settled on a sound one: what it was."""
    with disk.failing():
        fleet.set_out(post_and_be_refused)
        assert fleet.service.wait_until_it_ends() == STORAGE_FAILED
        fleet.crew.end()
    fleet.start_again()
    return sum((settle(fleet, robot) for robot in fleet.robots), Counter())


@pytest.mark.parametrize("ends", sizes("DISK_FAULTS", QUICK, 200))
@pytest.mark.timeout(7200)
def test_on_a_disk_that_fails_now_and_then_every_answer_means_what_it_says(folder, ends):
    (folder / "library").mkdir()
    home, disk = folder / "home", FaultyDisk(folder / "home", folder / "library", seed=20)
    # A worker that meets a failure ends too: its jobs must not run out of attempts, nor the queue out of room.
    patience = {"lease_s": 2, "max_attempts": 1000, "max_queued_jobs": 10**6}
    settled, campaign = Counter(), Campaign("P2", ends)
    with (
        closing(OnFaultyDisk(home, disk, workers=0 if ends == QUICK else 1, **patience)) as service,
        fleet_of(service, REFUSED_ON_A_BAD_DISK, NACKED_ON_A_BAD_DISK) as fleet,
    ):
        for _ in campaign:
            settled += until_it_ends(fleet, disk)
        while not (settled["not stored"] and disk.failures()["write"]):  # what chance has left out
            settled += until_it_ends(fleet, disk)
        if ends != QUICK:
            fleet.work_off()
        fleet.require_kept(home)
    failures = disk.failures()
    assert failures["sync"] >= campaign.done
    refused = {operation.key for operation in fleet.history.operations if operation.outcome is Outcome.FAIL}
    campaign.publish(
        f"{failures['sync']} syncs and {failures['write']} writes failed: 0 of {fleet.acknowledged()} acknowledged "
        f"lost, 0 twice; {len(refused)} ids refused, none stored by that; {settled.total()} left open, of which "
        f"{settled['stored']} were stored, as their repetition said"
    )
