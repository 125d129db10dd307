"""The method in a worker that was installed without the extra `learned`."""

from __future__ import annotations

import sys

from revisit.service.adapters.core_recogniser import CoreRecogniser, load_recogniser


def load() -> CoreRecogniser:
    """The recogniser of the product, where torch cannot be imported."""
    sys.modules["torch"] = None  # type: ignore[assignment]  # so Python marks what is not to be found
    return load_recogniser()
