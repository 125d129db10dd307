"""The stored places of a map, as a conversation asks for them: alike, and around a position."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from revisit.core.acceptance import StationInMap
from revisit.core.config import PipelineConfig
from revisit.core.geometry.se3 import pose_matrix
from revisit.core.pair_verdict import InitialPose, PairVerdict
from revisit.core.relocalisation import PossiblePose
from revisit.core.relocalisation.looking import StoredPlace
from revisit.service.domain.identity import TenantId
from revisit.service.domain.records import MapRecord, SubmapRecord
from revisit.service.features.graph.session_poses import PackedSubmaps
from revisit.service.features.index.comparison import Comparison
from revisit.service.features.index.place_memory import PlaceMemory, RecalledPlace
from revisit.service.features.loops.claims import station
from revisit.service.features.recognition.stations import stations_in_map
from revisit.service.features.relocalisation.rules import ToldPose
from revisit.service.ports.index import VectorFilter
from revisit.service.ports.recogniser import SubmapDescription
from revisit.service.ports.storage import require_descriptor
from revisit.service.ports.transactions import Transactions, UnitOfWork

SESSIONS = "/sessions/"
"""Stands in the name of a frame that is a session's own."""

NEAREST = 40
"""So many places around a position are read."""


@dataclass(frozen=True)
class _Placed:
    """The submaps of a version of a map: numbers (n,), sessions (n,), positions (n, 3), and the frame of each."""

    of: tuple[TenantId, str, int]
    numbers: NDArray[np.int64]
    sessions: NDArray[np.int64]
    positions: NDArray[np.float64]
    frames: NDArray[np.str_]


class MapPositions:
    """Where the submaps of a map lie in its version in force; those of one version are kept."""

    def __init__(self, transactions: Transactions) -> None:
        self.transactions = transactions
        self._kept: _Placed | None = None
        self._lock = threading.Lock()

    def of(self, record: MapRecord) -> _Placed:
        """Those of a map, as its record names the version."""
        of = record.tenant, record.map_id, record.map_version
        with self._lock:
            if self._kept is None or self._kept.of != of:
                self._kept = self.transactions.read(partial(_read, of=of)).result()
            return self._kept


class StoredPlaces:
    """See `core.relocalisation.looking.MapOfPlaces`: the places of a map, and one described view."""

    def __init__(
        self,
        map_record: MapRecord,
        where: VectorFilter,
        view: SubmapDescription,
        config: PipelineConfig,
        memory: PlaceMemory,
        comparison: Comparison,
        positions: MapPositions,
    ) -> None:
        """Only submaps of `where` are told of."""
        self._map = map_record
        self._where = where
        self._view = view
        self._config = config
        self._memory = memory
        self._comparison = comparison
        self._positions = positions
        self._records: dict[int, SubmapRecord] = {}
        self._sessions: dict[str, int] = {}
        self.on_other_storeys = 0

    def alike(self, count: int) -> Sequence[StoredPlace]:
        """See MapOfPlaces."""
        recall = self._memory.recall(self._map, self._view.descriptor, count, lambda _: self._where)
        self.on_other_storeys = recall.on_other_storeys
        return self._stored([one.submap for one in recall.places])

    def around(self, frame: str, position_m: NDArray[np.float64], within_m: float) -> Sequence[StoredPlace]:
        """See MapOfPlaces; in the frame of a session that the map does not place, by its odometry."""
        session = self._session(frame)
        if session is None:
            return self._around_in_map(frame, position_m, within_m)
        x, y, z = (float(value) for value in position_m)
        near = replace(self._where, only_session=session, position_m=(x, y, z), radius_m=within_m)
        recall = self._memory.recall(self._map, self._view.descriptor, NEAREST, lambda _: near)
        return self._stored([one.submap for one in recall.places])

    def verify(self, place: StoredPlace, initial: InitialPose | None) -> PairVerdict:
        """See MapOfPlaces."""
        submap = self._records[place.key]
        similarity = float(self.descriptor(place) @ self._view.descriptor)
        return self._comparison.verify(self._view.place, RecalledPlace(submap, similarity), self._config, initial)

    def descriptor(self, place: StoredPlace) -> NDArray[np.float32]:
        """See MapOfPlaces."""
        return np.frombuffer(require_descriptor(self._records[place.key]), dtype="<f4")

    def told(self, pose: PossiblePose) -> ToldPose:
        """A pose as a client sees it."""
        if self._session(pose.frame) is not None:
            return ToldPose(pose, pose.frame, None)
        return ToldPose(pose, None, self._map.map_version)

    def _around_in_map(self, frame: str, position_m: NDArray[np.float64], within_m: float) -> Sequence[StoredPlace]:
        placed = self._positions.of(self._map)
        apart_m = np.linalg.norm(placed.positions - position_m, axis=1)
        rows = np.flatnonzero((apart_m <= within_m) & (placed.frames == frame) & self._allowed(placed.sessions))
        numbers = placed.numbers[rows[np.argsort(apart_m[rows], kind="stable")][:NEAREST]].tolist()
        missing = [number for number in numbers if number not in self._records]
        if missing:
            read = partial(_numbered, tenant=self._map.tenant, numbers=missing)
            self._records |= self._positions.transactions.read(read).result()
        return self._stored([self._records[number] for number in numbers if number in self._records])

    def _session(self, frame: str) -> int | None:
        """The number of the session whose odometry frame this is; None for a frame of the map."""
        _, of_session, session_id = frame.partition(SESSIONS)
        if not of_session:
            return None
        if frame not in self._sessions:
            read = partial(_session_number, record=self._map, session_id=session_id)
            self._sessions[frame] = self._positions.transactions.read(read).result()
        return self._sessions[frame]

    def _allowed(self, sessions: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Which submaps, by their sessions (n,), may be compared."""
        where, allowed = self._where, np.ones(len(sessions), dtype=bool)
        if where.only_sessions is not None:
            allowed &= np.isin(sessions, list(where.only_sessions))
        if where.only_session is not None:
            allowed &= sessions == where.only_session
        if where.exclude_session is not None:
            allowed &= sessions != where.exclude_session
        return allowed

    def _stored(self, submaps: Sequence[SubmapRecord]) -> list[StoredPlace]:
        self._records |= {one.number: one for one in submaps}
        in_map = stations_in_map(self._positions.transactions, submaps, self._map)
        return [self._place(one, there) for one, there in zip(submaps, in_map, strict=True)]

    def _place(self, submap: SubmapRecord, in_map: StationInMap | None) -> StoredPlace:
        if in_map is not None:
            return StoredPlace(submap.number, station(submap), in_map)
        frame = submap.key.session.name
        self._sessions[frame] = submap.session_number
        own = StationInMap(frame, pose_matrix(submap.T_odom_submap))
        return StoredPlace(submap.number, station(submap), own, placed=False)


def _session_number(uow: UnitOfWork, record: MapRecord, session_id: str) -> int:
    """The number of a session; one that no submap has where it is gone."""
    session = uow.sessions.get(record.tenant, record.map_id, session_id)
    return 0 if session is None else session.number


def _numbered(uow: UnitOfWork, tenant: TenantId, numbers: Sequence[int]) -> dict[int, SubmapRecord]:
    return uow.submaps.numbered(tenant, numbers)


def _read(uow: UnitOfWork, of: tuple[TenantId, str, int]) -> _Placed:
    tenant, map_id, version = of
    rows = uow.session_poses.find(tenant, map_id=map_id, version=version) if version else []
    packed = [PackedSubmaps.of(row.submaps) for row in rows]
    counts = [len(one.numbers) for one in packed]
    return _Placed(
        of,
        np.concatenate([np.zeros(0, np.int64), *(one.numbers for one in packed)]),
        np.repeat([row.session_number for row in rows], counts).astype(np.int64),
        np.concatenate([np.zeros((0, 3)), *(one.T_map_submap[:, :3, 3] for one in packed)]),
        np.repeat(np.array([row.frame for row in rows], dtype=np.str_), counts),
    )
