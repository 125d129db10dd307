"""The rules of an installation, and a map's overrides."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

from revisit.core.config import PipelineConfig, Profile
from revisit.core.errors import BadField, DataLoss
from revisit.core.profiles import profile_config
from revisit.service.domain.records import MapRecord
from revisit.service.domain.retention import KEEPS_ALL, RetentionPolicy, parsed

_MAPS_KEPT = 256
"""Sets of overrides whose parameters are kept: making them takes 0.13 ms, and a job asks for each loop."""

Overrides = tuple[float | int | None, ...]
"""tau_m, stride_m, leave_distance_m, loop_candidates, min_score, min_overlap and max_seen_through of a map."""


@dataclass(frozen=True)
class Policy:
    """The parameters of the method, the bounds of the job queue, and how much a tenant may store (None: no bound).

    A map is optimised `optimise_delay_ms` after `optimise_after_loops` accepted loops wait to be asked (0: only when
    somebody asks); its last `map_versions_kept` versions stay.
    With `webhook_private_networks`, webhooks may lead anywhere. `retention` is of maps without a policy of their own.
    """

    pipeline: PipelineConfig = field(default_factory=PipelineConfig)
    max_queued_jobs: int = 1000
    max_attempts: int = 3
    lease_ms: int = 10_000
    tenant_storage_bytes: int | None = None
    optimise_after_loops: int = 0
    optimise_delay_ms: int = 5000
    map_versions_kept: int = 20
    webhook_private_networks: bool = False
    retention: RetentionPolicy = KEEPS_ALL

    def kept_of(self, record: MapRecord) -> RetentionPolicy:
        """What a map keeps, by its own policy of retention or by that of the service.

        Raises DataLoss where the stored policy is none.
        """
        try:
            return self.retention if record.retention is None else parsed(record.retention)
        except BadField as error:
            raise DataLoss(f"the policy of retention of map {record.map_id!r} is damaged"[:200]) from error

    def for_map(self, record: MapRecord) -> PipelineConfig:
        """The parameters of the method in the profile of the map, with its overrides."""
        places = record.tau_m, record.stride_m, record.leave_distance_m, record.loop_candidates
        gates = record.min_score, record.min_overlap, record.max_seen_through
        return self._configs(Profile(record.profile), record.scene_scale, (*places, *gates))

    @cached_property
    def _configs(self) -> Callable[[Profile, float, Overrides], PipelineConfig]:
        """The parameters of a profile, a scene scale and overrides; the last ones are kept."""
        return lru_cache(maxsize=_MAPS_KEPT)(self._config)

    def _config(self, profile: Profile, scene_scale: float, overrides: Overrides) -> PipelineConfig:
        tau_m, stride_m, leave_distance_m, candidates, min_score, min_overlap, max_seen_through = overrides
        return profile_config(profile, self.pipeline).of_map(
            scene_scale,
            submap={"tau": tau_m, "stride": stride_m},
            loop={"leave_distance": leave_distance_m, "candidates": candidates},
            verification={
                "min_score": min_score,
                "min_overlap": min_overlap,
                "max_seen_through": max_seen_through,
            },
        )
