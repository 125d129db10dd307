"""The index of the decisions, made out of the decisions' own lines so that it cannot drift from them."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

FOLDER = Path("docs/decisions")
INTRODUCTION = """# Decisions

Choices that bind: code or a test relies on each of them, and a maintainer could undo it by mistake. `make docs` writes
this index from the pages' own lines: title, the first sentence of **Decision**, **Status**, and **What would reverse
it**. Numbers are never used twice; a gap is a page that no longer binds, and git has it. Measurements behind the
recognition are in [how recognition was tuned](../explanation/recognition-tuning.md).

| | decision | in short | status | what would reverse it |
|---|---|---|---|---|"""


@dataclass(frozen=True)
class Decision:
    """One page of docs/decisions: its number, title, and the paragraphs that stand behind its bold labels."""

    file: str
    number: str
    title: str
    parts: dict[str, str]

    @property
    def summary(self) -> str:
        """The first sentence of the part Decision."""
        return re.split(r"(?<=[.:])\s+(?=[A-Z`\[-])", self.parts.get("Decision", ""), maxsplit=1)[0].rstrip(":")

    @property
    def status(self) -> str:
        """Accepted, superseded, or what else the page says; accepted where it says nothing."""
        return self.parts.get("Status", "Accepted.")


def read(page: Path) -> Decision:
    """The decision on `page`; ValueError where the page does not begin with `# NNNN title`."""
    text = page.read_text(encoding="utf-8")
    heading = re.match(r"# (\d{4}):? (.+)\n", text)
    if heading is None:
        raise ValueError(f"{page.name} must begin with a line `# NNNN title`")
    paragraphs = re.findall(r"^\*\*([A-Z][\w ]*?)[.:]?\*\*[.:]? *((?:.+\n?)+)", text, re.MULTILINE)
    parts = {label: " ".join(body.split()) for label, body in reversed(paragraphs)}
    return Decision(page.name, heading[1], heading[2].strip(), parts)


def index(root: Path) -> str:
    """The text of docs/decisions/README.md for the decisions below `root`."""
    pages = sorted((root / FOLDER).glob("[0-9]*.md"))
    return "\n".join([INTRODUCTION, *(_row(read(page)) for page in pages)]) + "\n"


def _row(decision: Decision) -> str:
    title = f"[{decision.title}]({decision.file})"
    cells = (title, decision.summary, decision.status, decision.parts.get("What would reverse it", ""))
    return "| " + " | ".join([decision.number, *(cell.replace("|", "\\|") for cell in cells)]) + " |"
