"""Settings: environment variables REVISIT_* and nothing else; the method's parameters are part of them."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, SecretStr
from pydantic_core import from_json
from pydantic_settings import NoDecode

from revisit.api.addresses import GRPC_ADDRESS
from revisit.core.config import PipelineConfig
from revisit.service.access_settings import AccessSettings
from revisit.service.capacity.limits import CapacityLimits, PaceLimits
from revisit.service.domain import limits
from revisit.service.domain.policy import Policy
from revisit.service.domain.retention import GRAMMAR, parsed
from revisit.service.features.upkeep.forgetting import ANSWERS_KEPT_S, EVENTS_KEPT

GROUPS: Mapping[str, tuple[str, ...]] = {
    "Addresses and access": (
        "host", "http_port", "grpc_port", "grpc_address", "metrics_port", "metrics_host", "allowed_hosts",
        "insecure_bind",
        "authentication", "tls_certificate", "tls_key", "client_ca", "client_certificates", "jwt", "secret",
        "webhook_private_networks",
    ),
    "Resources and limits": (
        "home", "database_url", "blob_url", "workers", "worker_memory_mb", "job_timeout_s", "max_queued_jobs",
        "tenant_storage_mb",
        "client_points_per_s", "streams_per_client", "reserve_mb",
    ),
    "Maps and loops": ("tau_m", "stride_m", "optimise_after_loops", "retention"),
    "Logs and traces": ("log_level", "hash_tenants_in_logs", "otlp_endpoint"),
}  # fmt: skip
"""The settings of an operator, as the reference page has them."""


class ForTests(BaseModel):
    """What tests alone set, to make an hour a second, as one JSON object.

    `recogniser`: the function that loads the method of a worker, as module:function. `lease_s`: a job is given to
    another worker after this silence. `max_attempts`: runs of a job before it fails. `jobs_per_worker`: jobs after
    which a worker is replaced. `drain_s`: time for requests and jobs to end on SIGTERM. `fail`: what happens at which
    failpoints of service/failpoints.py, as point=action@n.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    recogniser: str = "revisit.service.adapters.core_recogniser:load_recogniser"
    lease_s: float = Field(default=10.0, gt=0)
    max_attempts: int = Field(default=3, ge=1)
    jobs_per_worker: int = Field(default=500, ge=1)
    drain_s: float = Field(default=10.0, gt=0, le=15)
    fail: str = ""


def _parsed(value: Any) -> Any:
    """The JSON of a variable."""
    return from_json(value) if isinstance(value, str) else value


TENANT_TO_CLIENT = 2.0
"""Rate limit of a tenant, in those of its clients: two that send as fast as they may leave nothing to a third."""

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
    "tenant_points_per_s": f"a tenant has {TENANT_TO_CLIENT:g} times REVISIT_CLIENT_POINTS_PER_S",
    "leave_distance_m": "`leave_distance_m` of a map, else half of its tau_m",
    "loop_candidates": "`candidates` in the loop policy of a map",
    "loops_enough": f"{PipelineConfig().loop.enough} accepted loops that agree make further comparisons needless",
    "min_score": "`min_score` in the loop policy of a map",
    "min_overlap": "`min_overlap` in the loop policy of a map",
    "max_seen_through": "`max_seen_through` in the loop policy of a map",
    "jwt_issuer": "`issuer` in the file that REVISIT_JWT names",
    "jwt_audience": "`audience` in the file that REVISIT_JWT names",
    "jwt_keys": "`keys` in the file that REVISIT_JWT names",
    "jwt_tenant_claim": "`tenant_claim` in the file that REVISIT_JWT names",
    "jwt_max_lifetime_s": "`max_lifetime_s` in the file that REVISIT_JWT names",
    **dict.fromkeys(ForTests.model_fields, "it is a member of REVISIT_FOR_TESTS"),
}
"""Former settings, and what stands in the place of each."""


class Settings(AccessSettings):
    """How this installation runs. Field `http_port` is the variable REVISIT_HTTP_PORT, and so on."""

    home: Path = Field(default=Path("data"), description="directory of the database and the blobs")
    database_url: str = Field(
        default="",
        repr=False,
        description="the PostgreSQL database of the state, as postgresql://user:password@host:5432/name, which "
        "gateways and workers of several machines share (extra `cluster`); unset for a SQLite file in `home`",
    )
    blob_url: str = Field(
        default="",
        pattern=r"^(s3://[^/\s?#]+(/[^\s?#]*)?)?$",
        description="where blobs are stored: s3://bucket/prefix, with the usual AWS_* variables; in `home` by default",
    )
    http_port: int = Field(default=8080, ge=0, le=65535, description="REST port; 0 takes a free one")
    grpc_port: int = Field(default=8090, ge=0, le=65535, description="gRPC port; 0 takes a free one")
    grpc_address: str = Field(
        default="",
        pattern=f"^({GRPC_ADDRESS})?$",
        description="where clients reach gRPC behind a proxy or a published port: HOST:PORT, or grpcs://HOST:PORT for "
        "TLS; clients that know the HTTP address alone are told; unset for `grpc_port` on the host of that address",
    )
    metrics_port: int | None = Field(
        default=None, ge=0, le=65535, description="port of /metrics; unset for none, 0 takes a free one"
    )
    metrics_host: str = Field(
        default="127.0.0.1",
        description="address of /metrics, which asks for no credential: another than 127.0.0.1 belongs into a network "
        "that only Prometheus reaches",
    )
    allowed_hosts: str = Field(
        default="",
        description="names, separated by commas, under which HTTP clients may address the service beside localhost, "
        "IP addresses and `host`; * for any",
    )
    workers: int = Field(
        default_factory=lambda: max(1, (os.cpu_count() or 2) - 1), ge=0, le=256, description="worker processes"
    )
    max_queued_jobs: int = Field(
        default=1000, ge=1, description="limit of a tenant's backlog (waiting jobs); posts beyond it are refused"
    )
    tenant_storage_mb: int | None = Field(
        default=None,
        ge=1,
        description="room (MiB) for the clouds of one tenant, at 12 bytes a point whatever they take on the disk, and "
        "its anchors and readings of radio, at 720 bytes, and the pictures of its plans; further ones of them are "
        "refused with QUOTA; unset for no limit",
    )
    client_points_per_s: float = Field(
        default=10e6, gt=0, description="rate limit of one API key, points a second; a tenant has twice as much"
    )
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
    retention: str = Field(
        default="",
        max_length=limits.POLICY_CHARACTERS,
        description=f"what maps without a policy of their own keep, in words separated by commas: {GRAMMAR}; empty for "
        "everything",
    )
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
    otlp_endpoint: str = Field(
        default="",
        pattern=r"^(https?://[^/\s]+)?$",
        description="where traces are sent, OTLP over gRPC, as http://host:port or https://host:port; none by default",
    )
    log_level: str = Field(default="INFO", description="DEBUG, INFO, WARNING or ERROR")
    hash_tenants_in_logs: bool = Field(
        default=False, description="log a hash (12 hex digits of SHA-256) in place of each tenant's and caller's name"
    )
    for_tests: Annotated[ForTests, NoDecode, BeforeValidator(_parsed)] = Field(
        default=ForTests(), description="JSON object of what tests alone set; see `ForTests` in service/settings.py"
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

    secret: SecretStr | None = Field(
        default=None,
        min_length=32,
        description="at least 32 random characters, the same for all gateways of a service: what one of them signs, "
        "the others take; unset: a file in `home`, for one gateway",
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
        return Policy(
            pipeline=replace(
                pipeline,
                submap=replace(pipeline.submap, tau=self.tau_m, stride=self.stride_m),
                loop=replace(pipeline.loop, leave_distance=self.tau_m / 2),
            ),
            max_queued_jobs=self.max_queued_jobs,
            max_attempts=self.for_tests.max_attempts,
            lease_ms=int(self.for_tests.lease_s * 1000),
            tenant_storage_bytes=None if self.tenant_storage_mb is None else self.tenant_storage_mb * 2**20,
            optimise_after_loops=self.optimise_after_loops,
            webhook_private_networks=self.webhook_private_networks,
            retention=parsed(self.retention),
        )

    @property
    def capacity(self) -> CapacityLimits:
        """The rate limits, and how many streams a client may have."""
        return CapacityLimits(
            tenant_points_per_s=TENANT_TO_CLIENT * self.client_points_per_s,
            client_points_per_s=self.client_points_per_s,
            client_streams=self.streams_per_client,
        )

    @property
    def host_names(self) -> frozenset[str]:
        """The names that a Host header may carry beside localhost and IP addresses, lower case."""
        listed = {name.strip().lower() for name in self.allowed_hosts.split(",")}
        return frozenset((listed | {self.host.lower()}) - {""})
