"""Former names of commands, each answered with the command that does it now."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from typer.core import TyperGroup

FORMER: Mapping[str, str] = {
    "sessions": "revisit maps MAP",
    "loop": "revisit loops NAME --accept, --reject or --revert",
    "explain": "revisit query --submap SESSION/SUBMAP --explain",
    "pose-graph": "revisit map optimise --here",
    "migrate": "python -m revisit.service migrate",
    "map merges": "revisit merge MAP",
    "map distance": "revisit map tiles --distance X,Y,Z",
}
"""Name of a command that is gone -> the command line in its place."""


class WithFormerNames(TyperGroup):
    """A group of commands that knows what has become of former ones."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The command that is meant; exits with status 2 where it is gone, and says what stands in its place."""
        name = args[0] if ctx.parent is None else f"{self.name} {args[0]}"
        if name in FORMER:
            ctx.fail(f"`revisit {name}` is now `{FORMER[name]}`")
        return super().resolve_command(ctx, args)
