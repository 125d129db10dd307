"""The key that signs backups: without it nobody can change a backup and have it restored."""

from __future__ import annotations

import hashlib
import hmac
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from revisit.service.engines.local.files.secret_files import kept_secret

KEY_FILE = "backup.key"
"""In the data folder, and in no backup: a person with write access to the backups must not be able to read it."""


def own_key(home: Path) -> bytes:
    """The key of a data folder, made where there is none yet. Raises OSError, ValueError for a damaged one."""
    return kept_secret(home / KEY_FILE)


def signature(key: bytes, fields: Mapping[str, Any]) -> str:
    """The HMAC-SHA256 (hex) of JSON-able fields."""
    content = json.dumps(fields, sort_keys=True, separators=(",", ":")).encode()
    return hmac.digest(key, b"revisit backup\0" + content, hashlib.sha256).hex()
