"""`/v1/maps/{map}/sessions/{session}/submaps`."""

from __future__ import annotations

from enum import StrEnum
from functools import partial
from typing import Annotated

from fastapi import APIRouter, Depends, Query, Response

from revisit.service.application.access.callers import Scope
from revisit.service.application.catalogue.downloads import MEDIA_TYPES, DownloadKind
from revisit.service.application.contract import limits
from revisit.service.application.contract.identity import SubmapKey
from revisit.service.application.ingest.submap_posting import PostSubmap
from revisit.service.rest.access import allows
from revisit.service.rest.answers import Posted, Submap, SubmapPage, answer, answers, page_answer
from revisit.service.rest.bodies import ANY_BINARY, CLOUD_BODY
from revisit.service.rest.files import FileInPieces
from revisit.service.rest.parameters import Cases, Cloud, Paging, PoseOfSubmap, SessionOf, StampNs, SubmapOf, Tenant
from revisit.service.wire.answers import of_posted, of_submap

router = APIRouter(prefix="/v1/maps/{map_id}/sessions/{session_id}/submaps", tags=["submaps"])


class DownloadFormat(StrEnum):
    """Points as pcd, ply or npy; the surface as a ply mesh or as glb with meshopt; the neural map; the descriptor."""

    PCD = "pcd"
    PLY = "ply"
    NPY = "npy"
    MESH = "mesh"
    GLB = "glb"
    NEURAL = "neural"
    DESCRIPTOR = "descriptor"

    def what(self) -> tuple[DownloadKind, str | None]:
        """What the use case takes: the kind, and the file format where there is a choice."""
        if self in (DownloadFormat.PCD, DownloadFormat.PLY, DownloadFormat.NPY):
            return DownloadKind.POINTS, self.value
        if self is DownloadFormat.GLB:
            return DownloadKind.MESH, self.value
        return DownloadKind(self.value), None


class View(StrEnum):
    """How much of a submap is told."""

    BASIC = "BASIC"
    FULL = "FULL"


async def _job_admitted(cases: Cases, tenant: Tenant) -> None:
    """Before the body is read."""
    await cases.admission.precheck_job(tenant)


@router.post(
    "",
    **answers(Posted, 202),
    openapi_extra=CLOUD_BODY,
    dependencies=[allows(Scope.INGEST), Depends(_job_admitted)],
)
async def post_submap(
    key: SessionOf,
    submap_id: Annotated[str, Query(max_length=limits.ID_CHARACTERS)],
    stamp_ns: StampNs,
    T_odom_submap: PoseOfSubmap,
    cloud: Cloud,
    cases: Cases,
    tenant: Tenant,
) -> Response:
    """Store a submap durably and queue its description; wait for the operation of the answer."""
    command = PostSubmap(SubmapKey(key.map_id, key.session_id, submap_id), T_odom_submap, stamp_ns, cloud)
    posted = await cases.posting.post(tenant, command)
    return answer(Posted, of_posted(posted), 202, replay=posted.replay)


@router.get("", **answers(SubmapPage), dependencies=[allows(Scope.INGEST, Scope.QUERY)])
async def list_submaps(key: SessionOf, cases: Cases, tenant: Tenant, paging: Paging) -> Response:
    """List the submaps of a session in their order."""
    return await page_answer(SubmapPage, "submaps", await cases.submaps.list(tenant, key, paging), of_submap)


@router.get(
    "/{submap_id}:download",
    response_class=Response,
    responses={200: {"content": dict.fromkeys(MEDIA_TYPES.values(), ANY_BINARY), "description": "The file"}},
    dependencies=[allows(Scope.QUERY)],
)
async def download_submap(
    key: SubmapOf, cases: Cases, tenant: Tenant, file_format: Annotated[DownloadFormat, Query(alias="format")]
) -> Response:
    """Download a submap as a file."""
    kind, points_format = file_format.what()
    make = partial(cases.submaps.download, tenant, key, kind, points_format)
    return FileInPieces(cases.budget, tenant, make)


@router.get("/{submap_id}", **answers(Submap), dependencies=[allows(Scope.INGEST, Scope.QUERY)])
async def get_submap(key: SubmapOf, cases: Cases, tenant: Tenant, view: View = View.BASIC) -> Response:
    """Get a submap; FULL adds its descriptor."""
    return answer(Submap, of_submap(await cases.submaps.get(tenant, key, full=view is View.FULL)))


@router.delete("/{submap_id}", status_code=204, dependencies=[allows(Scope.ADMIN)])
async def delete_submap(key: SubmapOf, cases: Cases, tenant: Tenant) -> None:
    """Delete a submap, its loop closures and its place in the index."""
    await cases.submaps.delete(tenant, key)
