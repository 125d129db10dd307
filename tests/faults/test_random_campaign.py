"""The campaign of `python -m tests.campaign`, short: an episode keeps what was acknowledged, and notices a loss."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from dataclasses import replace

import pytest

from tests.campaign import mishaps
from tests.campaign.episode import as_of, episode
from tests.campaign.run import chosen, require_kept, settle
from tests.faults.history import Kind, Operation, Outcome, Stored, violations
from tests.faults.preloaded import COMPILER

SHORT = (mishaps.post_aside, mishaps.kill_worker, mishaps.back_up, mishaps.delete_submap, mishaps.bad_links)


def test_a_seed_repeats_its_mishaps():
    assert chosen("a", 40) == chosen("a", 40) != chosen("b", 40)
    assert set(chosen("a", 2000)) == set(mishaps.MISHAPS)


def test_a_backup_must_hold_what_was_known_when_it_began_and_may_hold_the_rest():
    kept = Operation("robot", Kind.PUT, "submap/a", "x", 1, Outcome.OK, 2)
    later = Operation("robot", Kind.PUT, "submap/b", "y", 3, Outcome.OK, 4)
    refused = Operation("robot", Kind.PUT, "submap/c", "z", 5, Outcome.FAIL, 6)
    then = as_of(frozenset({id(kept)}), [kept, later, refused])
    a, b, c = Stored("submap/a", "x"), Stored("submap/b", "y"), Stored("submap/c", "z")
    assert violations(then, [a]) == violations(then, [a, b]) == []
    assert violations(then, [b]) and violations(then, [a, c]) and violations(then, [a, replace(b, content="?")])


@pytest.mark.skipif(COMPILER is None, reason="no C compiler here: a disk cannot be made to fail")
def test_an_episode_keeps_what_was_acknowledged_and_notices_what_is_not_kept(folder):
    with episode(folder / "episode", "short") as it:
        for mishap in SHORT:
            mishap(it)
            it.is_served()
        settle(it)
        require_kept(it)
        lost = it.fleet.history.acknowledged()[0].key.removeprefix("submap/")
        with closing(sqlite3.connect(it.home / "revisit.db")) as rows:
            assert rows.execute("DELETE FROM submaps WHERE submap_id = ?", (lost,)).rowcount == 1
            rows.commit()
        it.backups.clear()
        with pytest.raises(AssertionError, match=f"submap/{lost}: acknowledged to robot. and lost"):
            require_kept(it)
