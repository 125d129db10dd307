"""Cached results of an immutable object: those of a place serve every pair that it is in."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import cached_property
from typing import Any, Concatenate, ParamSpec, Self, TypeVar

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


class Keeping:
    """An immutable object that caches results computed from it. A pickle leaves the cache out."""

    @cached_property
    def _kept(self) -> dict[Hashable, Any]:
        return {}

    def kept(
        self,
        function: Callable[Concatenate[Self, Arguments], Result],
        *arguments: Arguments.args,
        **named: Arguments.kwargs,
    ) -> Result:
        """`function(self, *arguments)`, computed at the first call; the arguments are hashable."""
        key = (function, arguments, *sorted(named.items())) if named else (function, arguments)
        if key not in self._kept:
            self._kept[key] = function(self, *arguments, **named)
        result: Result = self._kept[key]
        return result

    def __getstate__(self) -> dict[str, Any]:
        """The state without the cache."""
        return {name: value for name, value in self.__dict__.items() if name != "_kept"}
