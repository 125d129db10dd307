"""Columns with a stored form of their own: JSON, and packed those of which a database has very many: poses, and the
evidence of pairs (docs/decisions/0091). Those of an earlier version are JSON, and are read as such.

A damaged row may hold anything in any column: bytes that no stored form has, or a value of another kind. Its readers
get DATA_LOSS. Whether a value of the right kind is the one that was written, the checksums tell (docs/decisions/0306).
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from typing import Any, ClassVar, TypeVar

import numpy as np
import structlog
from numpy.typing import NDArray
from sqlalchemy import JSON, Column, Dialect, LargeBinary, Row, String, Table
from sqlalchemy.types import TypeDecorator

from revisit.core.errors import DataLoss
from revisit.service.engines.sql import packed_evidence

T = TypeVar("T")

Pose = tuple[float, ...]

_RIGID = b"\x01"
_ROWS = struct.Struct("<c12d")
_LAST_ROW = (0.0, 0.0, 0.0, 1.0)

_UNREADABLE = (ArithmeticError, LookupError, TypeError, ValueError, struct.error, zlib.error)
"""Errors of readers of bytes that are in no stored form."""

_KNOWN = "known kinds"
"""Under this name a table holds the kinds of rows that were looked at and fit: a few, by the columns that are null."""

_log = structlog.get_logger(__name__)


class RowDamaged(DataLoss):
    """A row of the database is damaged; `revisit doctor --full` names every such row."""


class StoredForm(TypeDecorator[T]):
    """A column whose values have a stored form of their own: bytes of another form are DATA_LOSS."""

    cache_ok = True
    kind: ClassVar[tuple[type, ...]] = (tuple,)
    """Classes of its values."""

    def result_processor(self, dialect: Dialect, coltype: object) -> Callable[[Any], T | None] | None:
        """The reader of a value. It raises RowDamaged."""
        read = super().result_processor(dialect, coltype)
        return None if read is None else partial(read_stored, read)


class StoredJson(StoredForm[Any]):
    """An object or a list as JSON."""

    impl = JSON(none_as_null=True)
    cache_ok = True
    kind = (dict, list)


class JsonTuple(StoredForm[tuple[Any, ...]]):
    """A tuple of numbers or strings as a JSON list; floats keep every bit."""

    impl = JSON(none_as_null=True)
    cache_ok = True

    def process_result_value(self, value: Any, dialect: Dialect) -> tuple[Any, ...] | None:
        """The list read as a tuple."""
        return None if value is None else tuple(value)


class StoredWord(StoredForm[str]):
    """One of some words, such as the values of an enumeration."""

    impl = String
    cache_ok = True
    kind = (str,)

    def __init__(self, words: tuple[str, ...], length: int) -> None:
        """Of at most `length` characters."""
        super().__init__(length)
        self.words = words
        self.length = length

    def process_result_value(self, value: str | None, dialect: Dialect) -> str | None:
        """The word. Raises ValueError for any other."""
        if value is not None and value not in self.words:
            raise ValueError("none of the words of this column")
        return value


def require_kinds(table: Table, row: Row[Any]) -> None:
    """Require that each value of a row of all columns is of the kind of its column. Raises RowDamaged."""
    kinds = tuple(map(type, row))
    known = table.info.setdefault(_KNOWN, set())
    if kinds not in known:
        require_values(table.columns, row)
        known.add(kinds)


def of_kinds(
    columns: Sequence[Column[Any]], rows: Iterable[Sequence[Any]], joined: int | None = None
) -> Iterator[tuple[Any, ...]]:
    """The rows of a query for these columns, each value of the kind of its column. Raises RowDamaged.

    Those from the column `joined` on are of an outer join: where that one is null, all are.
    """
    known = set[tuple[type, ...]]()
    for row in map(tuple, rows):
        kinds = tuple(map(type, row))
        if kinds not in known:
            require_values(columns[: joined if joined is not None and row[joined] is None else None], row)
            known.add(kinds)
        yield row


def require_values(columns: Iterable[Column[Any]], row: Sequence[Any]) -> None:
    """Require that each value is of the kind of its column; the first one is the number. Raises RowDamaged."""
    for column, value in zip(columns, row, strict=False):
        if not _fits(column, type(value)):
            table = column.table.name
            _log.error("row_damaged", table=table, row=row[0], column=column.name)
            raise RowDamaged(f"row {row[0]} of {table} is damaged: {column.name} is no {column.type}"[:200])


def fits(columns: Iterable[Column[Any]], row: Iterable[Any]) -> bool:
    """Whether each value is of the kind of its column."""
    return all(_fits(column, type(value)) for column, value in zip(columns, row, strict=True))


def read_stored(read: Callable[[Any], T], value: Any) -> T:
    """The value that `read` makes of a stored one. Raises RowDamaged."""
    try:
        return read(value)
    except _UNREADABLE as error:
        raise RowDamaged from error


def _fits(column: Column[Any], kind: type) -> bool:
    if kind is type(None):
        return bool(column.nullable)
    return kind in (column.type.kind if isinstance(column.type, StoredForm) else (column.type.python_type,))


class PackedPose(StoredForm[Pose]):
    """A rigid transform, 16 numbers row by row, as the 96 bytes of its first three rows: every bit is kept."""

    impl = LargeBinary
    cache_ok = True

    def process_bind_param(self, value: Pose | None, dialect: Dialect) -> bytes | None:
        """The three rows; JSON where the last one is not that of a rigid transform."""
        if value is None:
            return None
        rigid = tuple(value[12:]) == _LAST_ROW
        return _ROWS.pack(_RIGID, *value[:12]) if rigid else json.dumps(list(value)).encode()

    def process_result_value(self, value: bytes | None, dialect: Dialect) -> Pose | None:
        """The 16 numbers."""
        if value is None:
            return None
        if value[:1] != _RIGID:
            return tuple(json.loads(value))
        return (*_ROWS.unpack(value)[1:], *_LAST_ROW)


class PackedEvidence(StoredForm[dict[str, Any]]):
    """JSON, in less than 100 bytes where it is no more than the evidence kept of a rejected pair, or the rules that
    gave a verdict; in 400 or so where it has a measured covariance (`packed_evidence`).
    """

    impl = LargeBinary
    cache_ok = True
    kind = (dict,)

    def process_bind_param(self, value: dict[str, Any] | None, dialect: Dialect) -> bytes | None:
        """The evidence in few bytes, or as JSON."""
        if value is None:
            return None
        data = packed_brief(value) or packed_evidence.packed(value)
        return data or json.dumps(value, separators=(",", ":")).encode()

    def process_result_value(self, value: bytes | None, dialect: Dialect) -> dict[str, Any] | None:
        """The evidence."""
        if value is None:
            return None
        if value[:1] == packed_evidence.FORM:
            return packed_evidence.unpacked(value)
        return unpacked_brief(value) if value[:1] in (_OF_PAIR, _OF_RULES) else dict(json.loads(value))


class MeasuredCovariance(PackedEvidence):
    """Evidence as a pose graph reads it: of JSON nothing but the covariance is parsed, a fifth of it."""

    cache_ok = True

    def process_result_value(self, value: bytes | None, dialect: Dialect) -> dict[str, Any] | None:
        """Evidence with the covariance; all of it where that is packed, or is not told by its name alone."""
        if value is not None and value[:1] == packed_evidence.FORM:
            return {"measurement": {"covariance": packed_evidence.covariance_of(value)}}
        if value is None or value[:1] in (_OF_PAIR, _OF_RULES) or value.count(_COVARIANCE) != 1:
            return super().process_result_value(value, dialect)
        covariance, _ = _JSON.raw_decode(value.decode(), value.index(_COVARIANCE) + len(_COVARIANCE))
        return {"measurement": {"covariance": covariance}}


_OF_PAIR, _OF_RULES = b"\x01", b"\x02"
_COVARIANCE = b'"covariance":'
"""No text within JSON has it: there a quotation mark follows a backslash."""

_JSON = json.JSONDecoder()
_SHARES = ("overlap", "contrast", "seen_through", "rmse_m", "common_share", "enough_share")
_STEP = 1e-4
_UNKNOWN = -(2**15)
_THRESHOLDS = ("min_score", "min_overlap", "max_seen_through")
_RULES = {"thresholds", "thresholds_version", "model_version"}
_VERSION_BYTES = 6
_LOWER = np.tril_indices(6)
_MEASURED = struct.Struct(f"<{1 + len(_SHARES)}h6b21e")
_CHOSEN = struct.Struct(f"<{len(_THRESHOLDS)}h{_VERSION_BYTES}s")


def packed_brief(evidence: dict[str, Any]) -> bytes | None:
    """Brief evidence as bytes: shares and metres to 0.0001, the covariance to a thousandth, the rules as they are.

    None for any other members, or where the bytes would lose more.
    """
    try:
        if evidence.keys() == _RULES:
            return _OF_RULES + _packed_rules(evidence)
        if evidence.keys() == _RULES | {"measurement"}:
            return _OF_PAIR + _packed_measurement(evidence["measurement"]) + _packed_rules(evidence)
    except (ValueError, TypeError, OverflowError, struct.error, np.linalg.LinAlgError):
        pass  # a number too large for the bytes
    return None


def unpacked_brief(data: bytes) -> dict[str, Any]:
    """The evidence of `packed_brief`."""
    form, rest = data[:1], data[1:]
    if form == _OF_RULES:
        return _rules(rest)
    return {"measurement": _measurement(rest[: _MEASURED.size]), **_rules(rest[_MEASURED.size :])}


def _packed_measurement(measured: dict[str, Any]) -> bytes:
    """Raises ValueError for other members."""
    if measured.keys() != {"inliers", "covariance", *_SHARES}:
        raise ValueError("other members")
    shares = (measured[name] for name in _SHARES)
    steps = [_UNKNOWN if share is None else round(share / _STEP) for share in shares]
    return _MEASURED.pack(measured["inliers"], *steps, *_packed_covariance(measured["covariance"]))


def _measurement(data: bytes) -> dict[str, Any]:
    inliers, *numbers = _MEASURED.unpack(data)
    steps, factor = numbers[: len(_SHARES)], numbers[len(_SHARES) :]
    shares = (None if step == _UNKNOWN else round(step * _STEP, 4) for step in steps)
    return {"inliers": inliers, **dict(zip(_SHARES, shares, strict=True)), "covariance": _covariance(factor)}


def _packed_rules(evidence: dict[str, Any]) -> bytes:
    """Raises ValueError where a threshold has more digits."""
    thresholds, version = evidence["thresholds"], bytes.fromhex(evidence["thresholds_version"])
    steps = [round(thresholds[name] / _STEP) for name in _THRESHOLDS if name in thresholds]
    data: bytes = _CHOSEN.pack(*steps, version) + evidence["model_version"].encode()
    if len(version) != _VERSION_BYTES or _rules(data) != {name: evidence[name] for name in _RULES}:
        raise ValueError("other thresholds")
    return data


def _rules(data: bytes) -> dict[str, Any]:
    *steps, version = _CHOSEN.unpack_from(data)
    thresholds = (round(step * _STEP, 4) for step in steps)
    return {
        "thresholds": dict(zip(_THRESHOLDS, thresholds, strict=True)),
        "thresholds_version": version.hex(),
        "model_version": data[_CHOSEN.size :].decode(),
    }


def _packed_covariance(covariance: list[list[float]]) -> list[float]:
    """The factor L of L L^T = covariance: an exponent of each of its 6 rows, and 21 numbers at most 1.

    The product of rounded factors is still a valid covariance.
    """
    factor = np.linalg.cholesky(np.array(covariance, dtype=np.float64))
    largest, exponents = np.frexp(np.abs(factor).max(axis=1))
    exponents += largest.astype(np.float16) == 1.0  # as of what is read back, which has rounded up to 1
    return [*exponents.tolist(), *np.ldexp(factor, -exponents[:, None])[_LOWER].tolist()]


def _covariance(packed: Sequence[float]) -> list[list[float]]:
    factor: NDArray[np.float64] = np.zeros((6, 6))
    factor[_LOWER] = packed[6:]
    factor = np.ldexp(factor, np.array(packed[:6], dtype=np.int64)[:, None])
    covariance: list[list[float]] = (factor @ factor.T).tolist()
    return covariance
