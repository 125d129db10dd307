"""Found by every Python process that has this folder on its path: breaks the promise that SABOTAGE names."""

from __future__ import annotations

import os

if name := os.environ.get("SABOTAGE"):
    from tests.faults.sabotage import install, named

    install(named(name))
