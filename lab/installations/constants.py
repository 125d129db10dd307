"""The measured constants of the model, one file."""

from __future__ import annotations

import json
from pathlib import Path

_FILE = Path(__file__).parent / "measured.json"


def constants() -> dict[str, float]:
    """Name -> value; the file also names where each comes from."""
    return {name: float(entry["value"]) for name, entry in json.loads(_FILE.read_text()).items()}
