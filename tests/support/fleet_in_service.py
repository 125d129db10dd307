"""A made-up fleet as the rows of a service: its sessions, its submaps and its loops, without clouds. Simulated."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from revisit.core.geometry import se3
from revisit.core.geometry.se3 import pose_row, position_row
from revisit.core.pose_graph.graph import LoopEdge, PoseGraph
from revisit.service.domain.identity import SessionKey, TenantId
from revisit.service.domain.records import LoopRecord, MapRecord, SessionRecord, SubmapRecord
from revisit.service.domain.states import LoopEventKind
from revisit.service.features.loops.rows import Change, add_loop
from revisit.service.ports.blobs import PLACE_BLOB, BlobStore
from tests.support.fake_recogniser import placed
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


def fleet_in_two(
    world: World, map_ids: tuple[str, str], seed: int = 3, tenant: TenantId = TENANT, **shape: int
) -> FleetInService:
    """Store a fleet without loops between its sessions: every second one in the second map. It is that of the first.

    Its submaps are described as `FakeRecogniser` tells places by their true poses.
    """
    made = fleet(seed, 0.0, **shape)
    parts = [tuple(one for row, one in enumerate(made.graph.trajectories) if row % 2 == half) for half in (0, 1)]
    for map_id, part in zip(map_ids, parts, strict=True):
        inside = [
            loop for loop in made.graph.loops if {loop.match.session, loop.query.session} <= {o.session for o in part}
        ]
        own = Fleet(PoseGraph.of(list(part), inside), {one.session: made.truth[one.session] for one in part})
        world.context.transactions.write(
            lambda uow, own=own, map_id=map_id: _store(uow, own, map_id, tenant, world.context.blobs)
        ).result()
    return FleetInService(made, map_ids[0])


def _described(blobs: BlobStore, tenant: TenantId, T_world_submap: np.ndarray) -> dict[str, object]:
    """The fields of a described submap at its true pose: places that are near each other look alike."""
    frequencies = np.random.default_rng(0).normal(0.0, 0.1, (32, 2))
    phases = frequencies @ T_world_submap[:2, 3]
    descriptor = np.concatenate([np.cos(phases), np.sin(phases)]).astype("<f4") / np.float32(np.sqrt(32.0))
    place_sha256 = blobs.put(tenant, PLACE_BLOB, placed(T_world_submap))
    return {"descriptor": descriptor.tobytes(), "place_sha256": place_sha256, "model_version": "fake-1"}


def slipped_fleet_in(
    world: World, map_id: str, tenant: TenantId = TENANT, *, with_places: bool = False, sessions: int = 2,
    steps: int = 1,
) -> FleetInService:  # fmt: skip
    """Store drives with right loops all along, of which `s1` has lost 5 m at its submap 30, or by even shares in so
    many `steps` that end there. See `fleet_in`.
    """

    def slipped(poses: np.ndarray) -> np.ndarray:
        shares = np.clip((np.arange(len(poses)) - 30 + steps) / steps, 0.0, 1.0)
        ways = [se3.from_yaw(0.0, (-5.0 * share, 0.0, 0.0)) for share in shares]
        return poses[29] @ np.stack(ways) @ se3.inverse(poses[29]) @ poses

    return _faulty_fleet_in(world, map_id, slipped, tenant, with_places=with_places, sessions=sessions)


def lengthened_fleet_in(world: World, map_id: str, factor: float) -> FleetInService:
    """Store two drives with right loops all along, of which `s1` states so many times its lengths. See `fleet_in`."""

    def lengthened(poses: np.ndarray) -> np.ndarray:
        motions = np.linalg.inv(poses[:-1]) @ poses[1:]
        motions[:, :3, 3] *= factor
        return np.stack(list(itertools.accumulate(motions, np.matmul, initial=poses[0])))

    return _faulty_fleet_in(world, map_id, lengthened)


def restarted_fleet_in(world: World, map_id: str) -> FleetInService:
    """Store two drives with right loops all along, of which `s1` begins anew at its submap 30. See `fleet_in`."""

    def restarted(poses: np.ndarray) -> np.ndarray:
        return np.concatenate([poses[:30], poses[0] @ se3.inverse(poses[30]) @ poses[30:]])

    return _faulty_fleet_in(world, map_id, restarted)


def lifted_fleet_in(world: World, map_id: str) -> FleetInService:
    """Store two drives with right loops all along, of which `s1` turns by 90 degrees at submap 30. See `fleet_in`."""

    def lifted(poses: np.ndarray) -> np.ndarray:
        turn = poses[30] @ se3.from_yaw(np.pi / 2.0) @ se3.inverse(poses[30])
        return np.concatenate([poses[:30], turn @ poses[30:]])

    return _faulty_fleet_in(world, map_id, lifted)


def _faulty_fleet_in(
    world: World, map_id: str, wrong: Callable[[np.ndarray], np.ndarray], tenant: TenantId = TENANT, *,
    with_places: bool = False, sessions: int = 2,
) -> FleetInService:  # fmt: skip
    """Store drives of which `s1` has another odometry, as `wrong` makes it of T_odom_submap (n, 4, 4)."""
    made = fleet(3, 0.0, sessions=sessions, submaps=60, per_pair=90)
    first, second, *others = made.graph.trajectories
    tracks = [first, replace(second, T_odom_submap=wrong(second.T_odom_submap)), *others]
    faulty = Fleet(PoseGraph.of(tracks, list(made.graph.loops)), made.truth)
    blobs = world.context.blobs if with_places else None
    world.context.transactions.write(lambda uow: _store(uow, faulty, map_id, tenant, blobs)).result()
    return FleetInService(faulty, map_id)


def fleet_in(
    world: World,
    map_id: str,
    wrong_share: float = 0.0,
    seed: int = 3,
    tenant: TenantId = TENANT,
    with_places: bool = False,
    **shape: int,
) -> FleetInService:
    """Store a fleet as it would be after all its submaps were described and their loops accepted.

    `with_places`: `FakeRecogniser` can compare them, by their true poses.
    """
    made = fleet(seed, wrong_share, **shape)
    blobs = world.context.blobs if with_places else None
    world.context.transactions.write(lambda uow: _store(uow, made, map_id, tenant, blobs)).result()
    return FleetInService(made, map_id)


def _store(uow, made: Fleet, map_id: str, tenant: TenantId, blobs: BlobStore | None = None) -> None:
    own = uow.maps.add(MapRecord(tenant, map_id, "hash", "", 10.0, 5.0, None, "fake-1", 1))
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
                stamp_ns=5_000_000_000 * (1 + ordinal),
            )
            if blobs is not None:
                submap = replace(submap, **_described(blobs, tenant, made.truth[trajectory.session][ordinal]))
            submaps[trajectory.session, ordinal] = uow.submaps.add(submap)
            if blobs is not None:
                uow.changes.record_described(own, submaps[trajectory.session, ordinal].number)
    for edge in made.graph.loops:
        add_loop(uow, loop_record(edge, submaps), Change(LoopEventKind.VERIFIED, 1))


def loop_record(edge: LoopEdge, submaps: dict[tuple[str, int], SubmapRecord]) -> LoopRecord:
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
