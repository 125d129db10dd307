"""What a driver has measured: one line of JSON on the output, and in the file that REVISIT_FIGURES names."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any


def publish(driver: str, **figures: Any) -> None:
    """Print the figures of `driver` and append them to the file, where one is named."""
    append({"driver": driver, **figures})


def append(figures: dict[str, Any]) -> None:
    """Print one line of figures and append it to the file, where one is named."""
    line = json.dumps(figures)
    print(line)
    if file := os.environ.get("REVISIT_FIGURES"):
        with Path(file).open("a") as lines:
            lines.write(line + "\n")
