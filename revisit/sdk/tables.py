"""Resources as a table of pandas, for notebooks."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import fields
from typing import TYPE_CHECKING, Any

import numpy as np

from revisit.core.geometry import se3
from revisit.sdk.reading import Resource

if TYPE_CHECKING:
    import pandas as pd

POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
"""The columns of a transform, metres and a quaternion."""


def to_dataframe(resources: Iterable[Resource]) -> pd.DataFrame:
    """A row for each resource, a column for each field.

    A transform `T_map` has the columns `T_map.x` to `T_map.qw`, a vector those of its numbers, a resource within a
    resource those of its fields, with a point between: `evidence.score`. Lists of resources and matrices that are no
    transforms stay as they are. Raises ImportError without pandas.
    """
    try:
        import pandas as pd
    except ModuleNotFoundError as error:
        raise ImportError("to_dataframe needs pandas: pip install pandas") from error
    return pd.DataFrame([dict(_cells(resource)) for resource in resources])


def _cells(resource: Resource, prefix: str = "") -> Iterator[tuple[str, Any]]:
    for field in fields(resource):
        yield from _columns(f"{prefix}{field.name}", getattr(resource, field.name))


def _columns(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(value, Resource):
        yield from _cells(value, f"{name}.")
    elif isinstance(value, np.ndarray) and value.shape == (4, 4):
        row = (*value[:3, 3], *se3.to_quaternion(value))
        yield from ((f"{name}.{axis}", float(number)) for axis, number in zip(POSE, row, strict=True))
    elif isinstance(value, tuple) and len(value) in (2, 3) and all(isinstance(one, int | float) for one in value):
        yield from ((f"{name}.{axis}", number) for axis, number in zip(POSE, value, strict=False))
    else:
        yield name, value
