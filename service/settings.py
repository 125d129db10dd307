"""Settings: environment variables REVISIT_* and nothing else; the method's parameters are part of them."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from pydantic import Field

from revisit.core.config import PipelineConfig
from revisit.service.access_settings import AccessSettings
from revisit.service.capacity.limits import CapacityLimits, PaceLimits
from revisit.service.domain import limits
from revisit.service.domain.policy import Policy
from revisit.service.features.upkeep.retention import ANSWERS_KEPT_S, EVENTS_KEPT

GROUPS: Mapping[str, tuple[str, ...]] = {
    "Addresses and access": (
        "host", "http_port", "grpc_port", "metrics_port", "allowed_hosts", "insecure_bind", "authentication",
        "tls_certificate", "tls_key", "client_ca", "client_certificates", "jwt_issuer", "jwt_audience", "jwt_keys",
        "jwt_tenant_claim", "jwt_max_lifetime_s", "webhook_private_networks",
    ),
    "Resources and limits": (
        "home", "workers", "worker_memory_mb", "job_timeout_s", "max_queued_jobs", "tenant_storage_mb",
        "client_points_per_s", "tenant_points_per_s", "streams_per_client", "reserve_mb",
    ),
    "Maps and loops": (
        "tau_m", "stride_m", "leave_distance_m", "loop_candidates", "loops_enough", "min_score", "min_overlap",
        "max_seen_through", "optimise_after_loops",
    ),
    "Logs and traces": ("log_level", "hash_tenants_in_logs", "otlp_endpoint"),
}  # fmt: skip
"""The settings of an operator, as the reference page has them."""

FOR_TESTS = ("recogniser", "lease_s", "max_attempts", "jobs_per_worker", "drain_s", "fail")
"""Settings for tests alone, to make an hour a second."""

GONE: Mapping[str, str] = {
    "device": "workers compute on the processor, by compiled code",
    "points_per_s": f"a service takes {CapacityLimits.points_per_s / 1e6:g} million points a second",
    "clouds_at_once": "four clouds are in flight for each core, and at least 8",
    "max_streams": f"a service has {CapacityLimits.streams} streams",
    "client_calls_per_s": f"{PaceLimits.client_calls_per_s:g} calls of a client begin a second",
    "tenant_calls_per_s": f"{PaceLimits.tenant_calls_per_s:g} calls of a tenant begin a second",
    "answers_kept_h": f"the answer of a query is kept for {ANSWERS_KEPT_S / 3600.0:g} h",
    "events_kept": f"{EVENTS_KEPT:,} events of a tenant are kept",
    "optimise_delay_s": f"loops settle for {Policy.optimise_delay_ms / 1000:g} s before an optimisation",
    "map_versions_kept": f"{Policy.map_versions_kept} versions of a map are kept",
}
"""Former settings, and the constant that stands in the place of each."""


class Settings(AccessSettings):
    """How this installation runs. Field `http_port` is the variable REVISIT_HTTP_PORT, and so on."""

    home: Path = Field(default=Path("data"), description="directory of the database and the blobs")
    http_port: int = Field(default=8080, ge=0, le=65535, description="REST port; 0 takes a free one")
    grpc_port: int = Field(default=8090, ge=0, le=65535, description="gRPC port; 0 takes a free one")
    metrics_port: int | None = Field(
        default=None, ge=0, le=65535, description="port of /metrics on 127.0.0.1; unset for none, 0 takes a free one"
    )
    allowed_hosts: str = Field(
        default="",
        description="names, separated by commas, under which HTTP clients may address the service beside localhost, "
        "IP addresses and `host`; * for any",
    )
    workers: int = Field(
        default_factory=lambda: max(1, (os.cpu_count() or 2) - 1), ge=0, le=256, description="worker processes"
    )
    recogniser: str = Field(
        default="revisit.service.adapters.core_recogniser:load_recogniser",
        description="the function that loads the method of a worker, as module:function",
    )
    lease_s: float = Field(default=10.0, gt=0, description="a job is given to another worker after this silence")
    max_attempts: int = Field(default=3, ge=1, description="runs of a job before it fails")
    max_queued_jobs: int = Field(
        default=1000, ge=1, description="limit of a tenant's backlog (waiting jobs); posts beyond it are refused"
    )
    tenant_storage_mb: int | None = Field(
        default=None,
        ge=1,
        description="room (MiB) for the clouds of one tenant, at 12 bytes a point whatever they take on the disk; "
        "further scans and submaps are refused with QUOTA; unset for no limit",
    )
    tenant_points_per_s: float = Field(default=20e6, gt=0, description="rate limit of one tenant, points a second")
    client_points_per_s: float = Field(default=10e6, gt=0, description="rate limit of one API key, points a second")
    streams_per_client: int = Field(default=8, ge=1, description="open streams of scans of one API key")
    webhook_private_networks: bool = Field(
        default=False,
        description="webhooks may lead to loopback, link-local and private addresses, and over plain HTTP: whoever "
        "may create one then reaches whatever this machine reaches",
    )
    optimise_after_loops: int = Field(
        default=1,
        ge=0,
        description="accepted loop closures that the pose graph of a map has not seen yet, from which on the map is "
        "optimised by itself, once they have settled for a few seconds; 0 for only when somebody asks",
    )
    jobs_per_worker: int = Field(default=500, ge=1, description="jobs after which a worker is replaced")
    job_timeout_s: float = Field(
        default=120.0,
        gt=0,
        description="CPU seconds after which a run of a job is ended; one that does nothing is ended after as many "
        "seconds of the wall clock, any other one after ten times as many",
    )
    worker_memory_mb: int = Field(
        default=4096,
        ge=256,
        description="memory (MiB) that a worker may take, its index included (4 KiB a submap of a small map); a job "
        "that needs more fails, and a worker that keeps three quarters of it between two jobs is replaced",
    )
    reserve_mb: int = Field(
        default=256,
        ge=0,
        description="room (MiB) that a file in `home` keeps for when the disk is full; clients' data is refused while "
        "that room is given up or less than a quarter of it is free beside it; 0 for none",
    )
    drain_s: float = Field(default=10.0, gt=0, le=15, description="time for requests and jobs to end on SIGTERM")
    otlp_endpoint: str = Field(
        default="",
        pattern=r"^(https?://[^/\s]+)?$",
        description="where traces are sent, OTLP over gRPC, as http://host:port or https://host:port; none by default",
    )
    log_level: str = Field(default="INFO", description="DEBUG, INFO, WARNING or ERROR")
    hash_tenants_in_logs: bool = Field(
        default=False, description="log a hash (12 hex digits of SHA-256) in place of each tenant's and caller's name"
    )
    fail: str = Field(
        default="",
        description="for tests: what happens at which failpoints of service/failpoints.py, as point=action@n",
    )
    tau_m: float = Field(
        default_factory=lambda: PipelineConfig().submap.tau,
        ge=limits.TAU_M.least,
        le=limits.TAU_M.most,
        description="metres per submap",
    )
    stride_m: float = Field(
        default_factory=lambda: PipelineConfig().submap.stride,
        ge=limits.STRIDE_M.least,
        le=limits.STRIDE_M.most,
        description="metres between submap starts",
    )
    leave_distance_m: float | None = Field(
        default=None,
        ge=limits.LEAVE_DISTANCE_M.least,
        le=limits.LEAVE_DISTANCE_M.most,
        description="metres that a drive must have been from a place, before it comes back, for a loop within it; half "
        "of tau_m by default; a map may have its own",
    )
    loop_candidates: int = Field(
        default_factory=lambda: PipelineConfig().loop.candidates,
        ge=limits.LOOP_CANDIDATES.least,
        le=limits.LOOP_CANDIDATES.most,
        description="submaps most alike that are verified for each new one; a map may have its own",
    )
    loops_enough: int = Field(
        default_factory=lambda: PipelineConfig().loop.enough,
        ge=0,
        le=limits.LOOP_CANDIDATES.most,
        description="accepted loops of a new submap that agree where another candidate lies, so that this one is not "
        "verified; 0: all candidates are",
    )
    min_score: float = Field(
        default_factory=lambda: PipelineConfig().verification.min_score,
        ge=limits.MIN_SCORE.least,
        le=limits.MIN_SCORE.most,
        description="smallest score of an accepted loop closure; a map may have its own",
    )
    min_overlap: float = Field(
        default_factory=lambda: PipelineConfig().verification.min_overlap,
        ge=limits.MIN_OVERLAP.least,
        le=limits.MIN_OVERLAP.most,
        description="smallest overlap of an accepted loop closure; a map may have its own",
    )
    max_seen_through: float = Field(
        default_factory=lambda: PipelineConfig().verification.max_seen_through,
        ge=limits.MAX_SEEN_THROUGH.least,
        le=limits.MAX_SEEN_THROUGH.most,
        description="largest share of what stands in either place that the other has looked through, of an accepted "
        "loop closure; a map may have its own",
    )

    @property
    def database(self) -> Path:
        """The SQLite file."""
        return self.home / "revisit.db"

    @property
    def blobs(self) -> Path:
        """The directory of the blobs."""
        return self.home / "blobs"

    @property
    def policy(self) -> Policy:
        """The rules that the use cases follow."""
        pipeline = PipelineConfig()
        submap = replace(pipeline.submap, tau=self.tau_m, stride=self.stride_m)
        loop = replace(
            pipeline.loop,
            leave_distance=self.tau_m / 2 if self.leave_distance_m is None else self.leave_distance_m,
            candidates=self.loop_candidates,
            enough=self.loops_enough,
        )
        verification = replace(
            pipeline.verification,
            min_score=self.min_score,
            min_overlap=self.min_overlap,
            max_seen_through=self.max_seen_through,
        )
        return Policy(
            pipeline=replace(pipeline, submap=submap, loop=loop, verification=verification),
            max_queued_jobs=self.max_queued_jobs,
            max_attempts=self.max_attempts,
            lease_ms=int(self.lease_s * 1000),
            tenant_storage_bytes=None if self.tenant_storage_mb is None else self.tenant_storage_mb * 2**20,
            optimise_after_loops=self.optimise_after_loops,
            webhook_private_networks=self.webhook_private_networks,
        )

    @property
    def capacity(self) -> CapacityLimits:
        """The rate limits, and how many streams a client may have."""
        return CapacityLimits(
            tenant_points_per_s=self.tenant_points_per_s,
            client_points_per_s=self.client_points_per_s,
            client_streams=self.streams_per_client,
        )

    @property
    def host_names(self) -> frozenset[str]:
        """The names that a Host header may carry beside localhost and IP addresses, lower case."""
        listed = {name.strip().lower() for name in self.allowed_hosts.split(",")}
        return frozenset((listed | {self.host.lower()}) - {""})
