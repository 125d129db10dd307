"""Draw the Mermaid diagrams of the documentation for the site: `diagrams.py MERMAID.js`, with Chromium.

MERMAID.js is `dist/mermaid.tiny.js` of the npm package @mermaid-js/tiny. Each drawing is named by the hash of its text,
so none is ever out of date; `scripts/site.py` shows the text itself where there is no drawing.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from scripts.site import DIAGRAM, ROOT, drawing_of

PAGE = """<!doctype html><meta charset=utf-8><body><script src="{script}"></script><script>
mermaid.initialize({{startOnLoad: false, theme: "neutral", htmlLabels: false, flowchart: {{htmlLabels: false}}}});
mermaid.render("d", {text}).then(drawn => {{ document.body.innerHTML = drawn.svg; }});
</script></body>"""


def draw(text: str, script: Path) -> str:
    """The SVG of a diagram. Raises ValueError where Mermaid refuses it."""
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / "page.html"
        page.write_text(PAGE.format(script=script.resolve().as_uri(), text=json.dumps(text)))
        options = ["--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=8000", "--dump-dom"]
        shown = subprocess.run(["chromium", *options, page.as_uri()], capture_output=True, text=True, check=True).stdout
    found = re.search(r"<svg.*</svg>", shown, re.DOTALL)
    if found is None:
        raise ValueError(f"no drawing of {text[:60]!r}")
    size = re.search(r'viewBox="\S+ \S+ ([\d.]+) ([\d.]+)"', found[0])
    width, height = (round(float(value)) for value in size.groups()) if size else (800, 400)
    drawn = found[0].replace("<br>", "<br/>").replace("&nbsp;", " ")
    return drawn.replace('width="100%"', f'width="{width}" height="{height}"', 1) + "\n"


if __name__ == "__main__":
    pages = [page for where in ("docs/**/*.md", "ros/**/*.md", "*.md") for page in ROOT.glob(where)]
    for diagram in (text for page in pages for text in DIAGRAM.findall(page.read_text())):
        drawing_of(diagram).parent.mkdir(parents=True, exist_ok=True)
        drawing_of(diagram).write_text(draw(diagram, Path(sys.argv[1])))
