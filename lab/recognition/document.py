"""A document that is written as Markdown and as one HTML file: headings, paragraphs, tables and pictures."""

from __future__ import annotations

import base64
import html
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 1100px; margin: 2rem auto; padding: 0 1rem; color: #1c2430; }
table { border-collapse: collapse; margin: 1rem 0; font-variant-numeric: tabular-nums; }
th, td { border-bottom: 1px solid #d5dae2; padding: .3rem .7rem; text-align: right; }
th:first-child, td:first-child { text-align: left; }
img { max-width: 100%; } h2 { margin-top: 2.5rem; border-bottom: 2px solid #d5dae2; }
"""


@dataclass
class Document:
    """Parts in order, each as Markdown and as HTML. Pictures are files beside the Markdown and inside the HTML."""

    title: str
    _markdown: list[str] = field(default_factory=list)
    _html: list[str] = field(default_factory=list)

    def heading(self, text: str, level: int = 2) -> None:
        """A heading of level 2 or 3."""
        self._add(f"{'#' * level} {text}", f"<h{level}>{html.escape(text)}</h{level}>")

    def paragraph(self, text: str) -> None:
        """Plain text."""
        self._add(text, f"<p>{html.escape(text)}</p>")

    def table(self, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """A table; the first column is on the left, the others hold figures."""
        lines = [_row(columns), _row([":---", *["---:"] * (len(columns) - 1)]), *map(_row, rows)]
        body = "".join(_html_row("td", row) for row in rows)
        self._add("\n".join(lines), f"<table>{_html_row('th', columns)}{body}</table>")

    def picture(self, file: Path, folder: Path, caption: str) -> None:
        """A PNG under `folder`, where the document will be written."""
        data = base64.b64encode(file.read_bytes()).decode()
        figure = f'<img alt="{html.escape(caption)}" src="data:image/png;base64,{data}">'
        self._add(
            f"![{caption}]({file.relative_to(folder).as_posix()})",
            f"<figure>{figure}<figcaption>{html.escape(caption)}</figcaption></figure>",
        )

    def write(self, folder: Path, name: str) -> tuple[Path, Path]:
        """Write NAME.md and NAME.html into `folder`; their paths."""
        folder.mkdir(parents=True, exist_ok=True)
        markdown, page = folder / f"{name}.md", folder / f"{name}.html"
        markdown.write_text("\n\n".join([f"# {self.title}", *self._markdown]) + "\n")
        title = html.escape(self.title)
        head = f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{title}</title><style>{_STYLE}</style>'
        page.write_text("\n".join([head, f"<h1>{title}</h1>", *self._html, "</html>"]) + "\n")
        return markdown, page

    def _add(self, markdown: str, page: str) -> None:
        self._markdown.append(markdown)
        self._html.append(page)


def _row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |"


def _html_row(tag: str, cells: Sequence[str]) -> str:
    return f"<tr>{''.join(f'<{tag}>{html.escape(cell)}</{tag}>' for cell in cells)}</tr>"
