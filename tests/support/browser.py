"""A headless Chromium for the page, drawn by software; tests skip where there is none."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

SOFTWARE = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist")
SIZE = {"width": 1280, "height": 800}
PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}


@contextmanager
def browser() -> Iterator[object]:
    """A browser until the block ends."""
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    found = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if found is None:
        pytest.skip("no Chromium on this machine: scripts/test_tools.sh installs it")
    with api.sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=found, args=list(SOFTWARE))
        yield opened
        opened.close()


class Page:
    """A page of the service, what it complained about, and whom it asked."""

    def __init__(self, opened, address: str, path: str = "/", **options) -> None:
        # Only so can a test look into the page: the service's Content-Security-Policy forbids it, which another checks.
        self.tab = opened.new_page(**{"viewport": SIZE, "bypass_csp": True, "reduced_motion": "reduce", **options})
        self.complaints: list[str] = []
        self.asked: list[str] = []
        self.tab.on("console", lambda said: self.complaints.append(said.text) if said.type == "error" else None)
        self.tab.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.tab.on("request", lambda request: self.asked.append(request.url))
        self.tab.goto(address + path)

    def data(self, name: str) -> str | None:
        """What the page says of itself in `data-name` of its body."""
        return self.tab.locator("body").get_attribute(f"data-{name}")

    def drawn(self) -> int:
        """Waits until the map is drawn; how long that took from the request of the page, milliseconds."""
        self.tab.locator("body[data-drawn-ms]").wait_for(timeout=60_000)
        return int(self.data("drawn-ms") or 0)

    def until(self, name: str, value: object) -> None:
        """Waits until `data-name` has this value."""
        self.tab.locator(f"body[data-{name}='{value}']").wait_for(timeout=20_000)

    def where(self, submap: str) -> tuple[float, float]:
        """Where a submap is drawn, in pixels of the window."""
        box = self.tab.locator("#view").bounding_box()
        at = self.tab.evaluate("name => revisitPage.whereIs(name)", submap)
        return box["x"] + at["x"], box["y"] + at["y"]
