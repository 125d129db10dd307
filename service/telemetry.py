"""Logs: one JSON object per line on stderr, with the bound ids (request_id, operation, worker)."""

from __future__ import annotations

import hashlib
import json
import logging
import sys

import structlog
from structlog.typing import EventDict

from revisit.service.redaction import redacted


def configure_logging(level: str, *, hash_tenants: bool = False) -> None:
    """Log from `level` up; tenants and callers by hashes of their names where asked for.

    Raises ValueError for an unknown level.
    """
    number = logging.getLevelNamesMapping().get(level.upper())
    if number is None:
        raise ValueError(f"unknown log level {level!r}")
    structlog.configure(
        processors=[
            structlog.contextvars.merge_contextvars,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            structlog.processors.format_exc_info,
            *([_with_hashed_names] if hash_tenants else []),
            # On the finished line: a secret may be in any value, an exception's text too.
            structlog.processors.JSONRenderer(serializer=lambda entry, **how: redacted(json.dumps(entry, **how))),
        ],
        wrapper_class=structlog.make_filtering_bound_logger(number),
        logger_factory=structlog.WriteLoggerFactory(file=sys.stderr),
        cache_logger_on_first_use=True,
    )
    # Libraries log through the standard module: only warnings and above, on the same stream, in the same form.
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(_JsonLine())
    logging.basicConfig(level=max(number, logging.WARNING), handlers=[handler], force=True)


def _with_hashed_names(_logger: object, _method: str, entry: EventDict) -> EventDict:
    """The entry with pseudonyms for its tenant and its caller: the same in every line, so that they can be grouped."""
    for who in ("tenant", "caller"):
        if who in entry:
            entry[who] = hashlib.sha256(str(entry[who]).encode()).hexdigest()[:12]
    return entry


class _JsonLine(logging.Formatter):
    """A library's record as one JSON object on one line."""

    def format(self, record: logging.LogRecord) -> str:
        """The line, without its end."""
        entry = {"event": record.getMessage(), "logger": record.name, "level": record.levelname.lower()}
        if record.exc_info:
            entry["exception"] = self.formatException(record.exc_info)
        return redacted(json.dumps(entry))
