"""Maps, and merging them."""

from __future__ import annotations

import builtins
from dataclasses import asdict
from typing import Any

from revisit.sdk import names
from revisit.sdk.earth import OnEarth
from revisit.sdk.groups.group import Group
from revisit.sdk.messages import pose_message
from revisit.sdk.names import name_of
from revisit.sdk.resources import (
    LoopPolicy,
    Map,
    MapMerge,
    MapRetention,
    MapVersion,
    Operation,
    RetentionPolicy,
    RetentionReport,
    Session,
)


def _sent(policy: RetentionPolicy | None) -> dict[str, Any] | None:
    """A policy as a request has it."""
    return None if policy is None else {name: one for name, one in asdict(policy).items() if one not in (None, "")}


class Maps(Group):
    """`client.maps`."""

    def create(
        self,
        map_id: str,
        *,
        display_name: str = "",
        tau_m: float | None = None,
        stride_m: float | None = None,
        leave_distance_m: float | None = None,
        scene_scale: float | None = None,
        loop_policy: LoopPolicy = LoopPolicy(),
        profile: str | None = None,
    ) -> Map:
        """Create a map; None is as the service is configured.

        `scene_scale` is the size of the scene compared with a street, e.g. 0.25 for rooms; `profile` is the form of the
        method that describes submaps, product or paper. Neither can be changed later.
        """
        created = self._ask(
            "CreateMap",
            map_id=map_id,
            display_name=display_name,
            tau_m=tau_m,
            stride_m=stride_m,
            leave_distance_m=leave_distance_m,
            scene_scale=scene_scale,
            profile=profile,
            loop_policy={name: value for name, value in asdict(loop_policy).items() if value is not None} or None,
        )
        return Map.of(created)

    def get(self, name: str) -> Map:
        """Get `maps/{map}`."""
        return Map.of(self._ask("GetMap", name=name_of(name, names.MAP)))

    def list(self) -> builtins.list[Map]:
        """All maps, oldest first."""
        return self._list(Map, "ListMaps")

    def delete(self, map_: str | Map) -> None:
        """Delete a map with everything in it."""
        self._ask("DeleteMap", name=name_of(map_, names.MAP))

    def retention(self, map_: str | Map) -> MapRetention:
        """The policy of retention of a map, and what the last run removed by it."""
        return MapRetention.of(self._ask("GetRetention", name=name_of(map_, names.MAP)))

    def set_retention(self, map_: str | Map, policy: RetentionPolicy | None) -> MapRetention:
        """Give a map a policy of its own; None: that of the service. What it removes does not come back."""
        asked = self._ask("SetRetention", name=name_of(map_, names.MAP), policy=_sent(policy))
        return MapRetention.of(asked)

    def preview_retention(self, map_: str | Map, policy: RetentionPolicy | None = None) -> RetentionReport:
        """What a policy, None: that of the map, would remove now."""
        asked = self._ask("PreviewRetention", name=name_of(map_, names.MAP), policy=_sent(policy))
        return RetentionReport.of(asked)

    def optimise(self, map_: str | Map) -> Operation:
        """Optimise the pose graph of a map: the operation that makes a new version, or the waiting one."""
        return Operation.of(self._ask("OptimiseMap", name=name_of(map_, names.MAP)))

    def revert(self, map_: str | Map, version: int) -> MapVersion:
        """Bring back the poses of an earlier version, bit for bit, as a new version."""
        return MapVersion.of(self._ask("RevertMap", name=name_of(map_, names.MAP), version=version))

    def merge(
        self,
        map_: str | Map,
        source: str | Map | Session,
        *,
        validate_only: bool = False,
        T_map_source: Any = None,
        radius_m: float | None = None,
    ) -> Operation:
        """Merge `source`, another map or a session of it, into a map: the operation that makes a new version.

        Its result has `verdict` MERGED, REFUSED (with `refusal`) or, with `validate_only`, MERGEABLE, and alignment and
        evidence. `T_map_source` (4, 4) is roughly where the frame of the source lies in that of the map.
        """
        asked = self._ask(
            "MergeMap",
            name=name_of(map_, names.MAP),
            source=name_of(source, names.MAP),
            validate_only=validate_only,
            radius_m=radius_m,
            t_map_source=pose_message(T_map_source, "T_map_source"),
        )
        return Operation.of(asked)

    def on_earth(self, map_: str | Map) -> dict[str, OnEarth]:
        """The frames of a map that anchors hold on earth, by name, in the version in force: none where none do.

        `on_earth(map)[found.in_map.frame].pose(found.in_map.T_map)` is latitude, longitude, altitude and heading of an
        answer.
        """
        name = name_of(map_, names.MAP)
        origin = Map.of(self._ask("GetMap", name=name)).origin
        versions = self._list(MapVersion, "ListMapVersions", parent=name)
        if origin is None:
            return {}
        at = (origin.latitude_deg, origin.longitude_deg, origin.altitude_m)
        held = [one for version in versions if version.in_force for one in version.summary.georeferences]
        return {one.frame: OnEarth(at, one.T_enu_map) for one in held}

    def merges(self, map_: str | Map) -> builtins.list[MapMerge]:
        """The merges into a map, oldest first, with the changes between the days."""
        return self._list(MapMerge, "ListMapMerges", parent=name_of(map_, names.MAP))

    def get_merge(self, name: str) -> MapMerge:
        """Get `maps/{map}/merges/{merge}`."""
        return MapMerge.of(self._ask("GetMapMerge", name=name_of(name, names.MERGE)))

    def revert_merge(self, merge: str | MapMerge) -> MapMerge:
        """Take the last merge into a map back: its copies are deleted, the poses from before it come back."""
        return MapMerge.of(self._ask("RevertMapMerge", name=name_of(merge, names.MERGE)))
