"""A view is compared: with the places most like it, and with those stored where the hypotheses expect it."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from revisit.core.acceptance import LoopClaim, Station, StationInMap, accept_cloud
from revisit.core.config import PipelineConfig
from revisit.core.geometry import se3
from revisit.core.geometry.se3 import Matrix4
from revisit.core.pair_verdict import Authority, InitialPose, PairVerdict, VerifiedLoop
from revisit.core.relocalisation.answer import PossiblePose, RelocalisationAnswer
from revisit.core.relocalisation.conversation import Relocalisation, View
from revisit.core.relocalisation.telling_apart import ASKED, REACH_M, Surroundings, tells_apart

EXPECTED = 6
"""Of so many hypotheses, the heaviest, the expected place is compared."""

FEW = 10
"""So many of the places most like a view are compared, and the others once a pair of these passes at a new pose."""

NEAR_M = 8.0
"""A place stored within so many metres of where a hypothesis puts a view must show what the view shows."""


@dataclass(frozen=True)
class StoredPlace:
    """A described submap of a map, by a number of the map's own: where it lies on its drive and in the map.

    A place whose drive has no frame in the map lies in that of its drive, and is not `placed`.
    """

    key: int
    station: Station
    in_map: StationInMap
    placed: bool = True

    @property
    def position_m(self) -> NDArray[np.float64]:
        """Where it lies (3,) in its frame."""
        return np.asarray(self.in_map.T_map_submap[:3, 3])


class MapOfPlaces(Protocol):
    """The stored places of a map, and the view that is compared with them."""

    def alike(self, count: int) -> Sequence[StoredPlace]:
        """The places most like the view, most similar first."""
        ...

    def around(self, frame: str, position_m: NDArray[np.float64], within_m: float) -> Sequence[StoredPlace]:
        """Places within reach of a position (3,) in a frame of the map."""
        ...

    def verify(self, place: StoredPlace, initial: InitialPose | None) -> PairVerdict:
        """The verdict on the view, as the query, and a place."""
        ...

    def descriptor(self, place: StoredPlace) -> NDArray[np.float32]:
        """The descriptor (d,) of a place, a unit vector."""
        ...


def answered(
    conversation: Relocalisation, T_odom_view: Matrix4, travelled_m: float, places: MapOfPlaces, config: PipelineConfig
) -> RelocalisationAnswer:
    """The answer to one more view."""
    view = compared(conversation, T_odom_view, travelled_m, places, config)
    if not view.claims:
        return conversation.in_empty_map(travelled_m)
    answer = conversation.observe(view)
    if len(answer.poses) < 2:
        return answer
    around = [_surroundings(pose, places, config) for pose in answer.poses[:ASKED]]
    return replace(answer, tells_apart=tells_apart(around, config.scene_scale))


def compared(
    conversation: Relocalisation, T_odom_view: Matrix4, travelled_m: float, places: MapOfPlaces, config: PipelineConfig
) -> View:
    """The view with its claims, judged together as those of any single cloud.

    A loop is accepted where all candidates were compared, or where a loop was accepted before: else twins would hide.
    """
    stored = _expected_places(conversation, T_odom_view, places, config)
    alike = list(places.alike(config.loop.candidates))
    first = alike[:FEW] if conversation.has_begun else alike
    wanted = {place.key: place for place in [*first, *(one for one in stored if one is not None)]}
    starts = _Starts(conversation, T_odom_view, stored, {place.key for place in alike})
    verdicts = {key: places.verify(place, starts.of(key)) for key, place in wanted.items()}
    if any(_is_news(conversation, T_odom_view, wanted[key], one) for key, one in verdicts.items()):
        wanted |= {place.key: place for place in alike}
        verdicts |= {key: places.verify(wanted[key], starts.of(key)) for key in wanted if key not in verdicts}
    found = list(wanted.values())
    query = Station(None, 0, np.eye(4))
    claims = [LoopClaim(query, place.station, verdicts[place.key]) for place in found]
    judged = accept_cloud(claims, [place.in_map if place.placed else None for place in found], config)
    near = [one is not None for one in stored]
    return View(T_odom_view, travelled_m, judged, [place.in_map for place in found], near)


def _expected_places(
    conversation: Relocalisation, T_odom_view: Matrix4, places: MapOfPlaces, config: PipelineConfig
) -> list[StoredPlace | None]:
    """The place nearest to where each of the heaviest hypotheses, in order, puts a view; None where none is near."""
    expected = conversation.expected(T_odom_view)[:EXPECTED]
    near_m = NEAR_M * config.scene_scale
    return [_nearest(places, frame, T_frame_view[:3, 3], near_m) for frame, T_frame_view in expected]


def _is_news(conversation: Relocalisation, T_odom_view: Matrix4, place: StoredPlace, verdict: PairVerdict) -> bool:
    """Whether a pair passed at a pose at which no pair was accepted before."""
    if not isinstance(verdict, VerifiedLoop):
        return False
    T_frame_view = place.in_map.T_map_submap @ verdict.measurement.T_match_query
    return not conversation.knows(place.in_map.frame, T_frame_view, T_odom_view)


class _Starts:
    """Where registration begins: from where the heaviest hypothesis expects a place."""

    def __init__(
        self,
        conversation: Relocalisation,
        T_odom_view: Matrix4,
        stored: Sequence[StoredPlace | None],
        alike: Collection[int],
    ) -> None:
        self._alike = alike
        self._poses: dict[int, Matrix4] = {}
        for place, (_, T_frame_view) in zip(stored, conversation.expected(T_odom_view), strict=False):
            if place is not None and place.key not in self._poses:
                self._poses[place.key] = se3.inverse(place.in_map.T_map_submap) @ T_frame_view

    def of(self, key: int) -> InitialPose | None:
        """A place that is alike anyway may lie otherwise than a hypothesis expects: then it is a hint."""
        pose = self._poses.get(key)
        return pose if pose is None else InitialPose(pose, Authority.HINT if key in self._alike else Authority.COMPETES)


def _nearest(places: MapOfPlaces, frame: str, position_m: NDArray[np.float64], within_m: float) -> StoredPlace | None:
    """The place nearest to a position (3,) in a frame; None where none is stored within reach."""

    def apart_m(place: StoredPlace) -> float:
        return float(np.linalg.norm(place.position_m - position_m))

    found = [place for place in places.around(frame, position_m, within_m) if apart_m(place) <= within_m]
    return min(found, key=apart_m, default=None)


def _surroundings(pose: PossiblePose, places: MapOfPlaces, config: PipelineConfig) -> Surroundings:
    """The places around a pose that may be true."""
    reach_m = 1.2 * REACH_M * config.scene_scale
    found = places.around(pose.frame, pose.T_frame_view[:3, 3], reach_m)
    positions = np.array([place.position_m for place in found]).reshape(-1, 3)
    descriptors = np.array([places.descriptor(place) for place in found])
    return Surroundings(pose.T_frame_view, pose.probability, positions, descriptors)
