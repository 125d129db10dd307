"""A worker that compiles for half a minute says so in the log, again and again until it is ready."""

from __future__ import annotations

import threading

from revisit.service.worker.loading import logged_while_loading
from tests.support.patience import PATIENCE_S


def test_loading_that_takes_long_is_told_until_it_ends():
    told, enough = [], threading.Event()

    def tell(event, **fields):
        told.append((event, fields))
        if len(told) == 3:
            enough.set()

    with logged_while_loading(tell, first_s=0.001, every_s=0.001):
        assert enough.wait(PATIENCE_S)
    event, fields = told[0]
    assert event == "worker_still_loading" and "compiles" in fields["hint"] and fields["seconds"] >= 0
    assert not [thread for thread in threading.enumerate() if thread.name == "loading"]


def test_loading_that_is_quick_is_not_told():
    told = []
    with logged_while_loading(lambda event, **_: told.append(event)):
        pass
    assert told == []
