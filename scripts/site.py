"""Build the documentation as a website, from docs, README, CHANGELOG and the ROS package: `site.py [OUT]`.

The pages are those of the repository. Links to files that are no pages of the site are shown as names. The site asks
nothing of other hosts, and its search works without a server. OUT is `build/site` by default.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGES = {
    "README.md": "index.md",
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
    "ros/revisit_bridge/README.md": "reference/ros-2-bridge.md",
}
"""File of the repository -> page of the site; besides these everything under `docs`, without that prefix."""

NAVIGATION = {
    "Start": (
        "index",
        "gallery",
        "tutorial/first-loop",
        "quick-start/ros-2",
        "quick-start/bags",
        "quick-start/http",
        "quick-start",
    ),
    "How to": ("how-to/check-a-recording", "how-to/ingest-a-recording", "how-to/use-with-ros-2", "how-to"),
    "Explanation": ("explanation/frames", "explanation/architecture", "explanation", "glossary"),
    "Reference": ("reference/cli", "reference/rest-and-grpc", "reference/bag-layouts", "reference"),
    "Decisions": ("decisions/README", "decisions"),
    "Project": ("contributing", "changelog"),
}
"""Tabs of the site: pages, and folders whose other pages follow by name. So a new page needs no entry."""

SHIM = ROOT / "scripts/vendor/iframe-worker.js"
FOREIGN_SHIM = "https://unpkg.com/iframe-worker/shim"
DIAGRAM = re.compile(r"^```mermaid\n(.*?)^```$", re.MULTILINE | re.DOTALL)

_LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)\s#]*)(#[^)\s]*)?\)")
_FENCED = re.compile(r"(^```.*?^```$)", re.MULTILINE | re.DOTALL)


def page_of(file: Path) -> Path | None:
    """Where a file of the repository is in the site, None where it is not part of it."""
    told = file.as_posix()
    if told in PAGES:
        return Path(PAGES[told])
    return Path(*file.parts[1:]) if file.parts[:1] == ("docs",) else None


def drawing_of(diagram: str) -> Path:
    """Where the drawing of a Mermaid diagram is kept (see `scripts/diagrams.py`)."""
    return ROOT / f"docs/images/diagrams/{hashlib.sha256(diagram.encode()).hexdigest()[:8]}.svg"


def rewritten(text: str, file: Path) -> str:
    """The text of a file of the repository with drawn diagrams and with links as they are in the site."""
    text = DIAGRAM.sub(lambda found: _drawn(found, file), text)
    parts = _FENCED.split(text)
    return "".join(part if part.startswith("```") else _LINK.sub(lambda m: _link(m, file), part) for part in parts)


def _drawn(found: re.Match[str], file: Path) -> str:
    drawing = drawing_of(found[1])
    return f"![Diagram]({os.path.relpath(drawing, ROOT / file.parent)})" if drawing.is_file() else found[0]


def _link(found: re.Match[str], file: Path) -> str:
    image, text, target, anchor = found[1], found[2], found[3], found[4] or ""
    if not target or "://" in target or target.startswith("mailto:"):
        return found[0]
    meant = Path(os.path.normpath(file.parent / target))
    page, here = page_of(meant), page_of(file)
    if page is None or here is None or not (ROOT / meant).is_file():
        return text
    return f"{image}[{text}]({Path(os.path.relpath(page, here.parent)).as_posix()}{anchor})"


def collect(folder: Path) -> None:
    """Write all pages, pictures and examples of the site into a folder."""
    for file in sorted({*(ROOT / "docs").rglob("*"), *(ROOT / name for name in PAGES)}):
        where = page_of(file.relative_to(ROOT))
        if file.is_dir() or where is None:
            continue
        (folder / where).parent.mkdir(parents=True, exist_ok=True)
        if file.suffix == ".md":
            (folder / where).write_text(rewritten(file.read_text(), file.relative_to(ROOT)))
        else:
            shutil.copyfile(file, folder / where)


def navigation(folder: Path) -> list[dict[str, list[str]]]:
    """The tabs with all pages of a folder. Raises ValueError for a page that has no place."""
    left = sorted(page.relative_to(folder).as_posix() for page in folder.rglob("*.md"))
    tabs = []
    for title, places in NAVIGATION.items():
        pages: list[str] = []
        for place in places:
            found = [page for page in left if page == f"{place}.md" or page.startswith(f"{place}/")]
            pages += found
            left = [page for page in left if page not in found]
        tabs.append({title: pages})
    if left:
        raise ValueError(f"pages without a place in NAVIGATION: {', '.join(left)}")
    return tabs


def build(out: Path) -> None:
    """Build the site. Raises CalledProcessError for any warning, as a link that leads nowhere."""
    with tempfile.TemporaryDirectory() as folder:  # of its own, so that two may be built at the same time
        work = Path(folder)
        collect(work / "pages")
        settings = {"INHERIT": str(ROOT / "mkdocs.yml"), "docs_dir": "pages", "site_dir": str(out)}
        # JSON is YAML.
        (work / "mkdocs.yml").write_text(json.dumps({**settings, "nav": navigation(work / "pages")}, indent=1))
        command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-q", "-f", str(work / "mkdocs.yml")]
        quiet = {"NO_MKDOCS_2_WARNING": "1"}  # the theme advertises another program on each build
        subprocess.run(command, check=True, env={**os.environ, **quiet})
    _keep_at_home(out)


def _keep_at_home(site: Path) -> None:
    """The theme loads one script from another host, for search without a server: a copy takes its place."""
    shutil.copyfile(SHIM, site / "assets" / SHIM.name)
    for page in site.rglob("*.html"):
        here = Path(os.path.relpath(site / "assets" / SHIM.name, page.parent)).as_posix()
        page.write_text(page.read_text().replace(FOREIGN_SHIM, here))


if __name__ == "__main__":
    build(Path(sys.argv[1] if len(sys.argv) > 1 else ROOT / "build/site").resolve())
