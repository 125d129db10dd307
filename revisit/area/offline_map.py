"""A map file as a memory of places, for a robot without a link.

The answers are those of the service, up to what storing a neural map rounds: its places are made again from its neural
maps. Needs the extra `service`, which holds the method.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from revisit.area.conversation import AreaConversation, Method
from revisit.core.acceptance import LoopClaim, Station, StationInMap, accept_cloud, best_loop
from revisit.core.config import PipelineConfig
from revisit.core.errors import DescriptorModelMismatch
from revisit.core.geometry import se3
from revisit.core.geometry.se3 import Matrix4
from revisit.core.geometry.upright import levelling
from revisit.core.implicit_map import NeuralMap
from revisit.core.index import FaissIndex, IndexEntry, Match, SearchFilter
from revisit.core.model_bundle import ModelBundle
from revisit.core.pipeline import DescribedPlace, describe, describe_again, verify
from revisit.core.place import Place
from revisit.core.profiles import Profile, profile_config, profile_models
from revisit.core.scan import Scan
from revisit.core.submap import Submap
from revisit.formats.map_file import FiledSubmap, MapDescription, MapFile
from revisit.sdk.resources import Candidate, Localization, MapPose, SearchHit


class AreaMap:
    """A version of a map, or the part of it around a place, ready to be asked.

    Places are made from their neural maps when a search names them for the first time, and kept.
    """

    def __init__(self, file: MapFile, models: ModelBundle | None = None) -> None:
        """The models are by default those of the map's profile, of which the paper's take the extra `learned`.

        Raises DescriptorModelMismatch where the map was described by other models than those here.
        """
        self.file = file
        # Behind the version stands the scale of the map, which `config_of` takes from its own field.
        version = file.description.model_version.partition("@scale-")[0]
        profile = Profile.PAPER if version == profile_models(Profile.PAPER).version else Profile.PRODUCT
        self._models = models or profile_models(profile)
        if version != self._models.version:
            raise DescriptorModelMismatch(
                f"the map was described by {file.description.model_version}, here is {self._models.version}"
            )
        self._config = config_of(file.description, profile)
        self._places: dict[int, Place] = {}
        self._sessions = {
            name: number for number, name in enumerate(dict.fromkeys(one.session for one in file.submaps))
        }
        self._index: FaissIndex | None = None
        if file.submaps:
            self._index = FaissIndex(file.descriptors.shape[1])
            self._index.add([self._entry(row, one) for row, one in enumerate(file.submaps)], file.descriptors)

    @classmethod
    def open(cls, file: Path | str, models: ModelBundle | None = None) -> Self:
        """The map in a file. Raises MalformedBody, DataLoss, DescriptorModelMismatch."""
        return cls(MapFile.open(Path(file)), models)

    def search(self, points: NDArray[np.floating], *, k: int = 20, **criteria: Any) -> list[SearchHit]:
        """The submaps most like a cloud (n, 3) in metres, most similar first; `criteria` as in `localize`."""
        described = self._described(points, criteria.pop("T_level_query", None))
        return [self._hit(match) for match in self._recalled(described, k, **criteria)]

    def localize(
        self,
        points: NDArray[np.floating],
        *,
        candidates: int = 10,
        prior_position_m: tuple[float, float, float] | None = None,
        radius_m: float | None = None,
        only_session: str | None = None,
        T_level_query: Matrix4 | None = None,
    ) -> Localization:
        """Where in the map a cloud (n, 3) was taken; `best` is None where the place is unknown.

        As `Client.localize`, but that `prior_position_m` is in the map, not in the odometry frame of a session, and
        that candidates come without evidence. `only_session` is a session's name. Raises EmptyCloud, DegenerateCloud,
        DataLoss.
        """
        described = self._described(points, T_level_query)
        compared = max(candidates, self._config.loop.candidates)
        found = self._recalled(
            described, compared, prior_position_m=prior_position_m, radius_m=radius_m, only_session=only_session
        )
        claims = accept_cloud(
            [self._claim(described, match) for match in found], [self._in_map(match) for match in found], self._config
        )
        judged = [self._candidate(match, claim) for match, claim in zip(found, claims, strict=True)]
        best = best_loop(claims)
        if best is None or (T_match_query := judged[best].T_match_query) is None:
            return Localization(candidates=tuple(judged))
        submap = self.file.submaps[found[best].id]
        return Localization(
            best=judged[best],
            T_odom_query=submap.T_odom_submap @ T_match_query,
            session=submap.session,
            candidates=tuple(judged),
            in_map=self._map_pose(submap, submap.T_map_submap @ T_match_query),
        )

    def relocalise(self, *, only_session: str | None = None) -> AreaConversation:
        """A conversation about where in the map a robot is, that moves: see `Client.relocalise`.

        `only_session` is a session's name. Answers have poses in the map, and need no link.
        """
        method = Method(
            self._config,
            lambda submap: describe(submap, self._models, self._config),
            lambda described, count: self._recalled(described, count, only_session=only_session),
            self._place,
        )
        return AreaConversation(self.file, self._sessions, method)

    def close(self) -> None:
        """Let go of the file."""
        self.file.close()

    def __enter__(self) -> Self:
        """The map itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Let go of the file."""
        self.close()

    def _entry(self, row: int, submap: FiledSubmap) -> IndexEntry:
        # In its odometry, as in the service: what the index learns depends on which places lie near each other.
        return IndexEntry(row, self._sessions[submap.session], submap.ordinal, submap.T_odom_submap[:3, 3])

    def _near(self, position_m: tuple[float, float, float] | None, radius_m: float | None) -> frozenset[int] | None:
        """The submaps within a radius of a position in the map; None for all."""
        if position_m is None or radius_m is None:
            return None
        positions = np.array([one.T_map_submap[:3, 3] for one in self.file.submaps]).reshape(-1, 3)
        return frozenset(np.flatnonzero(np.linalg.norm(positions - position_m, axis=1) <= radius_m).tolist())

    def _described(self, points: NDArray[np.floating], T_level_query: Matrix4 | None) -> DescribedPlace:
        cloud = np.ascontiguousarray(points, dtype=np.float32)
        if T_level_query is None:
            T_level_query = levelling(cloud)
        scan = Scan.validated(cloud, se3.validated(T_level_query), 0)
        return describe(Submap.from_cloud(scan, self._config.submap), self._models, self._config)

    def _recalled(
        self,
        described: DescribedPlace,
        k: int,
        *,
        prior_position_m: tuple[float, float, float] | None = None,
        radius_m: float | None = None,
        only_session: str | None = None,
    ) -> list[Match]:
        where = SearchFilter(
            only_session=None if only_session is None else self._sessions.get(only_session, -1),
            allowed=self._near(prior_position_m, radius_m),
        )
        return [] if self._index is None else self._index.search(described.descriptor.vector, k, where)

    def _claim(self, described: DescribedPlace, match: Match) -> LoopClaim:
        """The claim that the cloud, which is of no drive and has no odometry, is a submap of the map."""
        submap = self.file.submaps[match.id]
        verdict = verify(described.place, self._place(match.id), match.similarity, self._config.verification)
        station = Station(self._sessions[submap.session], submap.ordinal, submap.T_odom_submap)
        return LoopClaim(Station(None, 0, np.eye(4)), station, verdict)

    def _in_map(self, match: Match) -> StationInMap:
        submap = self.file.submaps[match.id]
        return StationInMap(submap.frame, submap.T_map_submap)

    def _candidate(self, match: Match, claim: LoopClaim) -> Candidate:
        return Candidate(
            submap=self.file.submaps[match.id].name,
            accepted=claim.accepted,
            reason=None if claim.reason is None else claim.reason.value,
            similarity=match.similarity,
            score=claim.score,
            T_match_query=claim.T_match_query,
            evidence={},
        )

    def _place(self, row: int) -> Place:
        if row not in self._places:
            blob = self.file.neural_map(self.file.submaps[row])
            neural_map = NeuralMap.from_blob(blob, self._models.decoder, self._config.implicit_map)
            self._places[row] = describe_again(neural_map, self._models, self._config).place
        return self._places[row]

    def _hit(self, match: Match) -> SearchHit:
        submap = self.file.submaps[match.id]
        x, y, z = (float(value) for value in submap.T_odom_submap[:3, 3])
        in_map = self._map_pose(submap, submap.T_map_submap)
        return SearchHit(submap=submap.name, similarity=match.similarity, position_m=(x, y, z), in_map=in_map)

    def _map_pose(self, submap: FiledSubmap, T_map: Matrix4) -> MapPose:
        return MapPose(T_map, submap.frame, int(self.file.description.map_version))


def config_of(description: MapDescription, profile: Profile = Profile.PRODUCT) -> PipelineConfig:
    """The parameters of the method in a profile, with the overrides of the map."""
    rules = ("min_score", "min_overlap", "max_seen_through")
    return profile_config(profile).of_map(
        description.scene_scale,
        submap={"tau": description.tau_m, "stride": description.stride_m},
        loop={},
        verification={name: description.loop_policy.get(name) for name in rules},
    )
