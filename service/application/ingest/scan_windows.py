"""The current window of a session's scans: the state of `core.submap.SubmapBuilder` as a value that a row can hold.

The builder keeps scans in memory; here they are rows, and a window is the range of their sequence numbers, so that an
unfinished window survives a restart. A test holds the two against each other on random drives.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from revisit.core.config import SubmapConfig
from revisit.core.submap import next_window_start
from revisit.service.application.contract.records import SessionRecord


@dataclass(frozen=True)
class Window:
    """The window since scan `first_seq`; distances in metres travelled since the session began."""

    first_seq: int
    start_m: float
    travelled_m: float
    emitted_to_m: float | None


@dataclass(frozen=True)
class ScanRange:
    """The scans first..last of a finished submap."""

    first: int
    last: int


def window_of(session: SessionRecord) -> Window:
    """The window that a session's row holds."""
    return Window(session.window_first_seq, session.window_start_m, session.travelled_m, session.emitted_to_m)


FirstSeqFrom = Callable[[float], int | None]
"""The first stored scan taken at or beyond a travelled distance in metres."""


def advance(
    window: Window, seq: int, step_m: float, config: SubmapConfig, first_seq_from: FirstSeqFrom
) -> tuple[Window, ScanRange | None]:
    """The window after scan `seq`, taken `step_m` metres beyond the last one, and the submap that it completes."""
    travelled = window.travelled_m + step_m
    if travelled - window.start_m < config.tau:
        return Window(window.first_seq, window.start_m, travelled, window.emitted_to_m), None
    start = next_window_start(window.start_m, travelled, config)
    # The newest scan always stays: the next step is measured from it.
    first_kept = first_seq_from(start)
    first = seq if first_kept is None else max(window.first_seq, first_kept)
    return Window(first, start, travelled, travelled), ScanRange(window.first_seq, seq)


def remainder(window: Window, committed_seq: int) -> ScanRange | None:
    """The scans of a last, shorter submap at the end of a session, or None where nothing new was seen."""
    if committed_seq == 0 or window.travelled_m == window.emitted_to_m:
        return None
    return ScanRange(window.first_seq, committed_seq)
