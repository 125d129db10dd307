"""A made-up fleet as the rows of a service: its sessions, its submaps and its loops, without clouds. Simulated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from revisit.core.geometry import se3
from revisit.core.geometry.se3 import pose_row, position_row
from revisit.core.pose_graph import LoopEdge
from revisit.service.application.contract.identity import SessionKey, TenantId
from revisit.service.application.contract.records import LoopRecord, MapRecord, SessionRecord, SubmapRecord
from revisit.service.application.contract.states import LoopEventKind
from revisit.service.application.mapping.loop_events import Change, add_loop
from tests.support.made_up_fleet import Fleet, fleet
from tests.support.records import TENANT, a_submap
from tests.support.service_world import World


@dataclass(frozen=True)
class FleetInService:
    """The fleet, and its map in the service; session `s0` of the fleet is `maps/{map_id}/sessions/s0`."""

    fleet: Fleet
    map_id: str

    @property
    def name(self) -> str:
        """Of the map."""
        return f"maps/{self.map_id}"

    def right(self) -> set[str]:
        """The names of the right loops."""
        return {f"{self.name}/loopClosures/{e.name}" for e in self.fleet.graph.loops if e.name.startswith("right")}

    def poses(self, listed) -> dict[str, np.ndarray]:
        """T_map_submap (n, 4, 4) by session of the poses that the service listed."""
        of_session: dict[str, list[np.ndarray]] = {}
        for pose in listed:
            of_session.setdefault(SessionKey(*pose.submap.split("/")[1:4:2]).session_id, []).append(pose.T_map_submap)
        return {session: np.stack(poses) for session, poses in of_session.items()}


def fleet_in(
    world: World, map_id: str, wrong_share: float = 0.0, seed: int = 3, tenant: TenantId = TENANT, **shape: int
) -> FleetInService:
    """Store a fleet as it would be after all its submaps were described and their loops accepted."""
    made = fleet(seed, wrong_share, **shape)
    world.context.transactions.write(lambda uow: _store(uow, made, map_id, tenant)).result()
    return FleetInService(made, map_id)


def _store(uow, made: Fleet, map_id: str, tenant: TenantId) -> None:
    uow.maps.add(MapRecord(tenant, map_id, "hash", "", 10.0, 5.0, None, "fake-1", 1))
    submaps: dict[tuple[str, int], SubmapRecord] = {}
    for trajectory in made.graph.trajectories:
        record = SessionRecord(
            tenant, map_id, trajectory.session, "hash", None, "ACTIVE", 0, len(trajectory), 0.0, 0.0, 1, None, 1, None
        )
        session = uow.sessions.add(record)
        for ordinal, T_odom_submap in enumerate(trajectory.T_odom_submap):
            submap = a_submap(
                f"{ordinal:03d}",
                ordinal,
                tenant,
                session.number,
                map_id=map_id,
                session_id=trajectory.session,
                state="DESCRIBED",
                cloud_sha256=None,
                T_odom_submap=pose_row(T_odom_submap),
                position_m=position_row(T_odom_submap[:3, 3]),
            )
            submaps[trajectory.session, ordinal] = uow.submaps.add(submap)
    for edge in made.graph.loops:
        add_loop(uow, _loop(edge, submaps), Change(LoopEventKind.VERIFIED, 1))


def _loop(edge: LoopEdge, submaps: dict[tuple[str, int], SubmapRecord]) -> LoopRecord:
    """As it is stored: the submap that came later is the query."""
    query, match, T_match_query = submaps[edge.query], submaps[edge.match], edge.T_match_query
    if query.number < match.number:
        query, match, T_match_query = match, query, se3.inverse(T_match_query)
    covariance = edge.covariance if query is submaps[edge.query] else edge.covariance_in_query
    return LoopRecord.between(
        query,
        match,
        loop_id=edge.name,
        state="ACCEPTED",
        reason=None,
        similarity=0.9,
        score=0.9,
        T_match_query=pose_row(T_match_query),
        evidence={"measurement": {"covariance": covariance.ravel().tolist()}},
        created_at_ns=1,
    )
