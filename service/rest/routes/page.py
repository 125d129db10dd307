"""The page: every file of `service/web`, by its name there."""

from __future__ import annotations

from pathlib import Path

from fastapi import APIRouter, Response
from fastapi.responses import FileResponse

from revisit.service.rest.access import PUBLIC

WEB = Path(__file__).resolve().parents[2] / "web"

MEDIA_TYPES = {".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}

KEPT_BY_BROWSERS = {"cache-control": "public, max-age=86400, immutable"}
"""Of the files in `vendor`: their folder has the version in its name."""

router = APIRouter()


SMALL_BYTES = 32 * 2**10
"""A file up to this size is kept in memory: to read it takes four turns of threads, and callers without a key may ask
for many. A larger one is sent in pieces, so that nobody has it whole in our buffers.
"""


def _serve(path: str, file: Path) -> None:
    """Answer `path` with a file."""
    headers = KEPT_BY_BROWSERS if "vendor" in file.relative_to(WEB).parts else None
    media_type, small = MEDIA_TYPES[file.suffix], file.stat().st_size <= SMALL_BYTES
    content = file.read_bytes() if small else b""

    async def answer() -> Response:
        if small:
            return Response(content, media_type=media_type, headers=headers)
        return FileResponse(file, media_type=media_type, headers=headers)

    router.add_api_route(path, answer, include_in_schema=False, name=path, dependencies=[PUBLIC])


_serve("/", WEB / "index.html")
_serve("/docs", WEB / "docs.html")
_serve("/try", WEB / "try.html")
for _file in sorted(file for file in WEB.rglob("*") if file.suffix in MEDIA_TYPES and file.suffix != ".html"):
    _serve(f"/{_file.relative_to(WEB).as_posix()}", _file)
