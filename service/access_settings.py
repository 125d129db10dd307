"""Settings of access to the service."""

from __future__ import annotations

import ipaddress
from pathlib import Path
from typing import Annotated, Any, Literal, Self
from urllib.parse import urlsplit

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator
from pydantic_core import from_json
from pydantic_settings import BaseSettings, NoDecode, SettingsConfigDict


class TokenIssuer(BaseModel):
    """Whose JSON Web Tokens are taken beside keys: `iss` and `aud` of a token, and the JWKS that it is verified with.

    `keys` is a file, or an https URL on the issuer's own host. The claim `tenant_claim` names the tenant. Tokens that
    expire more than `max_lifetime_s` from now are refused.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    issuer: str = Field(min_length=1)
    audience: str = Field(min_length=1)
    keys: str = Field(min_length=1)
    tenant_claim: str = Field(default="tenant", min_length=1)
    max_lifetime_s: float = Field(default=86400.0, gt=0)

    @model_validator(mode="after")
    def _require_pinned_keys(self) -> Self:
        url = urlsplit(self.keys)
        if "://" in self.keys and (url.scheme != "https" or url.netloc != urlsplit(self.issuer).netloc):
            raise ValueError("`keys` must be a file, or an https URL on the host of `issuer`")
        return self


def _content(value: Any) -> Any:
    """The JSON of a file that a variable names. Raises ValueError where there is none."""
    if not isinstance(value, (str, Path)):
        return value
    try:
        return from_json(Path(value).read_bytes())
    except OSError as error:
        raise ValueError(f"{value} cannot be read: {error.strerror}") from error


class AccessSettings(BaseSettings):
    """Addresses, TLS and credentials."""

    model_config = SettingsConfigDict(env_prefix="REVISIT_", frozen=True)

    host: str = Field(default="127.0.0.1", description="address that both servers listen on")
    insecure_bind: bool = Field(
        default=False,
        description="listen on an address that others can reach although TLS or credentials are missing; as long as no "
        "API key was ever created, anyone who reaches it can then read and change every map",
    )
    authentication: Literal["auto", "on"] = Field(
        default="auto",
        description="on: nobody gets in without a credential; auto: so too, from the first API key on, and wherever "
        "others can reach the address",
    )
    tls_certificate: Path | None = Field(
        default=None, description="PEM file with the certificate chain of both servers; TLS 1.2 or newer"
    )
    tls_key: Path | None = Field(default=None, description="PEM file with the private key of `tls_certificate`")
    client_ca: Path | None = Field(
        default=None, description="PEM file with the authorities of client certificates, which gRPC then demands"
    )
    client_certificates: Path | None = Field(
        default=None,
        description='JSON file that maps names (SAN) of client certificates to `{"tenant": ..., "scopes": [...]}`',
    )
    jwt: Annotated[TokenIssuer | None, NoDecode, BeforeValidator(_content)] = Field(
        default=None,
        description="JSON file about the tokens of an identity provider that are taken beside keys: "
        '`{"issuer": "https://...", "audience": ..., "keys": JWKS file or https URL of the issuer}`; optional '
        "`tenant_claim` (`tenant`) and `max_lifetime_s` (86400)",
    )

    @model_validator(mode="after")
    def _require_what_belongs_together(self) -> Self:
        if (self.tls_certificate is None) != (self.tls_key is None):
            raise ValueError("REVISIT_TLS_CERTIFICATE and REVISIT_TLS_KEY belong together")
        if self.client_ca is not None and self.tls_certificate is None:
            raise ValueError("REVISIT_CLIENT_CA needs REVISIT_TLS_CERTIFICATE")
        if self.client_certificates is not None and self.client_ca is None:
            raise ValueError("REVISIT_CLIENT_CERTIFICATES needs REVISIT_CLIENT_CA")
        return self

    @property
    def exposed(self) -> bool:
        """Whether the address can be reached from other machines."""
        if self.host == "localhost":
            return False
        try:
            return not ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return True

    @property
    def credential_required(self) -> bool:
        """Whether nobody gets in without a credential even before the first API key was created."""
        return self.authentication == "on" or (self.exposed and not self.insecure_bind)

    @property
    def knows_callers_without_keys(self) -> bool:
        """Whether tokens or client certificates are taken."""
        return self.jwt is not None or self.client_certificates is not None
