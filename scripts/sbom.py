"""Write what this environment consists of as a software bill of materials (CycloneDX 1.6, JSON): `sbom.py [FILE]`.

FILE is out/sbom.cdx.json by default. The same environment gives the same file, byte for byte.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
DEFAULT = ROOT / "out" / "sbom.cdx.json"


def write_sbom(file: Path) -> None:
    """Write the bill of the running interpreter's environment. Raises CalledProcessError where it cannot be made."""
    file.parent.mkdir(parents=True, exist_ok=True)
    # Without qualifiers a package's address does not say from where it was downloaded here.
    options = ["--output-reproducible", "--short-PURLs", "--sv", "1.6", "--of", "JSON", "-o", str(file)]
    subprocess.run([sys.executable, "-m", "cyclonedx_py", "environment", *options, sys.executable], check=True)


def main(arguments: list[str]) -> int:
    """Run the command line; the exit status."""
    if len(arguments) > 1 or "--help" in arguments:
        print(__doc__)
        return 2
    file = Path(arguments[0]) if arguments else DEFAULT
    write_sbom(file)
    print(file)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
