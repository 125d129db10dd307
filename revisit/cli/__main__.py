"""`python -m revisit.cli`."""

from __future__ import annotations

from revisit.cli import main

main()
