"""Tokens of another issuer: what is taken, and everything that is not (row A06)."""

from __future__ import annotations

import hashlib
import hmac
import json
import ssl
import threading
from base64 import urlsafe_b64encode
from http.server import BaseHTTPRequestHandler, HTTPServer

import httpx
import jwt
import pytest
import trustme
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec, rsa

from revisit.service.adapters.tokens import MAX_JWKS_BYTES, IssuerKeys, JwtVerifier, fetch_https, read_file
from revisit.service.domain.errors import Unauthenticated

NOW_S = 1_700_000_000.0
RSA_KEY = rsa.generate_private_key(public_exponent=65537, key_size=2048)
EC_KEY = ec.generate_private_key(ec.SECP256R1())
STRANGER = rsa.generate_private_key(public_exponent=65537, key_size=2048)
GOOD = {"iss": "https://id.example", "aud": "revisit", "sub": "robot-7", "tenant": "acme",
        "scope": "ingest query other", "exp": NOW_S + 600, "nbf": NOW_S - 10}  # fmt: skip


def jwks():
    keys = [
        {**json.loads(jwt.algorithms.RSAAlgorithm.to_jwk(RSA_KEY.public_key())), "kid": "rsa", "alg": "RS256"},
        {**json.loads(jwt.algorithms.ECAlgorithm.to_jwk(EC_KEY.public_key())), "kid": "ec", "alg": "ES256"},
        {"kty": "oct", "kid": "shared", "alg": "HS256", "k": "c2VjcmV0" * 8},
    ]
    return json.dumps({"keys": keys}).encode()


def signed(key=RSA_KEY, algorithm="RS256", headers=None, drop=(), **claims):
    content = {name: value for name, value in {**GOOD, **claims}.items() if name not in drop}
    return jwt.encode(content, key, algorithm=algorithm, headers={"kid": "rsa", **(headers or {})})


def by_hand(header, claims, sign=lambda text: b""):
    """A token that no honest library makes."""
    parts = [urlsafe_b64encode(json.dumps(part).encode()).rstrip(b"=") for part in (header, claims)]
    text = b".".join(parts)
    return (text + b"." + urlsafe_b64encode(sign(text)).rstrip(b"=")).decode()


@pytest.fixture(scope="module")
def verifier():
    keys = IssuerKeys(jwks)
    return JwtVerifier(
        keys, issuer="https://id.example", audience="revisit", tenant_claim="tenant", max_lifetime_s=86400.0
    )


@pytest.mark.parametrize("token", [signed(), signed(EC_KEY, "ES256", {"kid": "ec"}), signed(aud=["other", "revisit"])])
def test_a_token_of_the_issuer_names_tenant_subject_and_scopes(verifier, token):
    claims = verifier.verify(token, NOW_S)
    assert (claims.tenant, claims.subject, claims.scopes) == ("acme", "robot-7", {"ingest", "query", "other"})


def public_pem():
    form = (serialization.Encoding.PEM, serialization.PublicFormat.SubjectPublicKeyInfo)
    return RSA_KEY.public_key().public_bytes(*form)


FORGED = {
    "alg none": by_hand({"alg": "none", "kid": "rsa"}, GOOD),
    "alg None": by_hand({"alg": "None", "kid": "rsa"}, GOOD),
    "no alg": by_hand({"kid": "rsa"}, GOOD),
    "HS256 signed with the RS256 public key": by_hand(
        {"alg": "HS256", "kid": "rsa"}, GOOD, lambda text: hmac.digest(public_pem(), text, hashlib.sha256)
    ),
    "HS256 with a shared key of the set": signed(b"secret" * 8, "HS256", {"kid": "shared"}),
    "signed by a stranger": signed(STRANGER),
    "another algorithm of the same key": signed(RSA_KEY, "RS512"),
    "key id of a key of another kind": signed(RSA_KEY, "RS256", {"kid": "ec"}),
    "key id that climbs directories": signed(headers={"kid": "../../../../dev/null"}),
    "key id with a NUL": signed(headers={"kid": "rsa\x00"}),
    "key id as SQL": signed(headers={"kid": "' OR 1=1 --"}),
    "key id left out": by_hand({"alg": "RS256"}, GOOD),
    "a key brought along": by_hand({"alg": "RS256", "kid": "rsa", "jwk": {"kty": "oct", "k": ""}}, GOOD),
    "keys from elsewhere": signed(STRANGER, headers={"kid": "x", "jku": "https://evil.example/keys"}),
    "wrong issuer": signed(iss="https://id.example.evil"),
    "wrong audience": signed(aud="somebody"),
    "no audience": signed(drop=["aud"]),
    "no issuer": signed(drop=["iss"]),
    "no subject": signed(drop=["sub"]),
    "no expiry": signed(drop=["exp"]),
    "no tenant": signed(drop=["tenant"]),
    "a tenant that climbs directories": signed(tenant="../other"),
    "an empty tenant": signed(tenant=""),
    "a list of tenants": signed(tenant=["acme"]),
    "expired": signed(exp=NOW_S - 61),
    "not yet valid": signed(nbf=NOW_S + 61),
    "expires in the year 2100": signed(exp=4_102_444_800),
    "expiry as text": signed(exp="tomorrow"),
    "expiry not a number": by_hand({"alg": "RS256", "kid": "rsa"}, {**GOOD, "exp": None}),
    "cut short": signed()[:-10],
    "one bit of the claims": signed().replace(".e", ".f", 1),
    "only dots": "..",
    "not base64": "a.b.c",
}


@pytest.mark.parametrize("case", FORGED)
def test_a_token_that_is_not_right_in_everything_is_refused(verifier, case):
    with pytest.raises(Unauthenticated, match="not valid here"):
        verifier.verify(FORGED[case], NOW_S)


@pytest.mark.parametrize("claims", [{"exp": NOW_S - 59}, {"nbf": NOW_S + 59}])
def test_a_clock_may_be_a_minute_off(verifier, claims):
    verifier.verify(signed(**claims), NOW_S)


def test_an_unknown_key_makes_the_issuer_be_asked_at_most_once_a_minute():
    asked, now_s = [], [0.0]

    def fetch():
        asked.append(now_s[0])
        return jwks()

    keys = IssuerKeys(fetch, lambda: now_s[0])
    assert keys.key("rsa") is not None
    for now_s[0] in (1.0, 30.0, 59.0):
        assert keys.key("new") is None
    assert asked == [0.0]
    now_s[0] = 61.0
    keys.key("new")
    assert asked == [0.0, 61.0]
    now_s[0] = 662.0  # old: asked again for a known one too
    keys.key("rsa")
    assert asked == [0.0, 61.0, 662.0]


@pytest.mark.parametrize("failure", [OSError("down"), b"<html>", b'{"keys": 5}', b"\xff"], ids=str)
def test_while_the_issuer_is_down_the_known_keys_go_on(failure):
    answers, now_s = [jwks(), failure], [0.0]

    def fetch():
        answer = answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer

    keys = IssuerKeys(fetch, lambda: now_s[0])
    assert keys.key("rsa") is not None
    now_s[0] = 1000.0
    assert keys.key("rsa") is not None and not answers


class Issuer(BaseHTTPRequestHandler):
    """Answers by path."""

    def do_GET(self):
        if self.path == "/moved":
            self.send_response(302)
            self.send_header("location", "/keys")
            self.end_headers()
            return
        self.send_response(200 if self.path != "/missing" else 404)
        self.end_headers()
        self.wfile.write(jwks() if self.path == "/keys" else b" " * (MAX_JWKS_BYTES + 1))

    def log_message(self, *_):
        """Say nothing."""


@pytest.fixture(scope="module")
def issuer():
    """Its address and the client's trust in it."""
    authority = trustme.CA()
    server = HTTPServer(("127.0.0.1", 0), Issuer)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    authority.issue_cert("localhost").configure_cert(context)
    server.socket = context.wrap_socket(server.socket, server_side=True)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    trust = ssl.create_default_context()
    authority.configure_trust(trust)
    yield f"https://localhost:{server.server_port}", trust
    server.shutdown()
    server.server_close()


def test_keys_come_over_https_from_a_host_that_proves_itself(issuer):
    url, trust = issuer
    assert fetch_https(f"{url}/keys", verify=trust) == jwks()
    with pytest.raises(httpx.ConnectError):
        fetch_https(f"{url}/keys")


@pytest.mark.parametrize("path", ["/moved", "/missing", "/large"])
def test_no_redirect_no_error_page_and_no_huge_document_is_taken(issuer, path):
    url, trust = issuer
    with pytest.raises(ValueError, match=r"issuer answered|too large"):
        fetch_https(f"{url}{path}", verify=trust)


def test_a_file_of_keys_is_bounded_too(tmp_path):
    (tmp_path / "keys.json").write_bytes(b" " * MAX_JWKS_BYTES)
    assert len(read_file(tmp_path / "keys.json")) == MAX_JWKS_BYTES
    (tmp_path / "keys.json").write_bytes(b" " * (MAX_JWKS_BYTES + 1))
    with pytest.raises(ValueError, match="too large"):
        read_file(tmp_path / "keys.json")
