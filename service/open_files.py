"""How many files and sockets the process may have open."""

from __future__ import annotations

import resource

OPEN_FILES = 65_536
"""Far more than the connections that the transports let in; shells and containers often start programs with 1,024."""


def allow_open_files() -> int:
    """Raise the soft limit as far as it may be, or a thousand silent sockets keep all others out; what it is then."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = OPEN_FILES if hard == resource.RLIM_INFINITY else min(OPEN_FILES, hard)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
        return wanted
    return soft
