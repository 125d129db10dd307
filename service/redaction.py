"""Secrets in text that is about to leave the process: everything that looks like one is struck out."""

from __future__ import annotations

import re

STRUCK_OUT = "[secret]"

_SECRETS = (
    # API keys keep their public id, which says which one to revoke.
    (re.compile(r"\b(rv_[a-z0-9]{12}_)[A-Za-z0-9]{20,}"), rf"\1{STRUCK_OUT}"),
    (re.compile(r"\b(whsec_)[A-Za-z0-9_+/=-]{20,}"), rf"\1{STRUCK_OUT}"),
    (re.compile(r"\beyJ[A-Za-z0-9_-]+\.[A-Za-z0-9_-]+\.[A-Za-z0-9_-]*"), STRUCK_OUT),
    (re.compile(r"(?i)\b(bearer )[^\s\"'\\,;]+"), rf"\1{STRUCK_OUT}"),
    (re.compile(r"-----BEGIN [A-Z ]*PRIVATE KEY-----.*?(?:-----END [A-Z ]*PRIVATE KEY-----|$)", re.S), STRUCK_OUT),
)


def redacted(text: str) -> str:
    """`text` without API keys, tokens, bearer credentials and private keys."""
    for pattern, replacement in _SECRETS:
        text = pattern.sub(replacement, text)
    return text
