"""TLS of both servers, 1.2 or newer; client certificates on the gRPC side."""

from __future__ import annotations

import ssl
from typing import TYPE_CHECKING

from revisit.service.access_settings import AccessSettings

if TYPE_CHECKING:
    import grpc


def http_context(settings: AccessSettings) -> ssl.SSLContext | None:
    """The context of the HTTP side, None without a certificate. Raises OSError where the files cannot be used."""
    if settings.tls_certificate is None:
        return None
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.load_cert_chain(settings.tls_certificate, settings.tls_key)
    return context


def grpc_credentials(settings: AccessSettings) -> grpc.ServerCredentials | None:
    """The credentials of the gRPC side (TLS 1.2 at least), None without a certificate. Raises OSError."""
    if settings.tls_certificate is None or settings.tls_key is None:
        return None
    import grpc

    authorities = None if settings.client_ca is None else settings.client_ca.read_bytes()
    pair = (settings.tls_key.read_bytes(), settings.tls_certificate.read_bytes())
    return grpc.ssl_server_credentials([pair], authorities, require_client_auth=authorities is not None)


def expiry_s(settings: AccessSettings) -> float | None:
    """When the certificate of both servers expires, seconds since 1970; None without one. Raises ValueError."""
    if settings.tls_certificate is None:
        return None
    from cryptography import x509

    return x509.load_pem_x509_certificate(settings.tls_certificate.read_bytes()).not_valid_after_utc.timestamp()
