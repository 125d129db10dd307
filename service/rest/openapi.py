"""The OpenAPI document without a running service: `python -m service.rest.openapi` writes it to docs/reference."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, cast

from service.application import UseCases
from service.rest.app import create_app

TARGET = Path(__file__).resolve().parents[2] / "docs" / "reference" / "openapi.json"


def document() -> dict[str, Any]:
    """What `/openapi.json` answers."""
    # The routes are described without being called, so no use case is needed.
    return create_app(cast(UseCases, None)).openapi()


def write(target: Path = TARGET) -> None:
    """Write the document, stable and readable."""
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(json.dumps(document(), indent=2, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    write()
