"""How callers are recognised in this context, out of its settings."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError

from revisit.api.scopes import Scope
from revisit.service.access_settings import AccessSettings
from revisit.service.domain.identity import TenantId, validated_id
from revisit.service.features.keys.admission import AccessRules, CertificateGrant

if TYPE_CHECKING:
    from revisit.service.ports.access import TokenVerifier


class _Grant(BaseModel):
    """An entry of the file of client certificates."""

    model_config = ConfigDict(extra="forbid")

    tenant: str
    scopes: frozenset[Scope]


def access_rules(settings: AccessSettings) -> AccessRules:
    """The rules. Raises ValueError where a file that they need cannot be used."""
    certificates = {} if settings.client_certificates is None else read_grants(settings.client_certificates)
    return AccessRules(settings.credential_required, _token_verifier(settings), certificates)


def read_grants(path: Path) -> dict[str, CertificateGrant]:
    """The grants by certificate name. Raises ValueError naming the file."""
    try:
        grants = TypeAdapter(dict[str, _Grant]).validate_json(path.read_bytes())
    except (OSError, ValidationError) as error:
        raise ValueError(f"{path} cannot be used: {error}") from error
    return {
        name: CertificateGrant(TenantId(validated_id(grant.tenant, "tenant")), grant.scopes)
        for name, grant in grants.items()
    }


def _token_verifier(settings: AccessSettings) -> TokenVerifier | None:
    issuer = settings.jwt
    if issuer is None:
        return None
    # Only where tokens are taken: the library is of no use otherwise.
    from revisit.service.adapters.tokens import IssuerKeys, JwtVerifier, fetch_https, read_file

    location = issuer.keys
    keys = IssuerKeys(lambda: fetch_https(location) if "://" in location else read_file(Path(location)))
    return JwtVerifier(
        keys,
        issuer=issuer.issuer,
        audience=issuer.audience,
        tenant_claim=issuer.tenant_claim,
        max_lifetime_s=issuer.max_lifetime_s,
    )
