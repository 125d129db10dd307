"""The settings of this process, or the mistakes in its REVISIT_* variables, in words."""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from revisit.core.errors import BadField
from revisit.service.settings import GONE, Settings

PREFIX = "REVISIT_"

OF_CLIENTS = ("HTTP", "GRPC", "API_KEY", "CA", "CERTIFICATE", "CERTIFICATE_KEY")
"""Variables of the SDK and the command line."""

OF_KUBERNETES = re.compile(r"(SERVICE_HOST|SERVICE_PORT|PORT)(_.*)?")
"""Set in every container beside a Kubernetes service named revisit."""

LIKENESS = 0.72
"""A name that is as like another one is taken for its misspelling: HOEM and HOME have 0.75, DATA and any have 0.45."""


class UnusableSettings(BadField):
    """The REVISIT_* variables cannot be used."""


def load_settings(home: Path | None = None) -> Settings:
    """The settings of the environment, with another data folder where `home` is given. Raises UnusableSettings."""
    unknown = [f"{PREFIX}{name} is gone: {reason}. Unset it" for name, reason in gone(os.environ)]
    unknown += [f"{name} is no setting: did you mean {nearest}?" for name, nearest in misspellings(os.environ)]
    if unknown:
        raise UnusableSettings("\n".join(unknown))
    try:
        return Settings(home=home) if home else Settings()
    except ValidationError as error:
        raise UnusableSettings("\n".join(_named(finding) for finding in error.errors())) from error


def gone(variables: Iterable[str]) -> list[tuple[str, str]]:
    """Former settings among the variables, without their prefix, each with the constant in its place."""
    set_here = {name.removeprefix(PREFIX) for name in variables if name.startswith(PREFIX)}
    return [(name.upper(), reason) for name, reason in GONE.items() if name.upper() in set_here]


def misspellings(variables: Iterable[str]) -> list[tuple[str, str]]:
    """Variables REVISIT_* that are no setting but like one, each with the nearest name."""
    known = [*(name.upper() for name in Settings.model_fields), *OF_CLIENTS]
    meant = {*known, *(name.upper() for name in GONE)}
    unknown = (name for name in variables if name.startswith(PREFIX) and name.removeprefix(PREFIX) not in meant)
    found = []
    for name in sorted(unknown):
        rest = name.removeprefix(PREFIX)
        nearest = difflib.get_close_matches(rest, known, n=1, cutoff=LIKENESS)
        if nearest and not OF_KUBERNETES.fullmatch(rest):
            found.append((name, PREFIX + nearest[0]))
    return found


def _named(finding: Any) -> str:
    """A finding by its variable; a rule about several of them names them itself."""
    first, *members = map(str, finding["loc"] or [""])
    where = f"{PREFIX}{'.'.join([first.upper(), *members])}: " if first else ""
    return where + str(finding["msg"]).removeprefix("Value error, ")
