"""The fake recogniser, for a worker that has loaded nothing of what it never uses."""

from __future__ import annotations

import sys

from tests.support import fake_recogniser

NEVER_USED = ("alembic", "cffi", "charset_normalizer", "fastapi", "grpc", "pygments", "rich", "torch")


def load() -> fake_recogniser.FakeRecogniser:
    """Raises RuntimeError where any of these was loaded."""
    loaded = [name for name in NEVER_USED if sys.modules.get(name) is not None]
    if loaded:
        raise RuntimeError(f"a worker has loaded {', '.join(loaded)}")
    return fake_recogniser.load()
