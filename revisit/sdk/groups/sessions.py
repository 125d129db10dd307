"""Sessions, and where they lie in the map."""

from __future__ import annotations

import builtins
from collections.abc import Iterable
from typing import Any

from revisit.core.errors import BadField
from revisit.sdk import names
from revisit.sdk.anchors import ANCHORS_AT_ONCE, NewAnchor
from revisit.sdk.groups.group import Group
from revisit.sdk.input_watch import warn_of_session
from revisit.sdk.names import name_of
from revisit.sdk.radio import READINGS_AT_ONCE, RadioReading
from revisit.sdk.resources import Anchor, Correction, Map, Operation, Robot, Session


class Sessions(Group):
    """`client.sessions`."""

    def create(
        self,
        map_: str | Map,
        session_id: str,
        *,
        robot: str | Robot | None = None,
        storey: str | None = None,
        **details: str | None,
    ) -> Session:
        """Create a session in a map.

        `storey` is the storey of a building that all of it is driven on, as B2: it is never compared with sessions on
        storeys of another name. Without it, it is compared with all. `details` are other fields of a
        CreateSessionRequest.
        """
        of_robot = None if robot is None else name_of(robot, names.ROBOT)
        parent = name_of(map_, names.MAP)
        said = {"robot": of_robot, "storey": storey, **details}
        return Session.of(self._ask("CreateSession", parent=parent, session_id=session_id, **said))

    def get(self, name: str) -> Session:
        """Get `maps/{map}/sessions/{session}`."""
        return Session.of(self._ask("GetSession", name=name_of(name, names.SESSION)))

    def list(self, map_: str | Map) -> builtins.list[Session]:
        """The sessions of a map, oldest first."""
        return self._list(Session, "ListSessions", parent=name_of(map_, names.MAP))

    def finish(self, session: str | Session) -> Session:
        """Finish a session; the scans of its last, shorter window become a submap.

        Warns of the findings of the service so far (`SuspiciousInput`, `Session.findings`).
        """
        finished = Session.of(self._ask("FinishSession", name=name_of(session, names.SESSION)))
        warn_of_session(finished.findings)
        return finished

    def delete(self, session: str | Session) -> None:
        """Delete a session with everything in it."""
        self._ask("DeleteSession", name=name_of(session, names.SESSION))

    def post_anchors(self, session: str | Session, anchors: Iterable[NewAnchor]) -> builtins.list[Anchor]:
        """Post anchors of a session: places of points of the robot that the world outside tells.

        Any number, 200 in a call; those that the service has with the same content are passed over.
        """
        parent, made = name_of(session, names.SESSION), [one.message() for one in anchors]
        posted: builtins.list[Anchor] = []
        for start in range(0, len(made), ANCHORS_AT_ONCE):
            some: Any = made[start : start + ANCHORS_AT_ONCE]
            posted += map(Anchor.of, self._ask("PostAnchors", parent=parent, anchors=some).anchors)
        return posted

    def preview_anchors(self, session: str | Session, anchors: Iterable[NewAnchor]) -> Operation:
        """What anchors, at most 200, would do to the map: an operation that keeps nothing.

        Its result has `anchors` (name, state, reason and residual_m of each), `others` (as many of those that the map
        has and whose state would change, 100 at most), `georeferences`, `mean_change_m` and `max_change_m` (how far
        submaps would move).
        """
        made: Any = [one.message() for one in anchors]
        asked = self._ask("PreviewAnchors", parent=name_of(session, names.SESSION), anchors=made)
        return Operation.of(asked.operation)

    def anchors(self, session: str | Session) -> builtins.list[Anchor]:
        """The anchors of a session in the order in which they came, with the verdict of the version in force."""
        return self._list(Anchor, "ListAnchors", parent=name_of(session, names.SESSION))

    def delete_anchor(self, anchor: str | Anchor) -> None:
        """Delete an anchor; the map is optimised without it."""
        self._ask("DeleteAnchor", name=name_of(anchor, names.ANCHOR))

    def post_radio(
        self, session: str | Session, readings: Iterable[RadioReading], *, key: bytes | str | None = None
    ) -> int:
        """Post what the Wi-Fi of a robot heard, before the scans around it; how many readings the service had not yet.

        They tell twins of one plan apart. Addresses leave this program hashed with `key`, which all robots of a map
        must share; by default it is the name of the map, which hides them from a glance alone.
        Raises BadField for an empty key.
        """
        parent = name_of(session, names.SESSION)
        secret = parent.partition("/sessions/")[0] if key is None else key
        secret = secret.encode() if isinstance(secret, str) else secret
        if not secret:
            raise BadField("the key that hides addresses must not be empty", field="key")
        made, stored = [one.message(secret) for one in readings], 0
        for start in range(0, len(made), READINGS_AT_ONCE):
            some: Any = made[start : start + READINGS_AT_ONCE]
            stored += self._ask("PostRadio", parent=parent, readings=some).stored
        return stored

    def correction(self, session: str | Session) -> Correction:
        """Where the odometry frame of a session lies in the map.

        Raises FailedPrecondition (NOT_READY) where no version of the map has the session yet.
        """
        return Correction.of(self._ask("GetCorrection", name=name_of(session, names.SESSION)))
