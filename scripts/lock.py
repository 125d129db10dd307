"""Write the hashes of wheels as a file that pip takes with --require-hashes: `lock.py FOLDER... > requirements.lock`.

`pip download --only-binary :all: -c constraints.txt -d FOLDER '.[service]' setuptools` fills a FOLDER. Give one for
each platform that the file is to serve. It names each distribution's pinned version and every wheel of it that was
there. docker/Dockerfile takes it where it lies in the root of the repository.
"""

from __future__ import annotations

import hashlib
import sys
from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path

from packaging.utils import canonicalize_name, parse_wheel_filename
from packaging.version import Version

ROOT = Path(__file__).resolve().parent.parent


class DoesNotFit(ValueError):
    """A wheel that is not the pinned version of anything."""


def pins(constraints: str) -> dict[str, Version]:
    """Distribution -> version, of the lines `name==version`."""
    pairs = (line.split("==") for line in constraints.splitlines() if "==" in line)
    return {canonicalize_name(name): Version(version.strip()) for name, version in pairs}


def locked(wheels: Iterable[Path], pinned: dict[str, Version]) -> Iterator[str]:
    """The lines of the file, by name. Raises DoesNotFit for a wheel that the pins do not name, OSError."""
    hashes: dict[str, set[str]] = defaultdict(set)
    for wheel in wheels:
        name, version, _, _ = parse_wheel_filename(wheel.name)
        # `2.13.0+cpu` is a build of its own that satisfies `==2.13.0`; its hash is not that of the public one.
        if name not in pinned or version.public != pinned[name].public:
            raise DoesNotFit(f"{wheel.name} is not what constraints.txt pins")
        hashes[f"{name}=={version}"].add(sha256(wheel))
    for requirement in sorted(hashes):
        yield " \\\n    ".join([requirement, *(f"--hash=sha256:{digest}" for digest in sorted(hashes[requirement]))])


def sha256(file: Path) -> str:
    """The hash of a file, in hexadecimal."""
    with file.open("rb") as opened:
        return hashlib.file_digest(opened, "sha256").hexdigest()


def main(arguments: list[str]) -> int:
    """Run the command line; the exit status."""
    if not arguments or "--help" in arguments:
        print(__doc__)
        return 2
    wheels = [wheel for folder in arguments for wheel in Path(folder).glob("*.whl")]
    try:
        lines = list(locked(wheels, pins((ROOT / "constraints.txt").read_text())))
    except (DoesNotFit, OSError) as error:
        print(error, file=sys.stderr)
        return 1
    print("\n".join(lines))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
