"""Addresses in the documentation are such as the service answers by default: its own machine, or with TLS."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
CALL = re.compile(r"""Client(?:\.grpc)?\(\s*["']([^"']+)["']""")
HERE = ("127.0.0.1", "localhost", "[::1]")


def test_a_client_of_another_machine_is_shown_with_tls():
    shown = [(page.name, address) for page in PAGES for address in CALL.findall(page.read_text())]
    assert len(shown) >= 4
    plain = [
        (page, address)
        for page, address in shown
        if not address.startswith(("https://", "grpcs://"))
        and address.removeprefix("http://").rpartition(":")[0] not in HERE
    ]
    assert plain == []
