"""Build the documentation as a website from `docs`, README, CHANGELOG and the ROS package: `site.py [OUT]`.

The pages are those of the repository. Links to files that are no pages of the site are shown as names. The site asks
nothing of other hosts, and its search works without a server. OUT is `build/site` by default.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGES = {
    "README.md": "index.md",
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
    "ros/revisit_bridge/README.md": "reference/ros-2-bridge.md",
}
"""File of the repository -> page of the site; besides these everything under `docs`, without that prefix."""

_LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)\s#]*)(#[^)\s]*)?\)")
_FENCED = re.compile(r"(^```.*?^```$)", re.MULTILINE | re.DOTALL)


def page_of(file: Path) -> Path | None:
    """Where a file of the repository is in the site, None where it is not part of it."""
    told = file.as_posix()
    if told in PAGES:
        return Path(PAGES[told])
    return Path(*file.parts[1:]) if file.parts[:1] == ("docs",) else None


def rewritten(text: str, file: Path) -> str:
    """The text of a file of the repository with its links as they are in the site."""
    parts = _FENCED.split(text)
    return "".join(part if part.startswith("```") else _LINK.sub(lambda m: _link(m, file), part) for part in parts)


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


def build(out: Path) -> None:
    """Build the site. Raises CalledProcessError for any warning: a page without a place, a link that leads nowhere."""
    pages = ROOT / "build/site-pages"
    shutil.rmtree(pages, ignore_errors=True)
    collect(pages)
    command = [
        sys.executable,
        "-m",
        "mkdocs",
        "build",
        "--strict",
        "-q",
        "-f",
        str(ROOT / "mkdocs.yml"),
        "-d",
        str(out),
    ]
    subprocess.run(command, check=True, cwd=ROOT, env={**os.environ, "NO_MKDOCS_2_WARNING": "1"})


if __name__ == "__main__":
    build(Path(sys.argv[1] if len(sys.argv) > 1 else ROOT / "build/site").resolve())
