"""Named points of the real code at which a test can end the process, fail the step or make it slow.

`fail` of REVISIT_FOR_TESTS, "ingest.after_commit=kill@17", kills this process with SIGKILL when that point is reached
for the 17th time; without `@n` every time counts. Several are separated by commas. Nothing is armed by default, and a
point that is not armed costs one look at an empty dictionary.
"""

from __future__ import annotations

import errno
import itertools
import os
import re
import signal
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import StrEnum

POINTS = {
    "blob.before_sync": "a blob is written to its temporary file, nothing is synced",
    "blob.before_rename": "the temporary file is synced, it has not its name yet",
    "blob.before_directory_sync": "the blob has its name, the directory is not synced",
    "ingest.after_blob": "the cloud of a scan or submap is durable, no row names it",
    "commit.before": "the work of a write transaction is done, nothing is committed",
    "commit.after": "a write transaction is committed, whoever waits for it is not told",
    "ingest.after_commit": "a scan or submap is committed, the client is not told",
    "session.after_finish": "the end of a session is committed, the client is not told",
    "job.after_claim": "a job is leased and its attempt counted, the run has not begun",
    "job.after_description": "a submap is described, its blobs are not stored",
    "job.after_blobs": "the blobs of a description are durable, no row names them",
    "job.before_enter": "the blobs of a description are durable, the submap has not entered its map",
    "job.after_enter": "a submap has entered its map, its loops are not searched for",
    "job.before_commit": "the loops of a submap are judged, none of them is committed",
    "job.before_failure": "a run has failed, the failure is not committed",
    "job.after_commit": "the end of a job is committed, the worker has not noted it",
    "merge.after_submap": "in its transaction, the submap is described, it is not in the index of its map",
    "merge.after_loops": "in its transaction, the loops are added, the job has not ended",
    "optimise.after_read": "the pose graph of a map is read, its optimisation has not begun",
    "optimise.after_solution": "the poses of a map are optimised, nothing of them is committed",
    "optimise.after_version": "in its transaction, a version of a map is added, without its poses",
    "optimise.after_poses": "in its transaction, the poses and verdicts of a version are added, it is not in force",
    "recall.before_commit": "rejected loops are tested again, nothing of it is committed",
    "revert.after_rows": "in its transaction, an earlier version of a map is back, nothing is committed",
    "map_merge.after_portion": "some pairs of a merge are verified and stored, its job does not name them",
    "map_merge.after_portion_named": "its job names the verified pairs of a merge, those from before are still there",
    "map_merge.after_evidence": "two maps are compared, nothing of the merge is committed",
    "map_merge.after_rows": "in its transaction, the sessions of a merge are copied, the map has no version of them",
    "map_merge.before_end": "in its transaction, a merge is noted, its job has not ended",
    "unmerge.after_rows": "in its transaction, the copies of a merge are gone, the earlier version is not back",
    "unmerge.after_version": "in its transaction, a merge is taken back, nothing is committed",
    "tile.after_blob": "a tile of a map is durable, no row names it",
    "changes.after_blob": "what changed in a portion of a map is durable, no row names it",
    "publish.after_blob": "what the bytes of a map file are is durable, no row names it",
    "plan.after_blob": "the picture of a plan is durable, no row names it",
    "index.before_apply": "the changes of an index are read, none is applied",
    "index.after_apply": "the changes of an index are applied, nothing was searched",
    "index.before_file_named": "the file of an index is written, its map does not name it",
    "index.after_file_named": "a map names the file of its index, no process has loaded it",
    "delete.after_mark": "a session or map is marked as deleted, its rows and blobs are there",
    "delete.after_rows": "a submap, or a portion of the rows of a session or map, is gone, its blobs wait",
    "delete.after_blob": "some blobs that no row names are gone, their collection has not ended",
}
"""Every point there is, and where the code stands when it is reached."""


class Action(StrEnum):
    """The action of an armed point."""

    KILL = "kill"
    EXIT = "exit"
    RAISE = "raise"
    ENOSPC = "enospc"
    EIO = "eio"
    SLEEP = "sleep"


EXIT_STATUS = 71
"""Of the action `exit` (EX_OSERR)."""

SLEEP_S = 1.0
"""How long the action `sleep` takes."""


class FailpointReached(RuntimeError):
    """The error of the action `raise`."""


@dataclass(frozen=True)
class _Armed:
    action: Action
    at: int | None
    hits: Iterator[int] = field(default_factory=lambda: itertools.count(1))


_armed: dict[str, _Armed] = {}

_ARM = re.compile(r"(?P<point>[a-z_.]+)=(?P<action>[a-z]+)(?:@(?P<at>[1-9][0-9]*))?")


def arm(specification: str) -> None:
    """Arm the points of `specification` and no others. Raises ValueError for a point or action that does not exist."""
    armed = dict(_parsed(part.strip()) for part in specification.split(",") if part.strip())
    _armed.clear()
    _armed.update(armed)


def failpoint(point: str) -> None:
    """The code is at `point` of `POINTS`: do the armed action, mostly none.

    Raises FailpointReached or OSError where the action says so.
    """
    if _armed and point in _armed:
        _act(point, _armed[point])


def _parsed(part: str) -> tuple[str, _Armed]:
    match = _ARM.fullmatch(part)
    if match is None:
        raise ValueError(f"{part!r} is not of the form point=action or point=action@n")
    if match["point"] not in POINTS:
        raise ValueError(f"there is no failpoint {match['point']!r}; there are {', '.join(POINTS)}")
    if match["action"] not in list(Action):
        raise ValueError(f"a failpoint cannot {match['action']!r}; it can {', '.join(Action)}")
    return match["point"], _Armed(Action(match["action"]), None if match["at"] is None else int(match["at"]))


def _act(point: str, armed: _Armed) -> None:
    if armed.at not in (None, next(armed.hits)):
        return
    match armed.action:
        case Action.KILL:
            os.kill(os.getpid(), signal.SIGKILL)
        case Action.EXIT:
            os._exit(EXIT_STATUS)
        case Action.RAISE:
            raise FailpointReached(point)
        case Action.SLEEP:
            time.sleep(SLEEP_S)
        case Action.ENOSPC | Action.EIO:
            number = errno.ENOSPC if armed.action is Action.ENOSPC else errno.EIO
            raise OSError(number, os.strerror(number))
