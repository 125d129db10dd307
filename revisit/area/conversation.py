"""A conversation with a map file: as `Client.relocalise`, without a service."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from revisit.core.acceptance import Station, StationInMap
from revisit.core.config import PipelineConfig
from revisit.core.errors import DegenerateCloud, EmptyCloud
from revisit.core.geometry import se3
from revisit.core.index import Match
from revisit.core.pair_verdict import InitialPose, PairVerdict
from revisit.core.pipeline import DescribedPlace, verify
from revisit.core.place import Place
from revisit.core.relocalisation import PossiblePose, RelocalisationAnswer
from revisit.core.relocalisation.conversation import Relocalisation as Weighing
from revisit.core.relocalisation.looking import StoredPlace, answered
from revisit.core.relocalisation.view_window import ViewWindow
from revisit.core.scan import Points, validate_cloud
from revisit.core.submap import Submap
from revisit.formats.map_file import MapFile
from revisit.sdk.resources import MapPose, Relocalisation, RelocalisedPose, TellingDrive


@dataclass(frozen=True)
class Method:
    """The method over one map file: describes a submap, recalls the places most like it, and makes a stored place."""

    config: PipelineConfig
    describe: Callable[[Submap], DescribedPlace]
    recall: Callable[[DescribedPlace, int], Sequence[Match]]
    place: Callable[[int], Place]


class AreaConversation:
    """A conversation about where in a map file a robot is, that moves."""

    def __init__(self, file: MapFile, sessions: dict[str, int], method: Method) -> None:
        """`sessions`: the numbers of the sessions of the file, by name."""
        self._file = file
        self._sessions = sessions
        self._method = method
        self._window = ViewWindow(method.config.submap)
        self._weighing = Weighing(method.config)

    def see(self, points: NDArray[np.floating], T_odom_sensor: ArrayLike) -> Relocalisation:
        """As `Conversation.see`: points (n, 3) metres in the sensor frame, and its pose (4, 4) by odometry.

        Raises NonFinitePoints, EmptyCloud, BadTransform and the like for a scan that cannot be used; DataLoss.
        """
        cloud, _ = validate_cloud(np.ascontiguousarray(points, dtype=np.float32))
        return self._told(self._answer(cloud, se3.validated(T_odom_sensor)))

    def _answer(self, cloud: Points, T_odom_sensor: se3.Matrix4) -> RelocalisationAnswer:
        try:
            view = self._window.add(cloud, T_odom_sensor)
            described = self._method.describe(view.submap)
        except (DegenerateCloud, EmptyCloud):
            return self._weighing.lost(self._window.travelled_m)
        places = _FilePlaces(self._file, self._sessions, self._method, described)
        travelled_m = self._window.travelled_m
        return answered(self._weighing, view.T_odom_view, travelled_m, places, self._method.config)

    def _told(self, answer: RelocalisationAnswer) -> Relocalisation:
        drive = answer.tells_apart
        return Relocalisation(
            state=answer.state.value,
            reason=None if answer.reason is None else answer.reason.value,
            poses=tuple(self._pose(one) for one in answer.poses),
            none_of_them=answer.none_of_them,
            travelled_m=answer.travelled_m,
            tells_apart=None if drive is None else TellingDrive(**vars(drive)),
        )

    def _pose(self, one: PossiblePose) -> RelocalisedPose:
        version = int(self._file.description.map_version)
        return RelocalisedPose(
            in_map=MapPose(one.T_frame_view, one.frame, version),
            covariance=one.covariance,
            probability=one.probability,
            views=one.views,
            accepted=one.accepted,
            along_m=one.along_m,
        )


class _FilePlaces:
    """See `core.relocalisation.looking.MapOfPlaces`: the submaps of a map file, and one described view."""

    def __init__(self, file: MapFile, sessions: dict[str, int], method: Method, view: DescribedPlace) -> None:
        self._file = file
        self._sessions = sessions
        self._method = method
        self._view = view

    def alike(self, count: int) -> Sequence[StoredPlace]:
        """See MapOfPlaces."""
        return [self._stored(match.id) for match in self._method.recall(self._view, count)]

    def around(self, frame: str, position_m: NDArray[np.float64], within_m: float) -> Sequence[StoredPlace]:
        """See MapOfPlaces."""
        positions = np.array([one.T_map_submap[:3, 3] for one in self._file.submaps]).reshape(-1, 3)
        near = np.flatnonzero(np.linalg.norm(positions - position_m, axis=1) <= within_m).tolist()
        return [self._stored(row) for row in near if self._file.submaps[row].frame == frame]

    def verify(self, place: StoredPlace, initial: InitialPose | None) -> PairVerdict:
        """See MapOfPlaces."""
        similarity = float(self.descriptor(place) @ self._view.descriptor.vector)
        stored = self._method.place(place.key)
        return verify(self._view.place, stored, similarity, self._method.config.verification, initial)

    def descriptor(self, place: StoredPlace) -> NDArray[np.float32]:
        """See MapOfPlaces."""
        return np.asarray(self._file.descriptors[place.key])

    def _stored(self, row: int) -> StoredPlace:
        submap = self._file.submaps[row]
        station = Station(self._sessions[submap.session], submap.ordinal, submap.T_odom_submap)
        return StoredPlace(row, station, StationInMap(submap.frame, submap.T_map_submap))
