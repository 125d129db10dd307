"""What the service has found out, asked for now and then in a thread of its own."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.sdk.client import Client
from revisit.sdk.errors import ApiError, FailedPrecondition, NotFound
from revisit.sdk.resources import LoopClosure, Submap

UNMEASURED = np.diag([0.01, 0.01, 0.01, 0.001, 0.001, 0.001])
"""Of a loop that came without a covariance: 0.1 m and 1.8 degrees."""


@dataclass(frozen=True)
class Correction:
    """Where the session's odometry frame is in the frame of the map. T_map_odom (4, 4); `version` grows."""

    T_map_odom: se3.Matrix4
    version: int


@dataclass(frozen=True)
class Loop:
    """An accepted loop closure with its two submaps.

    T_match_query (4, 4) takes points of the query submap into the match submap's frame; covariance (6, 6) of it in
    (x, y, z, rx, ry, rz).
    """

    closure: LoopClosure
    query: Submap
    match: Submap
    T_match_query: se3.Matrix4

    @property
    def covariance(self) -> NDArray[np.float64]:
        """As verification measured it."""
        measured = np.asarray(self.closure.evidence.get("measurement", {}).get("covariance", []), dtype=np.float64)
        return measured if measured.shape == (6, 6) and np.isfinite(measured).all() else UNMEASURED


@dataclass(frozen=True)
class Answer:
    """One look at a session: all its submaps in their order, its loops, and its correction where there is one."""

    session: str
    submaps: tuple[Submap, ...]
    loops: tuple[Loop, ...]
    correction: Correction | None


class Answers(Protocol):
    """Where answers come from."""

    def ask(self, session: str) -> Answer | None:
        """What is known of a session; None while the service does not have it. Raises ApiError."""


@dataclass
class ServiceAnswers:
    """Answers of the service by the SDK. Submaps of other sessions are remembered."""

    client: Client
    _others: dict[str, Submap] = field(default_factory=dict)

    def ask(self, session: str) -> Answer | None:
        """See Answers."""
        map_name = session.split("/sessions/")[0]
        try:
            own = {submap.name: submap for submap in self.client.list_submaps(session)}
            found = self.client.loop_closures(map_name, state="ACCEPTED", session=session)
        except NotFound:
            return None
        loops = []
        for closure in found:
            query, match = self._submap(closure.query, own), self._submap(closure.match, own)
            if query is not None and match is not None and closure.T_match_query is not None:
                loops.append(Loop(closure, query, match, closure.T_match_query))
        return Answer(session, tuple(own.values()), tuple(loops), self._correction(session))

    def _correction(self, session: str) -> Correction | None:
        """None while no version of the map has the session."""
        try:
            found = self.client.correction(session)
        except FailedPrecondition:
            return None
        return Correction(found.T_map_odom, found.map_version)

    def _submap(self, name: str, own: dict[str, Submap]) -> Submap | None:
        """A submap, None where it is deleted meanwhile."""
        if name in own:
            return own[name]
        if name not in self._others:
            try:
                self._others[name] = self.client.get_submap(name)
            except NotFound:
                return None
        return self._others[name]


@dataclass(frozen=True)
class News:
    """What changed between two answers: loops that are new, and loops that are accepted no more."""

    answer: Answer
    found: tuple[Loop, ...]
    revoked: tuple[Loop, ...]


@dataclass
class Newsroom:
    """Asks and compares with what was known. `error` is why the last question failed, "" where it did not."""

    answers: Answers
    error: str = ""
    _known: dict[str, Loop] = field(default_factory=dict)
    _session: str = ""

    def ask(self, session: str) -> News | None:
        """The news of a session; None where it cannot be asked."""
        try:
            answer = self.answers.ask(session)
        except ApiError as error:
            self.error = str(error)
            return None
        self.error = ""
        if answer is None:
            return None
        if session != self._session:
            self._known, self._session = {}, session
        now = {loop.closure.name: loop for loop in answer.loops}
        found = tuple(loop for name, loop in now.items() if name not in self._known)
        revoked = tuple(loop for name, loop in self._known.items() if name not in now)
        self._known = now
        return News(answer, found, revoked)
