"""The rules of an installation, and what a map overrides of them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TypeVar

from revisit.core.config import PipelineConfig
from revisit.service.application.contract.records import MapRecord

N = TypeVar("N", int, float)


@dataclass(frozen=True)
class Policy:
    """The parameters of the method, the bounds of the job queue, and how much a tenant may store (None: no bound).

    A map is optimised `optimise_delay_ms` after `optimise_after_loops` accepted loops wait to be asked (0: only when
    somebody asks); its last `map_versions_kept` versions stay.
    """

    pipeline: PipelineConfig = field(default_factory=PipelineConfig)
    max_queued_jobs: int = 1000
    max_attempts: int = 3
    lease_ms: int = 10_000
    tenant_storage_bytes: int | None = None
    optimise_after_loops: int = 0
    optimise_delay_ms: int = 5000
    map_versions_kept: int = 20

    def for_map(self, record: MapRecord) -> PipelineConfig:
        """The parameters of the method with what the map overrides."""
        submap, loop, rules = self.pipeline.submap, self.pipeline.loop, self.pipeline.verification
        return replace(
            self.pipeline,
            scene_scale=record.scene_scale,
            submap=replace(
                submap,
                min_range=submap.min_range * record.scene_scale,
                tau=_given(record.tau_m, submap.tau),
                stride=_given(record.stride_m, submap.stride),
            ),
            loop=replace(
                loop,
                min_index_gap=_given(record.min_index_gap, loop.min_index_gap),
                candidates=_given(record.loop_candidates, loop.candidates),
            ),
            verification=replace(
                rules,
                min_score=_given(record.min_score, rules.min_score),
                min_overlap=_given(record.min_overlap, rules.min_overlap),
                max_seen_through=_given(record.max_seen_through, rules.max_seen_through),
            ),
        )


def _given(own: N | None, of_service: N) -> N:
    return of_service if own is None else own
