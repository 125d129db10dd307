"""Entity tags of files: whether a client has the file already (RFC 9110, `If-None-Match`)."""

from __future__ import annotations


def etag_of(sha256: str) -> str:
    """The entity tag of the bytes with this hash."""
    return f'"{sha256}"'


def is_known(if_none_match: str | None, etag: str) -> bool:
    """Whether the header names the tag, by weak comparison; `*` names any."""
    named = [one.strip().removeprefix("W/") for one in (if_none_match or "").split(",")]
    return etag in named or named == ["*"]
