"""The rules of an installation, and a map's overrides."""

from __future__ import annotations

from dataclasses import dataclass, field

from revisit.core.config import PipelineConfig, Profile
from revisit.core.profiles import profile_config
from revisit.service.domain.records import MapRecord
from revisit.service.domain.retention import KEEPS_ALL, RetentionPolicy, parsed


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
        """What a map keeps, by its own policy of retention or by that of the service."""
        return self.retention if record.retention is None else parsed(record.retention)

    def for_map(self, record: MapRecord) -> PipelineConfig:
        """The parameters of the method in the profile of the map, with its overrides."""
        return profile_config(Profile(record.profile), self.pipeline).of_map(
            record.scene_scale,
            submap={"tau": record.tau_m, "stride": record.stride_m},
            loop={"leave_distance": record.leave_distance_m, "candidates": record.loop_candidates},
            verification={
                "min_score": record.min_score,
                "min_overlap": record.min_overlap,
                "max_seen_through": record.max_seen_through,
            },
        )
