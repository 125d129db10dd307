"""Two releases run at once on one PostgreSQL, while the schema is already that of the later one.

The later one is a copy of this code with one step of the schema more, which says that this code runs beside it; or,
where REVISIT_TEST_EARLIER names the checkout of an earlier release, this code beside that one.
"""

from __future__ import annotations

import os
import random
import signal
import threading
from contextlib import ExitStack, closing
from pathlib import Path

import pytest

from revisit.service.engines.postgres.migration import current_revision
from revisit.service.engines.schema import NEWEST_REVISION
from tests.faults.cluster import SETTINGS, Robot, acknowledged_to, make_sessions
from tests.faults.stored_loops import Store, require_all, worked_off
from tests.support.next_migration import NEXT_REVISION, add_next_step
from tests.support.patience import PATIENCE_S, eventually
from tests.support.postgres import shared_server
from tests.support.processes import ROOT, ServiceProcess
from tests.support.source_copies import copied_packages

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1200)]

EACH = 10
"""Acknowledgements in each stage."""


def of_release(folder: Path) -> type[ServiceProcess]:
    """A service of the code in `folder`."""
    return type("OfRelease", (ServiceProcess,), {"folder": folder})


@pytest.fixture
def releases(tmp_path):
    """The folders of an earlier and a later release, and the schema of the later one."""
    if earlier := os.environ.get("REVISIT_TEST_EARLIER"):
        return Path(earlier), ROOT, NEWEST_REVISION
    later = tmp_path / "later"
    copied_packages(ROOT, later)
    step = add_next_step(later / "migrations")
    step.write_text(f'{step.read_text()}\nruns_from = "{NEWEST_REVISION}"\n')
    return ROOT, later, NEXT_REVISION


def test_what_either_release_takes_is_described_once_and_searched_among_what_both_took(tmp_path, releases):
    (earlier, later, newest), url, stop = releases, shared_server().new_database("two_releases"), threading.Event()
    settings = {**SETTINGS, "workers": 1, "database_url": url.render_as_string(hide_password=False)}
    gateways: list[ServiceProcess] = []
    robot = Robot(0, gateways, stop)

    def started(folder: Path) -> None:
        gateways.append(stack.enter_context(closing(of_release(folder)(tmp_path / "home", **settings))))

    def more() -> None:
        eventually(lambda seen=len(robot.acknowledged): len(robot.acknowledged) >= seen + EACH, "nothing gets on")

    with ExitStack() as stack:
        started(earlier)
        make_sessions(gateways[0])
        robot.thread.start()
        try:
            more()
            started(later)  # migrates while the earlier one takes submaps
            assert current_revision(url) == newest
            more()
            for process in random.sample(gateways, len(gateways)):
                process.send(signal.SIGKILL)
                process.close()
                process.start()
                more()
        finally:
            stop.set()
            robot.thread.join(PATIENCE_S)
        worked_off(Store(url))
        ended = {
            event["worker"]: event["end"]
            for one in gateways
            for event in one.events
            if event.get("event") == "worker_ended"
        }
        assert not ended, ended
    require_all(Store(url), acknowledged_to([robot]))
