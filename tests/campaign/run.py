"""Running an episode by its seed, and all that must be true at its end."""

from __future__ import annotations

import random
import shutil
import subprocess
import sys
import time
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from revisit.service.engines.local.sqlite.backup import restore_backup
from revisit.service.engines.local.sqlite.backup_key import own_key
from revisit.service.engines.local.sqlite.examination import examine
from revisit.service.engines.schema import NEWEST_REVISION
from tests.campaign.episode import Episode, as_of, episode
from tests.campaign.mishaps import MISHAPS, Mishap, clear
from tests.faults.history import violations
from tests.faults.survey import survey
from tests.support.patience import eventually

SETTLED_S = 600.0


@dataclass(frozen=True)
class Ended:
    """An episode that ended well."""

    acknowledged: int
    mishaps: Counter[str]
    answers: Counter[str]
    backups: int


def chosen(seed: str, steps: int) -> list[Mishap]:
    """The mishaps of a seed, in their order."""
    return random.Random(f"{seed} mishaps").choices(list(MISHAPS), list(MISHAPS.values()), k=steps)


def run(seed: str, steps: int, folder: Path) -> Ended:
    """Run an episode in `folder`, which goes if it ends well. Raises AssertionError where a promise is broken."""
    shutil.rmtree(folder, ignore_errors=True)
    mishaps = chosen(seed, steps)
    with episode(folder, seed) as it:
        for number, mishap in enumerate(mishaps, 1):
            began_s = time.monotonic()
            mishap(it)
            it.is_served()
            print(f"  {number} {mishap.__name__}: {time.monotonic() - began_s:.1f} s", flush=True)
        settle(it)
        require_kept(it)
    shutil.rmtree(folder)
    names = Counter(mishap.__name__ for mishap in mishaps)
    return Ended(it.fleet.acknowledged(), names, it.answers, len(it.backups))


def settle(it: Episode) -> None:
    """End the troubles and wait until there is nothing more to do."""
    clear(it)
    it.fleet.crew.end()
    it.until_it_runs()
    it.fleet.work_off()
    eventually(lambda: it.unfinished() == 0, "jobs or deletions are left", SETTLED_S)


def require_kept(it: Episode) -> None:
    """All that was acknowledged is there, once; so it is in each backup; and no row, blob or number is wrong."""
    it.service.terminate()
    if it.service.upgraded:
        command = [sys.executable, "-m", "revisit.service", "migrate", "--revision", NEWEST_REVISION]
        variables = {"REVISIT_HOME": str(it.home), "PATH": "/usr/bin:/bin"}
        subprocess.run(command, cwd=it.service.folder, env=variables, check=True, capture_output=True)
    found = it.fleet.require_kept(it.home)
    wrong = [*it.surprises, *(surprise for poster in it.posters for surprise in poster.surprises)]
    wrong += [f"{state}: {found.failures}" for state in found.states if state != "DESCRIBED"]
    wrong += [f"{one.check}: {one.detail}" for one in examine(it.home, full=True) if one.ok is False]
    for number, (archive, known) in enumerate(it.backups):
        restored = it.folder / f"restored{number}"
        restore_backup(archive, restored, own_key(it.home))
        shown = survey(restored)
        wrong += [f"{archive.name}: {problem}" for problem in shown.problems]
        then = as_of(known, it.fleet.history.operations)
        wrong += [f"{archive.name}: {problem}" for problem in violations(then, shown.rows)]
        with suppress(FileNotFoundError):
            shutil.rmtree(archive)
    assert not wrong, "\n".join(wrong)
