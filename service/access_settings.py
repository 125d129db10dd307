"""Settings of access to the service."""

from __future__ import annotations

import ipaddress
from pathlib import Path
from typing import Literal, Self
from urllib.parse import urlsplit

from pydantic import Field, model_validator
from pydantic_settings import BaseSettings, SettingsConfigDict


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
    jwt_issuer: str | None = Field(default=None, description="`iss` of the JSON Web Tokens that are taken beside keys")
    jwt_audience: str | None = Field(default=None, description="`aud` that a token must name")
    jwt_keys: str | None = Field(
        default=None, description="JWKS of the issuer: a file, or an https URL on the issuer's own host"
    )
    jwt_tenant_claim: str = Field(default="tenant", min_length=1, description="claim that names the tenant of a token")
    jwt_max_lifetime_s: float = Field(
        default=86400.0, gt=0, description="tokens that expire later than this from now are refused"
    )

    @model_validator(mode="after")
    def _require_what_belongs_together(self) -> Self:
        if (self.tls_certificate is None) != (self.tls_key is None):
            raise ValueError("REVISIT_TLS_CERTIFICATE and REVISIT_TLS_KEY belong together")
        if self.client_ca is not None and self.tls_certificate is None:
            raise ValueError("REVISIT_CLIENT_CA needs REVISIT_TLS_CERTIFICATE")
        if self.client_certificates is not None and self.client_ca is None:
            raise ValueError("REVISIT_CLIENT_CERTIFICATES needs REVISIT_CLIENT_CA")
        if len({value is None for value in (self.jwt_issuer, self.jwt_audience, self.jwt_keys)}) != 1:
            raise ValueError("REVISIT_JWT_ISSUER, REVISIT_JWT_AUDIENCE and REVISIT_JWT_KEYS belong together")
        if self.jwt_keys is not None and "://" in self.jwt_keys and not self._is_pinned(self.jwt_keys):
            raise ValueError("REVISIT_JWT_KEYS must be an https URL on the host of REVISIT_JWT_ISSUER")
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
        return self.jwt_issuer is not None or self.client_certificates is not None

    def _is_pinned(self, url: str) -> bool:
        return urlsplit(url).scheme == "https" and urlsplit(url).netloc == urlsplit(self.jwt_issuer or "").netloc
