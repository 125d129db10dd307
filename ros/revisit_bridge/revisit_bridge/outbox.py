"""The sessions' spools in one folder: the current one is filled, earlier ones are emptied, finished and removed."""

from __future__ import annotations

import contextlib
import logging
import os
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from revisit.core.errors import RevisitError
from revisit.core.geometry import se3
from revisit.sdk.anchors import NewAnchor
from revisit.sdk.client import Client
from revisit.sdk.clouds import PointsLike
from revisit.sdk.errors import ApiError
from revisit.sdk.scan_choice import Send
from revisit.sdk.spool import Spool, SpoolState
from revisit_bridge.kept_anchors import AnchorPosting, KeptAnchors

log = logging.getLogger("revisit_bridge")

SUFFIX = ".spool"
STOREY_SUFFIX = ".storey"
"""Of the file beside a spool that holds the storey of its session: the session may be created after a restart."""
ANCHORS_SUFFIX = ".anchors"
"""Of the file beside a spool that holds the anchors of its session which the service does not have."""

RETRY_S = 30.0
LOST_SESSION = frozenset({"SESSION_FINISHED", "NOT_FOUND", "SEQ_GAP", "ALREADY_EXISTS"})
"""Reasons after which a session cannot go on: only a new one helps. After others the stream is opened again."""


class Stream(Protocol):
    """What is used of the SDK's `SpooledStream`."""

    @property
    def state(self) -> SpoolState:
        """What waits in the spool."""

    @property
    def error(self) -> Exception | None:
        """Why nothing is sent any more."""

    def send(self, points: PointsLike, T_odom_sensor: se3.Matrix4, stamp_ns: int) -> None:
        """Put a scan on the disk. Raises RevisitError."""


class Sessions(Protocol):
    """What is used of the service."""

    def stream(self, session: str, spool: Path, storey: str) -> contextlib.AbstractContextManager[Stream]:
        """The stream of a session by way of a file; the session, on a storey or "", is created once there is a link."""

    def post_anchors(self, session: str, anchors: Sequence[NewAnchor]) -> None:
        """Post anchors of a session. Raises ApiError."""

    def finish(self, session: str) -> None:
        """Finish a session. Raises ApiError."""


@dataclass(frozen=True)
class ServiceSessions:
    """Sessions of one robot, with the drift of its odometry, over the SDK. The map and the robot are created with the
    first of them.
    """

    client: Client
    robot_id: str
    max_bytes: int
    drift: str = ""
    send: Send = "described"

    def stream(self, session: str, spool: Path, storey: str) -> contextlib.AbstractContextManager[Stream]:
        """See Sessions."""
        return self.client.spooled_stream(
            session, spool, max_bytes=self.max_bytes, prepare=lambda: self._create(session, storey), send=self.send
        )

    def post_anchors(self, session: str, anchors: Sequence[NewAnchor]) -> None:
        """See Sessions."""
        self.client.sessions.post_anchors(session, anchors)

    def finish(self, session: str) -> None:
        """See Sessions."""
        self.client.finish_session(session)

    def _create(self, session: str, storey: str) -> None:
        _, map_id, _, session_id = session.split("/")
        with contextlib.suppress(ApiError):
            # A map that is there may have other settings than the service's defaults: that is no matter here.
            self.client.create_map(map_id)
        robot = self.client.create_robot(self.robot_id)
        said = {"storey": storey or None, "drift": self.drift or None}
        self.client.create_session(f"maps/{map_id}", session_id, robot=robot, **said)


@dataclass
class _Open:
    """A session whose spool is open. `stopped_at_s` is when its stream was found to have ended."""

    name: str
    spool: Path
    stream: Stream
    anchors: KeptAnchors
    close: Callable[[], Any]
    stopped_at_s: float | None = None


@dataclass(frozen=True)
class OutboxState:
    """How things stand. `pending` scans wait in all spools; `stuck`: sessions that the service refuses for good.

    Of the anchors, those of `anchors_lost` were refused, or their session is gone.
    """

    session: str
    pending: int
    dead_letters: int
    committed_seq: int | None
    error: str
    stuck: tuple[str, ...]
    anchors_waiting: int = 0
    anchors_stored: int = 0
    anchors_lost: int = 0


class Outbox:
    """Safe between the thread that sends and the one that tends."""

    def __init__(
        self, folder: Path, map_id: str, sessions: Sessions, now_s: Callable[[], float], storey: str = ""
    ) -> None:
        """Opens what earlier runs have left in `folder`, which is made where there is none. Raises SpoolUnusable.

        Sessions that begin are on `storey`, "" where it is not known; those of earlier runs stay on theirs.
        """
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        self._folder, self._map_id, self._sessions, self._now_s = folder, map_id, sessions, now_s
        self._storey = storey
        self._posting, self._anchors_gone = AnchorPosting(sessions.post_anchors), 0
        self._anchor_errors: dict[str, str] = {}
        self._lock = threading.RLock()
        self._current: _Open | None = None
        self._ending = [self._opened(_session_of(spool), spool) for spool in sorted(folder.glob(f"*{SUFFIX}"))]
        self._stuck: dict[str, str] = {}

    def resume(self, session_id: str) -> bool:
        """Go on with a session of an earlier run, before anything is sent or tended. Not with one of another storey:
        that ends, and the answer is False.
        """
        with self._lock:
            mine = [left for left in self._ending if left.spool.stem == session_id]
            if mine and _storey_of(mine[0].spool) != self._storey:
                return False
            self._ending = [left for left in self._ending if left not in mine]
            self._current = mine[0] if mine else self._new(session_id)
            return True

    def change_storey(self, storey: str) -> None:
        """Sessions that begin from now on are on another storey."""
        with self._lock:
            self._storey = storey

    def begin(self, session_id: str) -> None:
        """Scans go to a new session from now on; the one before is finished once its scans are sent."""
        with self._lock:
            if self._current is not None:
                self._ending.append(self._current)
            self._current = self._new(session_id)

    def end(self) -> None:
        """No session is current any more; see `begin`."""
        with self._lock:
            if self._current is not None:
                self._ending.append(self._current)
            self._current = None

    def send(self, points: PointsLike, T_odom_sensor: se3.Matrix4, stamp_ns: int) -> None:
        """Put a scan of the current session on the disk. Raises RevisitError, SpoolFull among them."""
        with self._lock:
            if self._current is None:
                raise RevisitError("no session was begun")
            self._current.stream.send(points, T_odom_sensor, stamp_ns)

    def keep(self, anchor: NewAnchor) -> None:
        """Put an anchor of the current session on the disk. Raises RevisitError."""
        with self._lock:
            if self._current is None:
                raise RevisitError("no session was begun")
            self._current.anchors.keep(anchor)

    @property
    def lost(self) -> str | None:
        """Why the current session cannot go on, None where it can: the next scan needs a new one."""
        with self._lock:
            error = self._current.stream.error if self._current is not None else None
        reason = _reason(error)
        return None if reason not in LOST_SESSION else f"the service refuses the session: {error}"

    def tend(self) -> None:
        """Post anchors, finish and remove what is sent; open streams again that ended for a passing reason.

        Asks the service. Raises RevisitError where a file cannot be used.
        """
        with self._lock:
            ending, current = list(self._ending), self._current
        for left in ending:
            self._tend_ending(left)
        if current is None:
            return
        if current.stream.error is not None and self.lost is None:
            self._reopen(current)
        elif current.stream.state.committed_seq:  # before its first scan the service does not have the session
            self._post_anchors(current)

    def _tend_ending(self, left: _Open) -> None:
        if left.stream.error is not None:
            if _reason(left.stream.error) in LOST_SESSION:
                self._give_up(left, left.stream.error)
            else:
                self._reopen(left)
        elif left.stream.state.pending == 0 and self._finished(left):
            self._remove(left)

    def _finished(self, left: _Open) -> bool:
        """Whether the service has all of a session and knows that it has ended, or does not have it any more."""
        if not left.stream.state.committed_seq:
            return True
        error = self._post_anchors(left)
        if error is None:
            try:
                self._sessions.finish(left.name)
            except ApiError as refusal:
                error = refusal
        return error is None or error.reason in LOST_SESSION

    def _post_anchors(self, item: _Open) -> ApiError | None:
        """Post the anchors of a session; the error after which the rest is kept, None where none is left."""
        try:
            self._posting.empty(item.name, item.anchors)
        except ApiError as error:
            self._anchor_errors[item.name] = f"{item.anchors.waiting} anchors wait: {error}"
            return error
        self._anchor_errors.pop(item.name, None)
        return None

    def _give_up(self, left: _Open, error: Exception) -> None:
        """Its scans stay in the file, and are told of; nothing more is tried before the next start."""
        with self._lock:
            self._stuck[left.name] = str(error)
            self._ending = [other for other in self._ending if other is not left]
            left.close()

    def _remove(self, left: _Open) -> None:
        with self._lock:
            self._ending = [other for other in self._ending if other is not left]
            self._anchor_errors.pop(left.name, None)
            if left.anchors.waiting:
                log.warning("the service does not have %s: %d anchors are gone", left.name, left.anchors.waiting)
                self._anchors_gone += left.anchors.waiting
            left.close()
            for file in left.spool.parent.glob(f"{left.spool.name}*"):
                file.unlink(missing_ok=True)

    def _reopen(self, ended: _Open) -> None:
        with self._lock:
            if ended.stopped_at_s is None:
                ended.stopped_at_s = self._now_s()
            if self._now_s() - ended.stopped_at_s < RETRY_S:
                return
            ended.close()
            again = self._opened(ended.name, ended.spool)
            self._ending = [again if other is ended else other for other in self._ending]
            self._current = again if self._current is ended else self._current

    @property
    def state(self) -> OutboxState:
        """How things stand now."""
        with self._lock:
            current, all_open = self._current, [*self._ending, *([self._current] if self._current else [])]
            states = [item.stream.state for item in all_open]
            errors = [str(item.stream.error) for item in all_open if item.stream.error is not None]
            errors += self._anchor_errors.values()
            return OutboxState(
                session=current.name if current else "",
                pending=sum(state.pending for state in states),
                dead_letters=sum(state.dead_letters for state in states),
                committed_seq=current.stream.state.committed_seq if current else None,
                error="; ".join(errors),
                stuck=tuple(sorted(self._stuck)),
                anchors_waiting=sum(item.anchors.waiting for item in all_open),
                anchors_stored=self._posting.stored,
                anchors_lost=self._posting.refused + self._anchors_gone,
            )

    def close(self) -> None:
        """Let go of all spools; what they hold stays for the next run."""
        with self._lock:
            for item in [*self._ending, *([self._current] if self._current else [])]:
                item.close()
            self._ending, self._current = [], None

    @property
    def session_ids(self) -> set[str]:
        """Ids of the sessions that have a spool here."""
        return {spool.stem for spool in self._folder.glob(f"*{SUFFIX}")}

    def _new(self, session_id: str) -> _Open:
        """A spool of its own for a session, and beside it the storey that it is on."""
        spool = self._path(session_id)
        if self._storey:
            with _storey_file(spool).open("w", encoding="utf-8") as beside:
                beside.write(self._storey)
                beside.flush()
                os.fsync(beside.fileno())
        return self._opened(self._name(session_id), spool)

    def _opened(self, name: str, spool: Path) -> _Open:
        with contextlib.ExitStack() as stack:
            stream = stack.enter_context(self._sessions.stream(name, spool, _storey_of(spool)))
            anchors = KeptAnchors(spool.with_name(spool.name + ANCHORS_SUFFIX))
            stack.callback(anchors.close)
            return _Open(name, spool, stream, anchors, stack.pop_all().close)

    def _path(self, session_id: str) -> Path:
        return self._folder / f"{session_id}{SUFFIX}"

    def _name(self, session_id: str) -> str:
        return f"maps/{self._map_id}/sessions/{session_id}"


def _storey_file(spool: Path) -> Path:
    return spool.with_name(spool.name + STOREY_SUFFIX)


def _storey_of(spool: Path) -> str:
    """The storey that the session of a spool is on, "" where none is known."""
    beside = _storey_file(spool)
    return beside.read_text(encoding="utf-8") if beside.is_file() else ""


def _session_of(spool: Path) -> str:
    """The session that a spool's scans belong to: that of its map at the time, whatever the parameters say now."""
    opened = Spool(spool)
    try:
        return opened.state.session
    finally:
        opened.close()


def _reason(error: Exception | None) -> str:
    """The reason of an error of the service or of the spool, "" for none."""
    if isinstance(error, ApiError):
        return error.reason
    return str(error.code) if isinstance(error, RevisitError) else ""
