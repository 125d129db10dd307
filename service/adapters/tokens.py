"""JSON Web Tokens of a pinned issuer: a fixed list of algorithms, and keys from nowhere but where the operator said."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import jwt
import structlog

from revisit.core.errors import RevisitError
from revisit.service.domain.errors import Unauthenticated
from revisit.service.domain.identity import TenantId, validated_id
from revisit.service.ports.access import TokenClaims

ALGORITHMS = ("RS256", "ES256", "EdDSA")
"""Signatures by a private key: a secret that both sides know could be made out of the public key."""

LEEWAY_S = 60.0
FETCH_TIMEOUT_S = 5.0
FETCH_AT_MOST_EVERY_S = 60.0
KEYS_ARE_FRESH_S = 600.0
MAX_JWKS_BYTES = 64 * 1024

_log = structlog.get_logger(__name__)


class IssuerKeys:
    """The issuer's public keys by id, fetched again when they are old or an unknown id shows up, at most once a minute.

    While the issuer does not answer, the keys known so far go on.
    """

    def __init__(self, fetch: Callable[[], bytes], now_s: Callable[[], float] = time.monotonic) -> None:
        """`fetch` gives the JWKS document; `now_s` is a monotonic clock."""
        self._fetch = fetch
        self._now_s = now_s
        self._keys: dict[str, jwt.PyJWK] = {}
        self._tried_at_s = float("-inf")
        self._lock = threading.Lock()

    def key(self, key_id: str) -> jwt.PyJWK | None:
        """The key with this id: looked up among the issuer's, never used as a name of anything else."""
        with self._lock:
            age_s = self._now_s() - self._tried_at_s
            if age_s > KEYS_ARE_FRESH_S or (key_id not in self._keys and age_s > FETCH_AT_MOST_EVERY_S):
                self._tried_at_s = self._now_s()
                self._refresh()
            return self._keys.get(key_id)

    def _refresh(self) -> None:
        try:
            keys = jwt.PyJWKSet.from_json(self._fetch().decode()).keys
        except (OSError, ValueError, httpx.HTTPError, jwt.PyJWTError) as error:
            _log.warning("issuer_keys_not_read", error=type(error).__name__)
            return
        self._keys = {str(key.key_id): key for key in keys if key.algorithm_name in ALGORITHMS}


class JwtVerifier:
    """`access_ports.TokenVerifier`."""

    def __init__(
        self, keys: IssuerKeys, *, issuer: str, audience: str, tenant_claim: str, max_lifetime_s: float
    ) -> None:
        """Takes tokens of `issuer` for `audience` that expire within `max_lifetime_s`."""
        self._keys = keys
        self._issuer = issuer
        self._audience = audience
        self._tenant_claim = tenant_claim
        self._max_lifetime_s = max_lifetime_s

    def verify(self, token: str, now_s: float) -> TokenClaims:
        """See `access_ports.TokenVerifier`: one message for every reason, which is for the issuer's own log."""
        try:
            claims = self._claims(token)
            self._require_times(claims, now_s)
            tenant = validated_id(str(claims[self._tenant_claim]), self._tenant_claim)
            scopes = frozenset(str(claims.get("scope", "")).split())
            return TokenClaims(TenantId(tenant), str(claims["sub"]), scopes)
        except (jwt.PyJWTError, RevisitError, KeyError, ValueError, TypeError, OverflowError) as error:
            raise Unauthenticated("the token is not valid here") from error

    def _claims(self, token: str) -> dict[str, Any]:
        header = jwt.get_unverified_header(token)
        key = self._keys.key(str(header.get("kid", "")))
        if key is None or header.get("alg") != key.algorithm_name:
            raise jwt.InvalidKeyError
        # Times are checked against the service's own clock below.
        unchecked = {"verify_exp": False, "verify_nbf": False, "verify_iat": False}
        options: Any = {"require": ["exp", "iss", "aud", "sub"], **unchecked}
        return jwt.decode(
            token,
            key,
            algorithms=[key.algorithm_name],
            issuer=self._issuer,
            audience=self._audience,
            options=options,
        )

    def _require_times(self, claims: dict[str, Any], now_s: float) -> None:
        expires_s, begins_s = float(claims["exp"]), float(claims.get("nbf", 0.0))
        if not begins_s - LEEWAY_S <= now_s < expires_s + LEEWAY_S:
            raise jwt.ExpiredSignatureError
        if expires_s > now_s + self._max_lifetime_s + LEEWAY_S:
            raise jwt.InvalidTokenError("the token lives too long")


def read_file(path: Path) -> bytes:
    """A JWKS document from a file. Raises OSError; ValueError where it is too large."""
    if path.stat().st_size > MAX_JWKS_BYTES:
        raise ValueError("the JWKS document is too large")
    return path.read_bytes()


def fetch_https(url: str, *, verify: Any = True) -> bytes:
    """A JWKS document over https: 5 s, 64 KiB, no redirects, no proxy. Raises httpx.HTTPError, ValueError."""
    with (
        httpx.Client(timeout=FETCH_TIMEOUT_S, follow_redirects=False, trust_env=False, verify=verify) as client,
        client.stream("GET", url) as answer,
    ):
        if answer.status_code != httpx.codes.OK:
            raise ValueError(f"the issuer answered {answer.status_code}")
        document = bytearray()
        for part in answer.iter_bytes():
            document += part
            if len(document) > MAX_JWKS_BYTES:
                raise ValueError("the JWKS document is too large")
        return bytes(document)
