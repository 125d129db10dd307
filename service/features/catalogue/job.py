"""Meshes of submaps, made of their neural maps by a worker."""

from __future__ import annotations

import secrets
from functools import partial

from revisit.core.config import PipelineConfig
from revisit.service.domain.errors import StaleLease
from revisit.service.domain.identity import SubmapKey
from revisit.service.domain.records import JobRecord
from revisit.service.features.catalogue.downloads import mesh_file, require_neural_map
from revisit.service.ports.blobs import MESH_BLOB, NEURAL_MAP_BLOB, StoredBlob
from revisit.service.ports.job_context import JobContext
from revisit.service.ports.job_queue import Lease
from revisit.service.ports.recogniser import PlaceRecogniser
from revisit.service.ports.storage import discard, require_map, require_submap
from revisit.service.ports.transactions import UnitOfWork

MESH_NONCE_BYTES = 16
"""In front of each file, so that the same mesh made twice is two blobs, each deleted with its own answer."""


class MeshMaking:
    """Runs the jobs that make meshes; all calls block."""

    def __init__(self, context: JobContext, recogniser: PlaceRecogniser) -> None:
        """`recogniser` is the method."""
        self._context = context
        self._recogniser = recogniser

    def run(self, lease: Lease) -> None:
        """Make a mesh and hand its file over as a blob. Raises NotFound, NotReady, and the errors of the method."""
        job = lease.job
        neural_map, config = self._context.transactions.read(partial(self._asked, job=job)).result()
        mesh = self._recogniser.mesh(self._context.blobs.get(job.tenant, NEURAL_MAP_BLOB, neural_map), config)
        file = mesh_file(mesh, str(job.payload["format"]))
        sha256 = self._context.blobs.put(job.tenant, MESH_BLOB, secrets.token_bytes(MESH_NONCE_BYTES) + file)
        try:
            self._context.complete(lease, {"sha256": sha256, "bytes": len(file)})
        except StaleLease:  # nobody waits for it, or another worker makes it
            discard(self._context.blobs, StoredBlob(job.tenant, MESH_BLOB, sha256))
            raise

    def _asked(self, uow: UnitOfWork, job: JobRecord) -> tuple[str, PipelineConfig]:
        """The hash of the neural map that a mesh is made of, and the settings of its map."""
        key = SubmapKey(*(job.payload[name] for name in ("map_id", "session_id", "submap_id")))
        neural_map = require_neural_map(require_submap(uow, job.tenant, key))
        return neural_map, self._context.policy.for_map(require_map(uow, job.tenant, key.map_id))
