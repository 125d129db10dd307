"""Chores of the gateway: each in its own rhythm, and not all at the same moment."""

from __future__ import annotations

import asyncio

from revisit.service.features.upkeep import chores as upkeep
from revisit.service.features.upkeep.chores import Chore, Upkeep


async def test_chores_of_one_rhythm_are_all_done_at_once_at_the_start_only(monkeypatch):
    now_s, turns, sleepers, settle = 0.0, {}, [], asyncio.sleep

    async def sleep(seconds):
        woken = asyncio.get_running_loop().create_future()
        sleepers.append((now_s + seconds, woken))
        await woken

    def noting(name):
        async def work():
            turns.setdefault(name, []).append(now_s)

        return work

    monkeypatch.setattr(upkeep.asyncio, "sleep", sleep)
    running = Upkeep([Chore(name, 8.0, noting(name)) for name in "abcd"])
    running.start()
    for _ in range(12):
        for _ in range(10):
            await settle(0)
        now_s, woken = min(sleepers, key=lambda sleeper: sleeper[0])
        sleepers.remove((now_s, woken))
        woken.set_result(None)
    await running.stop()
    firsts = {name: moments[:3] for name, moments in turns.items()}
    assert firsts == {"a": [0.0, 2.0, 10.0], "b": [0.0, 4.0, 12.0], "c": [0.0, 6.0, 14.0], "d": [0.0, 8.0, 16.0]}
