"""What was acknowledged survives a power cut at any moment; and the model of the disk itself, on hand-made runs."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from revisit.service.engines.local.sqlite.migration import migrate
from tests.faults.history import History
from tests.faults.power_cut import Disk, Recording, Step, can_record, crash_states, python_program, record
from tests.faults.survey import survey
from tests.support.campaigns import Campaign, sizes

ROOT = Path(__file__).resolve().parents[2]
RANDOM = random.Random(0)


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> Recording:
    reason = can_record()
    if reason:
        pytest.skip(f"power cuts are replayed from what strace records: {reason}")
    return record(tmp_path_factory.mktemp("recorded"), python_program("tests.faults.drive"), ROOT)


def problems(state, home: Path) -> list[str]:
    """Start over the store of a crash state, as the service would, and look at everything in it."""
    state.restore(home)
    history = History.parse(state.log)
    if not history.operations:
        migrate(home / "revisit.db")
    return survey(home).against(history)


def require_sound(recording: Recording, count: int, home: Path) -> None:
    """Every one of `count` crash states holds what was acknowledged, and fits together."""
    campaign = Campaign("P1", count)
    for _, state in zip(campaign, crash_states(recording, count), strict=False):
        found = problems(state, home)
        assert not found, f"cut behind call {state.step} ({state.how} of what was not synced): {found}"
    assert campaign.over
    campaign.publish("power cuts: 0 acknowledged lost, 0 damaged")


@pytest.mark.parametrize("count", sizes("POWER_CUTS", 60, 5_000))
@pytest.mark.timeout(1800)
def test_a_power_cut_takes_nothing_that_was_acknowledged(recording, folder, count):
    require_sound(recording, count, folder / "home")


def test_the_recording_holds_the_whole_drive(recording):
    calls = {step.call for step in recording.steps}
    assert calls >= {"create", "write", "sync", "rename", "remove", "make_directory"}
    log = b"".join(step.data for step in recording.steps if step.path == recording.log)
    assert log == Path(recording.log).read_bytes()
    disk = Disk(recording.root)
    for step in recording.steps:
        disk.take(step)
    home = Path(recording.root)
    there = {str(path.relative_to(home)): path.read_bytes() for path in home.rglob("*") if path.is_file()}
    assert disk.after_cut("everything", RANDOM) == there


def after(*steps: Step, how: str = "nothing") -> dict[str, bytes]:
    disk = Disk("/d")
    for step in steps:
        disk.take(step)
    return disk.after_cut(how, random.Random(1))


CREATED = (Step("create", "/d/a"), Step("write", "/d/a", b"abc", 0))
SYNCED = (*CREATED, Step("sync", "/d/a"))


def test_a_file_is_there_after_both_it_and_its_directory_are_synced():
    assert after(*SYNCED) == {}
    assert after(*CREATED, Step("sync", "/d")) == {"a": b""}
    assert after(*SYNCED, Step("sync", "/d")) == {"a": b"abc"}
    assert after(*CREATED, how="everything") == {"a": b"abc"}


def test_a_write_after_the_last_sync_may_be_lost():
    longer = (*SYNCED, Step("sync", "/d"), Step("write", "/d/a", b"XY", 1))
    assert after(*longer) == {"a": b"abc"}
    assert after(*longer, how="everything") == {"a": b"aXY"}
    assert after(*longer, Step("truncate", "/d/a", offset=1), how="everything") == {"a": b"a"}


def test_a_rename_is_all_or_nothing_and_needs_its_directory():
    renamed = (*SYNCED, Step("sync", "/d"), Step("rename", "/d/a", target="/d/b"))
    assert after(*renamed) == {"a": b"abc"}
    assert after(*renamed, Step("sync", "/d")) == {"b": b"abc"}


def test_a_removal_needs_its_directory():
    removed = (*SYNCED, Step("sync", "/d"), Step("remove", "/d/a"))
    assert after(*removed) == {"a": b"abc"}
    assert after(*removed, Step("sync", "/d")) == {}


def test_what_lies_in_a_directory_that_was_not_synced_is_lost_with_it():
    below = (Step("make_directory", "/d/s"), Step("create", "/d/s/a"), Step("sync", "/d/s/a"), Step("sync", "/d/s"))
    assert after(*below) == {}
    assert after(*below, Step("sync", "/d")) == {"s/a": b""}


def test_a_torn_write_ends_at_a_sector():
    disk = Disk("/d")
    for step in (Step("create", "/d/a"), Step("sync", "/d"), Step("write", "/d/a", bytes(2000), 0)):
        disk.take(step)
    sizes = {len(disk.after_cut("prefix", random.Random(seed))["a"]) for seed in range(200)}
    assert sizes == {0, 512, 1024, 1536}


def test_a_subset_of_the_writes_may_leave_a_hole():
    disk = Disk("/d")
    for step in (
        Step("create", "/d/a"),
        Step("sync", "/d"),
        Step("write", "/d/a", b"x", 0),
        Step("write", "/d/a", b"y"),
    ):
        disk.take(step)
    assert b"\0y" in {disk.after_cut("subset", random.Random(seed))["a"] for seed in range(200)}


def test_crash_states_are_different_and_carry_the_log_up_to_the_cut():
    steps = [*SYNCED, Step("sync", "/d"), Step("write", "/log", b"done\n"), Step("remove", "/d/a"), Step("sync", "/d")]
    states = list(crash_states(Recording("/d", "/log", steps), count=100))
    assert len({(state.log, *state.files.items()) for state in states}) == len(states) == 5
    assert {state.log for state in states if state.step < 5} == {b""}
    assert {state.log for state in states if state.step >= 5} == {b"done\n"}
