"""Dependencies of routes by type: the use cases, the tenant, pages, poses, keys, search criteria."""

from __future__ import annotations

from typing import Annotated, TypeAlias

from fastapi import Depends, Header, Path, Query
from starlette.requests import Request

from revisit.core.errors import BadField
from revisit.core.geometry import se3
from revisit.core.geometry.se3 import Matrix4
from revisit.service.domain import limits
from revisit.service.domain.callers import current_tenant
from revisit.service.domain.identity import SessionKey, SubmapKey, TenantId
from revisit.service.features.ingest.clouds import EncodedCloud
from revisit.service.rest.bodies import cloud_body, parse_numbers
from revisit.service.rest.schemas import IN_DIGITS, bounds
from revisit.service.use_cases import UseCases

POSE_HELP = "x,y,z,qx,qy,qz,qw: translation in metres and unit quaternion."

POINT_HELP = "x,y,z in metres."


async def _use_cases(request: Request) -> UseCases:
    use_cases: UseCases = request.app.state.use_cases
    return use_cases


async def _tenant() -> TenantId:
    # From the credential alone: `access.admitted` has verified it before.
    return current_tenant()


PATH_ID_CHARACTERS = 200
"""Characters of an id in a path, which may be no id."""

Id: TypeAlias = Annotated[str, Path(max_length=PATH_ID_CHARACTERS)]
Cases: TypeAlias = Annotated[UseCases, Depends(_use_cases)]
Tenant: TypeAlias = Annotated[TenantId, Depends(_tenant)]


async def _admitted_cloud(request: Request, cases: Cases, tenant: Tenant) -> EncodedCloud:
    """The body as a cloud; one that will be refused is not even read."""
    cases.admission.precheck_cloud(tenant)
    return await cloud_body(request)


Cloud: TypeAlias = Annotated[EncodedCloud, Depends(_admitted_cloud)]


async def _session_key(map_id: Id, session_id: Id) -> SessionKey:
    return SessionKey(map_id, session_id)


async def _submap_key(map_id: Id, session_id: Id, submap_id: Id) -> SubmapKey:
    return SubmapKey(map_id, session_id, submap_id)


SessionOf: TypeAlias = Annotated[SessionKey, Depends(_session_key)]
SubmapOf: TypeAlias = Annotated[SubmapKey, Depends(_submap_key)]
StampNs: TypeAlias = Annotated[int, Query(**bounds(limits.STAMP_NS)), IN_DIGITS]


def pose(text: str, field: str) -> Matrix4:
    """The (4, 4) transform of `x,y,z,qx,qy,qz,qw`. Raises BadField or BadTransform."""
    numbers = parse_numbers(text, 7, field, "x,y,z,qx,qy,qz,qw")
    return se3.from_quaternion(numbers[3:], numbers[:3])


async def _pose_of_submap(
    T_odom_submap: Annotated[str | None, Query(description=POSE_HELP, max_length=400)] = None,
    header: Annotated[str | None, Header(alias="T-Odom-Submap", description=POSE_HELP)] = None,
) -> Matrix4:
    return pose(_given(T_odom_submap, header, "T_odom_submap"), "T_odom_submap")


async def _pose_of_sensor(
    T_odom_sensor: Annotated[str | None, Query(description=POSE_HELP, max_length=400)] = None,
    header: Annotated[str | None, Header(alias="T-Odom-Sensor", description=POSE_HELP)] = None,
) -> Matrix4:
    return pose(_given(T_odom_sensor, header, "T_odom_sensor"), "T_odom_sensor")


def _given(query: str | None, header: str | None, field: str) -> str:
    if (query is None) == (header is None):
        raise BadField(f"give {field} once, as query parameter or as header", field=field)
    return query or header or ""


PoseOfSubmap: TypeAlias = Annotated[Matrix4, Depends(_pose_of_submap)]
PoseOfSensor: TypeAlias = Annotated[Matrix4, Depends(_pose_of_sensor)]
