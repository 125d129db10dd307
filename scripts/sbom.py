"""Write a bill of materials (CycloneDX 1.6, JSON) of an environment and of the page: `sbom.py [FILE [PYTHON]]`.

FILE is out/sbom.cdx.json by default; PYTHON is the interpreter of the environment, by default this one. The same
environment gives the same file, byte for byte. `make sbom` writes the bill of the service as it is installed.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
DEFAULT = ROOT / "out" / "sbom.cdx.json"
VENDORED = ROOT / "service" / "web" / "vendor" / "vendored.json"


def write_sbom(file: Path, python: str = sys.executable) -> None:
    """Write the bill of the environment of `python`. Raises CalledProcessError where it cannot be made."""
    file.parent.mkdir(parents=True, exist_ok=True)
    # Without qualifiers a package's address does not say from where it was downloaded here.
    options = ["--output-reproducible", "--short-PURLs", "--sv", "1.6", "--of", "JSON", "-o", str(file)]
    subprocess.run([sys.executable, "-m", "cyclonedx_py", "environment", *options, python], check=True)
    bill = json.loads(file.read_text())
    bill["components"] += [vendored(part) for part in json.loads(VENDORED.read_text())]
    file.write_text(json.dumps(bill, indent=2) + "\n")


def vendored(part: dict[str, Any]) -> dict[str, Any]:
    """A part that the page brings in its own files, as a component."""
    return {
        "type": "library",
        "bom-ref": part["purl"],
        "name": part["name"],
        "version": part["version"],
        "purl": part["purl"],
        "licenses": [{"license": {"id": part["licence"]}}],
        "scope": "required",
    }


def main(arguments: list[str]) -> int:
    """Run the command line; the exit status."""
    if len(arguments) > 2 or "--help" in arguments:
        print(__doc__)
        return 2
    file = Path(arguments[0]) if arguments else DEFAULT
    write_sbom(file, *arguments[1:])
    print(file)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
