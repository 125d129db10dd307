#!/usr/bin/env bash
# Make .venv with everything the project needs. Safe to run again.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

# Shared libraries that the wheels of Open3D and OpenMP programs load, and the Debian packages that bring them.
LIBRARIES=(libEGL.so.1:libegl1 libGL.so.1:libgl1 libX11.so.6:libx11-6 libusb-1.0.so.0:libusb-1.0-0 libgomp.so.1:libgomp1)

missing_packages() {
    local entry known
    known="$(PATH="$PATH:/sbin:/usr/sbin" ldconfig -p 2>/dev/null || true)"
    for entry in "${LIBRARIES[@]}"; do
        grep -q "${entry%%:*} " <<<"$known" || printf '%s ' "${entry##*:}"
    done
}

ensure_system_libraries() {
    [ "$(uname -s)" = Linux ] || return 0
    local -a packages
    read -ra packages <<<"$(missing_packages)" || true
    [ "${#packages[@]}" -gt 0 ] || return 0
    if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
        echo "Installing system libraries: ${packages[*]}"
        apt-get update -qq
        DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${packages[@]}" >/dev/null
    else
        echo "These system libraries are missing: ${packages[*]}" >&2
        echo "On Debian or Ubuntu: sudo apt-get update && sudo apt-get install ${packages[*]}" >&2
        exit 1
    fi
}

find_python() {
    local candidate
    for candidate in "${PYTHON:-python3}" python3.13 python3.12 python3.11; do
        if command -v "$candidate" >/dev/null &&
            "$candidate" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 14))'; then
            echo "$candidate"
            return
        fi
    done
    echo "Python 3.11, 3.12 or 3.13 is needed; set PYTHON to its path" >&2
    exit 1
}

ensure_system_libraries
python="$(find_python)"
[ -x .venv/bin/python ] || "$python" -m venv .venv
echo "Installing into .venv (2 to 4 minutes the first time)"
.venv/bin/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
