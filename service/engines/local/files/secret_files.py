"""Secrets of an installation: 32 random bytes in a file of the data folder that only its owner can read."""

from __future__ import annotations

import secrets
from pathlib import Path

from revisit.service.engines.local.files.disk import durable_write

SECRET_BYTES = 32


def kept_secret(path: Path) -> bytes:
    """The secret in a file, made where there is none yet. Raises OSError, ValueError where the file holds none."""
    if not path.exists():
        keep_secret(path, secrets.token_bytes(SECRET_BYTES))
    return read_secret(path)


def read_secret(path: Path) -> bytes:
    """The secret in a file. Raises OSError, ValueError where it holds none."""
    try:
        secret = bytes.fromhex(path.read_text("ascii").strip())
    except ValueError as error:
        raise ValueError(f"{path} holds no secret of this service") from error
    if len(secret) != SECRET_BYTES:
        raise ValueError(f"{path} holds no secret of this service")
    return secret


def keep_secret(path: Path, secret: bytes) -> None:
    """Write it, replacing another one. It is no blob: campaigns that let the n-th blob fail do not count it.

    Raises OSError.
    """
    durable_write(path, f"{secret.hex()}\n".encode(), is_blob=False)
