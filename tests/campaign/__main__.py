"""`python -m tests.campaign --hours N`: episodes by chance on the real service, until the time is up.

In each robots post and stream, an operator deletes, merges, reverts, backs up and upgrades, and processes, disk, clock
and links fail. The seed of one that fails is printed with the command that repeats it, and its folder is kept. The
mishaps and their order follow from the seed; when they meet what the robots do does not.
"""

from __future__ import annotations

import argparse
import secrets
import sys
import tempfile
import time
import traceback
from collections import Counter
from pathlib import Path

from tests.campaign.run import run
from tests.support.figures import append

STEPS = 40


def main() -> int:
    """Run episodes; the exit status: 1 where any failed."""
    parser = argparse.ArgumentParser(prog="python -m tests.campaign", description=__doc__)
    parser.add_argument("--hours", type=float, default=0.0, help="begin episodes for so long; 0 for one episode")
    parser.add_argument("--seed", help="of the first episode; by chance where none is given")
    parser.add_argument("--steps", type=int, default=STEPS, help=f"mishaps of an episode (default {STEPS})")
    parser.add_argument("--folder", type=Path, help="where homes are made")
    options = parser.parse_args()
    folder = options.folder or Path(tempfile.mkdtemp(prefix="revisit-campaign-"))
    until_s = time.monotonic() + 3600.0 * options.hours
    seed, failed, acknowledged, mishaps = options.seed or secrets.token_hex(4), [], 0, Counter[str]()
    while True:
        print(f"seed {seed}", flush=True)
        try:
            ended = run(seed, options.steps, folder / seed)
            acknowledged, mishaps = acknowledged + ended.acknowledged, mishaps + ended.mishaps
            print(f"seed {seed}: {ended.acknowledged} kept, {ended.backups} backups, {dict(ended.answers)}", flush=True)
        except Exception:  # noqa: BLE001  # told, and the next one begins
            failed.append(seed)
            traceback.print_exc()
            print(f"FAILED; again: python -m tests.campaign --seed {seed} --steps {options.steps}", flush=True)
        seed = secrets.token_hex(4)
        if time.monotonic() >= until_s:
            break
    append({"campaign": dict(mishaps), "acknowledged": acknowledged, "failed": failed})
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
