"""Loop closures, and the decisions of people on them."""

from __future__ import annotations

import builtins
from typing import Any

from revisit.sdk import names
from revisit.sdk.groups.group import Group
from revisit.sdk.messages import pose_message
from revisit.sdk.names import name_in_map, name_of
from revisit.sdk.resources import LoopClosure, LoopClosureEvent, LoopKeypoints, Map, Operation, Session, Submap


class Loops(Group):
    """`client.loops`."""

    def list(
        self,
        map_: str | Map,
        *,
        state: str | None = None,
        graph_state: str | None = None,
        session: str | Session | None = None,
        reason: str | None = None,
        **freshness: Any,
    ) -> builtins.list[LoopClosure]:
        """The loop closures of a map to rely on, oldest first: accepted, and not set aside by the map.

        Any of three filters asks for others in their place: `state` ACCEPTED, REJECTED, PROPOSED or ALL, `graph_state`
        IN_MAP, SET_ASIDE or UNCONNECTED (the map's verdict on an accepted loop), and the `reason` of a rejection, e.g.
        AMBIGUOUS. `session` (a session, its name or id) keeps the loops of its query submaps; NotFound where there is
        none. `freshness`: min_seq with min_seq_timeout_s, as in `Submaps.search`.
        """
        asked = {"state": None if state == "ALL" else state, "graph_state": graph_state, "reason": reason}
        reliable = state is None and not any(asked.values())
        if reliable:
            asked["state"] = "ACCEPTED"
        of_session = None if session is None else name_in_map(map_, session)
        parent = name_of(map_, names.MAP)
        found = self._list(LoopClosure, "ListLoopClosures", parent=parent, session=of_session, **asked, **freshness)
        return [loop for loop in found if not (reliable and loop.graph_state == "SET_ASIDE")]

    def get(self, name: str) -> LoopClosure:
        """Get `maps/{map}/loopClosures/{loop_closure}` with its evidence."""
        return LoopClosure.of(self._ask("GetLoopClosure", name=name_of(name, names.LOOP_CLOSURE)))

    def create(
        self, query: str | Submap, match: str | Submap, *, T_match_query: Any = None, note: str = ""
    ) -> Operation:
        """Store a loop closure that a person has found: the operation that verifies it, with the loop as subject.

        `T_match_query` (4, 4) is roughly how the two lie to each other: where registration starts. It chooses no pose:
        where others fit as well, the loop is AMBIGUOUS, and `accept` accepts it all the same.
        """
        proposed = self._ask(
            "CreateLoopClosure",
            parent="/".join(name_of(query, names.SUBMAP).split("/")[:2]),
            query=name_of(query, names.SUBMAP),
            match=name_of(match, names.SUBMAP),
            t_match_query=pose_message(T_match_query, "T_match_query"),
            note=note,
        )
        return Operation.of(proposed.operation)

    def accept(self, loop: str | LoopClosure, *, note: str = "") -> LoopClosure:
        """Accept a loop closure of any verdict; `note` says why."""
        return LoopClosure.of(self._ask("AcceptLoopClosure", name=name_of(loop, names.LOOP_CLOSURE), note=note))

    def reject(self, loop: str | LoopClosure, *, note: str = "") -> LoopClosure:
        """Reject a loop closure, so that the map does not rest on it; `note` says why."""
        return LoopClosure.of(self._ask("RejectLoopClosure", name=name_of(loop, names.LOOP_CLOSURE), note=note))

    def revert(self, loop: str | LoopClosure, *, note: str = "") -> LoopClosure:
        """Take back the last decision of a person on a loop closure."""
        return LoopClosure.of(self._ask("RevertLoopClosure", name=name_of(loop, names.LOOP_CLOSURE), note=note))

    def events(self, loop: str | LoopClosure) -> builtins.list[LoopClosureEvent]:
        """The history of a loop closure, oldest first."""
        parent = name_of(loop, names.LOOP_CLOSURE)
        return self._list(LoopClosureEvent, "ListLoopClosureEvents", parent=parent)

    def keypoints(self, loop: str | LoopClosure) -> LoopKeypoints:
        """The keypoints of both submaps, which look alike, and which of these the pose joins."""
        return LoopKeypoints.of(self._ask("GetLoopClosureKeypoints", name=name_of(loop, names.LOOP_CLOSURE)))
