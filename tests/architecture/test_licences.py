"""What the product needs at run time may be passed on with it: permissive licences, and exceptions with a reason."""

from __future__ import annotations

import re
from importlib import metadata

import pytest

from tests.support.requirements import distributions

PERMISSIVE = {
    "0BSD", "APACHE-2.0", "BSD-2-CLAUSE", "BSD-3-CLAUSE", "BSL-1.0", "CC0-1.0", "ISC", "LLVM-EXCEPTION", "MIT",
    "MIT-0", "MIT-CMU", "PSF-2.0", "ZLIB",
    # As older metadata names them, in classifiers and in free text.
    "APACHE SOFTWARE LICENSE", "APACHE 2.0", "BSD LICENSE", "3-CLAUSE BSD LICENSE", "ISC LICENSE (ISCL)",
    "MIT LICENSE", "PYTHON SOFTWARE FOUNDATION LICENSE",
}  # fmt: skip

LGPL = "LGPL-3.0-ONLY"
EXCEPTIONS = {
    "certifi": ("MOZILLA PUBLIC LICENSE 2.0 (MPL 2.0)", "a list of certificates, used unchanged; httpx needs it"),
    "psycopg": (
        LGPL,
        "PostgreSQL's driver, used unchanged, in the extra `cluster` alone; whoever has it may exchange it",
    ),
    "psycopg-binary": (LGPL, "its compiled part"),
    "tqdm": ("MPL-2.0 AND MIT", "a progress bar, used unchanged; KISS-ICP needs it, in the extra `kiss-icp` alone"),
}
"""Distribution -> its licence, and why it may be used all the same."""


def licences_of(name):
    """The licences that a distribution names: by SPDX expression, else by classifier, else by its own words."""
    about = metadata.metadata(name)
    if expression := about.get("License-Expression"):
        return {part.upper() for part in re.split(r"\s+(?:AND|OR|WITH)\s+|[()]", expression) if part}
    classified = {
        line.rpartition(" :: ")[2].upper()
        for line in about.get_all("Classifier", [])
        if line.startswith("License ::") and not line.endswith("OSI Approved")
    }
    return classified or {(about.get("License") or "unknown").strip().splitlines()[0].upper()}


DISTRIBUTIONS = sorted(set().union(*map(distributions, ("evaluation", "cluster", "kiss-icp", "crs"))))
"""All that is passed on: the largest extras but the developers' own, which hold the others."""


@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_what_is_needed_at_run_time_has_a_permissive_licence(name):
    licences = licences_of(name)
    if name in EXCEPTIONS:
        assert licences == {EXCEPTIONS[name][0]}
    else:
        assert licences <= PERMISSIVE, f"{name} has {licences}"


def test_every_exception_is_still_needed():
    assert EXCEPTIONS.keys() <= set(DISTRIBUTIONS)


def test_the_walk_finds_what_dependencies_bring_with_them():
    # The SDK asks for numpy, the service for torch, the evaluation for matplotlib; certifi comes with httpx,
    # cryptography with the extra of pyjwt.
    assert {"numpy", "torch", "matplotlib", "certifi", "cryptography"} <= set(DISTRIBUTIONS)
    assert {"hypothesis", "pytest", "ruff", "mypy"}.isdisjoint(DISTRIBUTIONS)
