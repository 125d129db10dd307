"""Names: tenants, ids that clients choose, and the identity of content."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NewType

from revisit.core.errors import BadField
from revisit.service.domain import limits

TenantId = NewType("TenantId", str)

DEFAULT_TENANT = TenantId("default")

RESERVED_SUBMAP_PREFIX = "scans-"
"""Submaps cut from a stream of scans are named `scans-FIRST-LAST`; clients may not choose such ids."""

_ID = re.compile(limits.ID_PATTERN, re.ASCII)
# Names that Windows forbids for a file: downloads and exports are named after their resources.
_NO_FILE_NAME = re.compile(r"(?:con|prn|aux|nul|com[0-9]|lpt[0-9])(?:\..*)?|.*\.", re.ASCII | re.IGNORECASE)


@dataclass(frozen=True, order=True)
class SessionKey:
    """`maps/{map_id}/sessions/{session_id}`."""

    map_id: str
    session_id: str

    @property
    def name(self) -> str:
        """The resource name."""
        return f"maps/{self.map_id}/sessions/{self.session_id}"


@dataclass(frozen=True, order=True)
class SubmapKey:
    """`maps/{map_id}/sessions/{session_id}/submaps/{submap_id}`."""

    map_id: str
    session_id: str
    submap_id: str

    @property
    def session(self) -> SessionKey:
        """The session the submap belongs to."""
        return SessionKey(self.map_id, self.session_id)

    @property
    def name(self) -> str:
        """The resource name."""
        return f"maps/{self.map_id}/sessions/{self.session_id}/submaps/{self.submap_id}"


def validated_id(value: str, field: str) -> str:
    """`value` if it can name a resource: 1 to 64 of A-Z a-z 0-9 . _ -, beginning with a letter or digit.

    It does not end in a dot and is no device of Windows (`con`, `nul.txt`). Raises BadField naming `field`.
    """
    if not _ID.fullmatch(value):
        raise BadField(f"{field} must match {limits.ID_PATTERN}", field=field)
    if _NO_FILE_NAME.fullmatch(value):
        raise BadField(f"{field} may neither end in a dot nor be a device of Windows", field=field)
    return value


def validated_label(value: str, field: str) -> str:
    """`value` if people can read it as a name: at most 256 printable characters. Raises BadField naming `field`."""
    if len(value) > limits.DISPLAY_NAME_CHARACTERS or not value.isprintable():
        most = limits.DISPLAY_NAME_CHARACTERS
        raise BadField(f"{field} must be at most {most} printable characters", field=field)
    return value


def validated_detail(value: str | None, field: str) -> str | None:
    """`value` if it can be a detail of a session, as its storey: 1 to 64 printable characters, no blank at either end.

    None where nobody said it. Two are equal letter for letter. Raises BadField naming `field`.
    """
    most = limits.STOREY_CHARACTERS
    if value is not None and not (0 < len(value) <= most and value.isprintable() and value == value.strip()):
        raise BadField(f"{field} must be 1 to {most} printable characters, no blank before or behind", field=field)
    return value


def validated_note(value: str) -> str:
    """`value` if it can be the reason of a decision: at most 1000 printable characters. Raises BadField."""
    if len(value) > limits.NOTE_CHARACTERS or not value.isprintable():
        raise BadField(f"note must be at most {limits.NOTE_CHARACTERS} printable characters", field="note")
    return value


def content_hash(parts: Iterable[bytes | str | int | float | None]) -> str:
    """SHA-256 (hex) of the canonical content of a create: each part with its kind and length, so none run together."""
    digest = hashlib.sha256()
    for part in parts:
        data = part if isinstance(part, bytes) else repr(part).encode()
        digest.update(f"{type(part).__name__}:{len(data)}:".encode())
        digest.update(data)
    return digest.hexdigest()
