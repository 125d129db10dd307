"""Sites of a fleet over several installations: by a hash of their names, or by a directory of the emptiest."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

import numpy as np

SITES = 200
ZIPF = 0.8
"""Sites are unequal: the n-th largest has n to the power of -0.8 times the robots of the largest."""


def site_sizes(robots: int, sites: int = SITES) -> list[int]:
    """Robots of each site, largest first; their sum is `robots`."""
    shares = np.arange(1, sites + 1) ** -ZIPF
    ends = np.round(np.cumsum(shares) / shares.sum() * robots).astype(int)
    return [int(size) for size in np.diff(ends, prepend=0)]


def divided(sizes: list[int], most: int) -> list[int]:
    """The same robots where each site above `most` is several, by its maps: nearly equal parts, largest first."""
    found: list[int] = []
    for size in sizes:
        parts = -(-size // most)
        found += [(size + part) // parts for part in range(parts)]
    return sorted(found, reverse=True)


def by_hash(sizes: list[int], installations: int) -> list[int]:
    """Robots of each installation where the name of a site decides."""
    loads = [0] * installations
    for number, size in enumerate(sizes):
        digest = hashlib.sha256(f"site-{number}".encode()).digest()
        loads[int.from_bytes(digest[:8]) % installations] += size
    return loads


def by_directory(sizes: list[int], installations: int, order: Sequence[int]) -> list[int]:
    """Robots of each installation where each site, in this order, goes to the one with the fewest robots."""
    loads = [0] * installations
    for number in order:
        loads[loads.index(min(loads))] += sizes[number]
    return loads


def as_they_come(sites: int = SITES, seed: int = 1) -> list[int]:
    """An order of sites that has nothing to do with their sizes."""
    return [int(number) for number in np.random.default_rng(seed).permutation(sites)]
