"""The wall clock may jump, stand still or run backwards: leases, order and what is stored do not depend on it."""

from __future__ import annotations

import ast
import asyncio
import itertools
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from tests.faults.drive import ANNEX, POSTED, SCANS, STATED, STREAMED, drive
from tests.faults.history import History
from tests.faults.survey import survey
from tests.support.service_world import TENANT, memory_world, open_session, sqlite_world, submap
from tests.support.stepped_clock import SteppedClock

ROOT = Path(__file__).resolve().parents[2]
HOUR_NS = 3_600 * 10**9
YEAR_NS = 365 * 24 * HOUR_NS
NOW_NS = 1_700_000_000 * 10**9
JUMPS = {
    "an hour on and back": (0, HOUR_NS, 0, -HOUR_NS),
    "three years on": (0, 3 * YEAR_NS),
    "three years back": (0, -3 * YEAR_NS),
    "frozen": (0,),
}
READS_THE_WALL_CLOCK = {
    "service/engines/local/clock.py": "labels: when something was created or finished",
    "service/engines/local/sqlite/backup.py": "a label of the backup",
    "service/engines/s3/blobs.py": "the age of objects without a row; servers refuse a clock that is off by 15 minutes",
    "service/engines/local/files/blobs.py": "the age of files without a row; a file with a row is kept at any age",
}


@dataclass
class JumpingClock(SteppedClock):
    """Every reading of the wall clock is off by the next of `jumps_ns`; the monotonic clock is right."""

    jumps_ns: tuple[int, ...] = (0,)
    _readings: itertools.count = field(default_factory=itertools.count)

    def wall_ns(self) -> int:
        """See `Clock`."""
        return NOW_NS + self.jumps_ns[next(self._readings) % len(self.jumps_ns)]


@pytest.mark.parametrize("jumps_ns", JUMPS.values(), ids=JUMPS)
def test_a_drive_under_a_jumping_wall_clock_stores_what_it_stores_under_a_steady_one(folder, jumps_ns):
    world, history = sqlite_world(folder / "home", clock=JumpingClock(jumps_ns=jumps_ns)), History()
    try:
        asyncio.run(drive(world, history))
        listed = world.context.transactions.read(lambda uow: uow.submaps.find(TENANT, map_id=POSTED.map_id)).result()
    finally:
        world.context.transactions.close()
    found = survey(folder / "home")
    assert found.against(history) == []
    assert found.states == {"DESCRIBED": 8, "FAILED": 1}
    assert found.committed == {
        POSTED.session_id: 0,
        STREAMED.session_id: SCANS,
        STATED.session_id: 0,
        ANNEX.session_id: 0,
    }
    # In the order in which they came, whatever time their labels tell.
    assert [record.submap_id for record in listed][:4] == ["a", "c", "d", "degenerate"]


@pytest.mark.parametrize("jumps_ns", JUMPS.values(), ids=JUMPS)
def test_no_lease_is_stolen_or_kept_by_a_jump_of_the_wall_clock(jumps_ns):
    world = memory_world(JumpingClock(jumps_ns=jumps_ns), lease_ms=10_000)
    asyncio.run(open_session(world, POSTED))
    asyncio.run(world.use_cases.posting.post(TENANT, submap("a", 1, POSTED)))
    assert world.claim("w1").job.attempts == 1
    world.clock.ms += 9_999
    assert world.claim("w2") is None
    world.clock.ms += 1
    assert world.claim("w2").job.attempts == 2


def wall_clock_readings(text: str) -> list[str]:
    """The calls of a module that read the time of day."""
    calls = [ast.unparse(node.func) for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Call)]
    names = ("time.time", "time.time_ns", "datetime.now", "datetime.utcnow", "datetime.today", "date.today")
    return [call for call in calls if call in names or call.endswith(tuple(f".{name}" for name in names[2:]))]


def test_only_labels_and_ages_of_files_are_made_of_the_wall_clock():
    sources = (ROOT / "service").rglob("*.py")
    reading = {path.relative_to(ROOT).as_posix() for path in sources if wall_clock_readings(path.read_text())}
    assert reading <= READS_THE_WALL_CLOCK.keys()


@pytest.mark.parametrize(
    ("text", "found"),
    [("import time\ntime.time()", 1), ("time.monotonic()", 0), ("datetime.datetime.now(UTC)", 1), ("clock.now()", 0)],
)
def test_the_search_itself_finds_what_it_should(text, found):
    assert len(wall_clock_readings(text)) == found
