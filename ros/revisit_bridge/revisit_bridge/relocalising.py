"""Where in the map is the robot? A conversation from a request until it is placed, in a thread of its own."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Protocol

from revisit.core.geometry import se3
from revisit.sdk.errors import ApiError, InvalidArgument
from revisit.sdk.resources import Relocalisation
from revisit_bridge.messages import Points

log = logging.getLogger("revisit_bridge")


class Asked(Protocol):
    """An open conversation."""

    def see(self, points: Points, T_odom_sensor: se3.Matrix4) -> Relocalisation:
        """The answer to one more scan. Raises ApiError."""


Converse = Callable[[str], AbstractContextManager[Asked]]
"""Opens a conversation that leaves out the session of this name, the robot's own; "" for none."""


@dataclass(frozen=True)
class _Seen:
    points: Points
    T_odom_sensor: se3.Matrix4


class Relocaliser:
    """Takes scans from one thread, asks in another: of scans that come faster than answers the newest counts."""

    def __init__(self, converse: Converse) -> None:
        self._converse = converse
        self._changed = threading.Condition()
        self._newest: _Seen | None = None
        self._answers: list[Relocalisation] = []
        self._thread: threading.Thread | None = None
        self._ending = False
        self.error = ""
        """Why the last conversation ended before the robot was placed; "" where it did not."""

    @property
    def asking(self) -> bool:
        """Whether a conversation is under way."""
        return self._thread is not None and self._thread.is_alive()

    def begin(self, own_session: str) -> bool:
        """Begin a conversation; False where one is under way."""
        if self.asking:
            return False
        self._newest, self._ending, self.error = None, False, ""
        self._thread = threading.Thread(target=self._hold, args=(own_session,), name="revisit where", daemon=True)
        self._thread.start()
        return True

    def offer(self, points: Points, T_odom_sensor: se3.Matrix4) -> None:
        """The robot has seen a scan."""
        with self._changed:
            self._newest = _Seen(points, T_odom_sensor)
            self._changed.notify_all()

    def answers(self) -> list[Relocalisation]:
        """The answers since the last call."""
        with self._changed:
            found, self._answers = self._answers, []
        return found

    def close(self) -> None:
        """End the conversation."""
        with self._changed:
            self._ending = True
            self._changed.notify_all()
        if self._thread is not None:
            self._thread.join(timeout=5.0)

    def _hold(self, own_session: str) -> None:
        try:
            with self._converse(own_session) as asked:
                while (seen := self._next()) is not None:
                    answer = self._asked(asked, seen)
                    if answer is not None and answer.state == "PLACED":
                        return
        except ApiError as error:
            self.error = str(error)
            log.warning("relocalisation ended: %s", error)

    def _next(self) -> _Seen | None:
        """The newest scan, once there is one; None at the end."""
        with self._changed:
            self._changed.wait_for(lambda: self._ending or self._newest is not None)
            seen, self._newest = self._newest, None
        return None if self._ending else seen

    def _asked(self, asked: Asked, seen: _Seen) -> Relocalisation | None:
        try:
            answer = asked.see(seen.points, seen.T_odom_sensor)
        except InvalidArgument as error:
            log.warning("a scan was not used for relocalisation: %s", error)
            return None
        with self._changed:
            self._answers.append(answer)
        return answer
