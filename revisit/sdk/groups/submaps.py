"""Submaps, and searches for the places that they show."""

from __future__ import annotations

import builtins
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from revisit.sdk import names
from revisit.sdk.clouds import PointsLike
from revisit.sdk.groups.group import Group
from revisit.sdk.messages import cloud_of, pose_message, request_of, vector
from revisit.sdk.names import name_in_map, name_of
from revisit.sdk.resources import Localization, Map, Operation, SearchHit, Session, Submap
from revisit.v1 import submap_pb2


class Submaps(Group):
    """`client.submaps`."""

    def post(
        self, session: str | Session, submap_id: str, points: PointsLike, T_odom_submap: Any, stamp_ns: int
    ) -> Operation:
        """Store a submap, (n, 3) or (n, 4) points in its own frame; the operation that describes it."""
        posted = self._ask(
            "PostSubmap",
            parent=name_of(session, names.SESSION),
            submap_id=submap_id,
            t_odom_submap=pose_message(T_odom_submap, "T_odom_submap", required=True),
            stamp_ns=stamp_ns,
            cloud=cloud_of(points),
        )
        return replace(Operation.of(posted.operation), seq=posted.submap.seq)

    def get(self, name: str, *, full: bool = False) -> Submap:
        """Get `maps/{map}/sessions/{session}/submaps/{submap}`; with its descriptor where `full`."""
        view = "FULL" if full else None
        return Submap.of(self._ask("GetSubmap", name=name_of(name, names.SUBMAP), view=view))

    def list(self, session: str | Session) -> builtins.list[Submap]:
        """The submaps of a session in their order."""
        return self._list(Submap, "ListSubmaps", parent=name_of(session, names.SESSION))

    def delete(self, submap: str | Submap) -> None:
        """Delete a submap with its loop closures."""
        self._ask("DeleteSubmap", name=name_of(submap, names.SUBMAP))

    def download(self, submap: str | Submap, file_format: str = "ply") -> bytes:
        """A submap as a file: pcd, ply, npy, mesh, glb, neural or descriptor."""
        asked = {"name": name_of(submap, names.SUBMAP), "format": file_format.upper()}
        return self._transport.download("DownloadSubmap", request_of(submap_pb2.DownloadSubmapRequest, asked))

    def search(
        self,
        map_: str | Map,
        *,
        submap: str | Submap | None = None,
        points: PointsLike | None = None,
        descriptor: Sequence[float] | None = None,
        model_version: str = "",
        T_level_query: Any = None,
        k: int = 20,
        **criteria: Any,
    ) -> builtins.list[SearchHit]:
        """The submaps most like a submap, a cloud or a descriptor (give one), most similar first.

        `T_level_query` (4, 4): the pose of `points` in a frame with z up; its rotation turns them upright.

        `criteria`: min_similarity, exclude_session, only_session (a session, its name or id), leave_distance_m,
        prior_position_m with radius_m (in the frame of only_session), storey (where a cloud or descriptor was taken:
        sessions on another one are left out). `min_seq` (of an operation, a submap or a
        stream): the answer sees every submap up to it, or `DeadlineExceeded` is raised after `min_seq_timeout_s` (10 by
        default).
        """
        for field in ("exclude_session", "only_session"):
            if criteria.get(field) is not None:
                criteria[field] = name_in_map(map_, criteria[field])
        if criteria.get("prior_position_m") is not None:
            criteria["prior_position_m"] = vector(criteria["prior_position_m"])
        if submap is not None:
            criteria["submap"] = name_of(submap, names.SUBMAP)
        elif points is not None:
            level = pose_message(T_level_query, "T_level_query")
            criteria |= {"cloud": cloud_of(points), "t_level_query": level}
        else:
            of = {"vector": [float(value) for value in descriptor or ()], "model_version": model_version}
            criteria["place_descriptor"] = of
        found = self._ask("SearchSubmaps", parent=name_of(map_, names.MAP), k=k, **criteria)
        return [SearchHit.of(hit) for hit in found.hits]

    def localize(
        self,
        map_: str | Map,
        points: PointsLike,
        *,
        prior_position_m: Sequence[float] | None = None,
        radius_m: float | None = None,
        candidates: int = 10,
        exclude_session: str | Session | None = None,
        only_session: str | Session | None = None,
        T_level_query: Any = None,
        storey: str | None = None,
        **freshness: Any,
    ) -> Localization:
        """Where in the map a cloud was taken; `best` is None where the place is unknown.

        `T_level_query` (4, 4) is the cloud's pose in a frame with z up (from odometry or an IMU); its rotation
        turns the cloud upright. Without it the cloud's own surfaces tell the vertical, within 40 degrees of its z, or z
        does. `exclude_session` (a session, its name or id): a robot that asks with a place it has just posted finds its
        own submap else. `prior_position_m` is in the odometry frame of `only_session`, the only one that is searched.
        Sessions that are known to be on another `storey` are not compared. `freshness`: min_seq with min_seq_timeout_s,
        as in `search`.
        """
        found = self._ask(
            "Localize",
            parent=name_of(map_, names.MAP),
            cloud=cloud_of(points),
            prior_position_m=None if prior_position_m is None else vector(prior_position_m),
            radius_m=radius_m,
            candidates=candidates,
            exclude_session=None if exclude_session is None else name_in_map(map_, exclude_session),
            only_session=None if only_session is None else name_in_map(map_, only_session),
            t_level_query=pose_message(T_level_query, "T_level_query"),
            storey=storey,
            **freshness,
        )
        return Localization.of(found)
