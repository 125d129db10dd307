"""Made-up anchors of a made-up fleet: fixes of a receiver on a mast, some of them reflected. Simulated."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import replace

import numpy as np

from revisit.core.geometry import geodesy, se3
from revisit.core.pose_graph.anchors import Anchor
from revisit.core.pose_graph.graph import Node
from revisit.core.pose_graph.optimisation import OptimisedGraph
from revisit.sdk import anchors as sdk
from revisit.service.domain.states import AnchorFrame, AnchorKind
from revisit.service.features.anchors.rules import NewAnchor
from tests.support.made_up_fleet import Fleet
from tests.support.records import TENANT

MAST = np.array([0.3, 0.0, 1.2])
"""The antenna in the frame of a submap, metres."""
JUMP_M = 30.0
ORIGIN = (48.1, 11.5, 520.0)
"""Of the world of a fleet on earth."""


def fixes(
    made: Fleet,
    seed: int,
    sigma_m: float,
    wrong_share: float = 0.0,
    street: int = 1,
    sessions: Iterable[str] | None = None,
) -> list[Anchor]:
    """A fix for each submap of a fleet, or of some sessions, less sure of the height; those called `wrong-` are
    reflected, by 30 m into one direction for `street` submaps on end.
    """
    rng, found = np.random.default_rng(seed), []
    for session in made.truth if sessions is None else sessions:
        poses = made.truth[session]
        wrong, angles = np.zeros(len(poses), dtype=bool), rng.uniform(0.0, 2.0 * np.pi, len(poses))
        for first in rng.permutation(len(poses) // street)[: round(wrong_share * len(poses) / street)]:
            wrong[street * first : street * (first + 1)] = True
        for k, T_world_submap in enumerate(poses):
            place = se3.apply(T_world_submap, MAST[None])[0] + sigma_m * rng.normal(size=3) * (1.0, 1.0, 1.5)
            if wrong[k]:
                place[:2] += JUMP_M * np.array([np.cos(angles[k // street]), np.sin(angles[k // street])])
            name = f"{'wrong' if wrong[k] else 'right'}-{session}-{k}"
            found.append(Anchor(name, Node(session, k), MAST, place, sigma_m**2 * np.diag([1.0, 1.0, 2.25])))
    return found


def right(anchors: Collection[Anchor]) -> list[Anchor]:
    """Those that are not reflected."""
    return [one for one in anchors if one.name.startswith("right")]


def error_m(made: Fleet, answer: OptimisedGraph) -> float:
    """Root mean square of the position errors in the world, metres, with no alignment but the answer's own."""
    (found,) = answer.georeferences
    placed = [se3.apply(found.T_world_map, answer.T_map_submap[one][:, :3, 3]) for one in made.truth]
    true = [poses[:, :3, 3] for poses in made.truth.values()]
    return float(np.sqrt(np.mean(np.sum((np.concatenate(placed) - np.concatenate(true)) ** 2, axis=1))))


def new_anchors(made: Fleet, session: str, sigma_m: float = 1.5) -> list[NewAnchor]:
    """The fixes of a session as a client has them: one in five reflected, positions on earth."""
    found = []
    for one in fixes(made, int(session[1:]), sigma_m, 0.2, sessions=(session,)):
        T_odom_submap = made.graph.by_session[session].T_odom_submap[one.node.ordinal]
        earth = tuple(geodesy.geodetic_of_enu(ORIGIN, one.place_world[None])[0].tolist())
        found.append(
            NewAnchor(
                one.name, AnchorKind.GNSS, AnchorFrame.WGS84, 1_000 * one.node.ordinal, earth,
                tuple(one.covariance.ravel().tolist()), tuple(MAST.tolist()), T_odom_submap,
            )
        )  # fmt: skip
    return found


def sent(one: NewAnchor) -> sdk.NewAnchor:
    """As the SDK has it."""
    return sdk.NewAnchor(
        one.anchor_id, one.kind.value, one.stamp_ns, np.reshape(one.covariance, (3, 3)), geodetic=one.position,
        offset_m=one.offset_m, T_odom_sensor=one.T_odom_sensor,
    )  # fmt: skip


def with_stamps(world, map_id: str = "town") -> None:
    """Each submap of a map has a time of its own."""

    def stamp(uow) -> None:
        for one in uow.submaps.find(TENANT, map_id=map_id):
            uow.submaps.replace(replace(one, stamp_ns=1_000 * one.ordinal))

    world.context.transactions.write(stamp).result()


def tags_beside(made: Fleet, session: str, each: int = 3) -> dict[str, np.ndarray]:
    """Places (3,) in the world of tags beside every third submap of a session, by their ids."""
    poses = made.truth[session][::each]
    return {f"tag36h11:{n}": se3.apply(T, np.array([[1.0, 2.5, 0.5]]))[0] for n, T in enumerate(poses)}


def seen_tags(made: Fleet, session: str, tags: dict[str, np.ndarray], sigma_m: float = 0.03) -> list[NewAnchor]:
    """A session's sightings of tags, each from the two submaps nearest to it, as a client has them."""
    rng, found = np.random.default_rng(int(session[1:])), []
    for tag, place in tags.items():
        off_m = np.linalg.norm(made.truth[session][:, :3, 3] - place, axis=1)
        for ordinal in np.argsort(off_m)[:2].tolist():
            point = se3.apply(se3.inverse(made.truth[session][ordinal]), place[None])[0] + sigma_m * rng.normal(size=3)
            found.append(
                NewAnchor(
                    f"{session}-{len(found)}", AnchorKind.FIDUCIAL, AnchorFrame.TAG, 1_000 * ordinal, (0.0, 0.0, 0.0),
                    tuple((sigma_m**2 * np.eye(3)).ravel().tolist()), tuple(point.tolist()),
                    made.graph.by_session[session].T_odom_submap[ordinal], tag=tag,
                )
            )  # fmt: skip
    return found
