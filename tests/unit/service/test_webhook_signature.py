"""Requests to webhooks are signed as Standard Webhooks says, so that a receiver needs no code of this project."""

from __future__ import annotations

import base64

import pytest

from revisit.sdk.errors import Unauthenticated
from revisit.sdk.webhooks import verified
from revisit.service.features.webhooks.calls import new_secret
from revisit.service.features.webhooks.deliveries import signature_of

SECRET = "whsec_AAECAwQFBgcICQoLDA0ODxAREhMUFRYXGBkaGxwdHh8="
BODY = b'{"events": []}'
SENT_S = 1_700_000_000
OF_THE_REFERENCE = "v1,Hkac8YDZn5ic7hA7froMn4LeShsgVpsMwx4akdK5RXc="
"""The signature that `standardwebhooks` 1.1.0, the reference in Python, makes of it."""

HEADERS = {"Webhook-Id": "alarms-3-5", "Webhook-Timestamp": str(SENT_S), "Webhook-Signature": OF_THE_REFERENCE}


def test_the_signature_is_that_of_the_reference() -> None:
    assert signature_of(SECRET, "alarms-3-5", str(SENT_S), BODY) == OF_THE_REFERENCE


def test_a_request_is_taken_where_one_of_its_signatures_is_right() -> None:
    two = {**HEADERS, "Webhook-Signature": f"v1,{base64.b64encode(bytes(32)).decode()} {OF_THE_REFERENCE}"}
    assert verified(BODY, HEADERS, SECRET, now_s=SENT_S) == verified(BODY, two, SECRET, now_s=SENT_S) == []


@pytest.mark.parametrize(
    ("header", "changed"),
    [("Webhook-Id", "alarms-3-6"), ("Webhook-Timestamp", "1700000001"), ("Webhook-Signature", "")],
)
def test_what_was_signed_cannot_be_changed(header: str, changed: str) -> None:
    with pytest.raises(Unauthenticated, match="signature"):
        verified(BODY, {**HEADERS, header: changed}, SECRET, now_s=SENT_S)


def test_a_secret_that_is_none_opens_nothing() -> None:
    with pytest.raises(Unauthenticated, match="secret"):
        verified(BODY, HEADERS, "whsec_short", now_s=SENT_S)


def test_a_secret_is_a_key_in_base64() -> None:
    secret = new_secret()
    assert secret.startswith("whsec_") and len(base64.b64decode(secret.removeprefix("whsec_"), validate=True)) == 32
    assert new_secret() != secret
