#!/usr/bin/env bash
# Install the programs that tests of promises need and Python does not bring: for root on Debian or Ubuntu.
# Anywhere else the tests that miss one are skipped, and say so; continuous integration fails for it.
set -euo pipefail

# Programs, and the packages that bring them.
TOOLS=(strace:strace chromium:chromium cc:gcc,libc6-dev curl:curl unshare:util-linux prlimit:util-linux
    systemd-analyze:systemd,libseccomp2)

# Single files of packages whose installation would start a server.
FILES=(prometheus:/usr/bin/promtool nginx:/usr/sbin/nginx)

missing_packages() {
    local entry
    for entry in "${TOOLS[@]}"; do
        command -v "${entry%%:*}" >/dev/null || tr ',' '\n' <<<"${entry##*:}"
    done | sort -u
}

missing_files() {
    local entry
    for entry in "${FILES[@]}"; do
        command -v "$(basename "$entry")" >/dev/null || echo "$entry"
    done
}

# unpack PACKAGE:FILE: puts the file of a package, and nothing else of it, in /usr/local/bin.
unpack() {
    local folder
    folder=$(mktemp -d)
    (cd "$folder" && apt-get download -qq -o APT::Sandbox::User=root "${1%%:*}" && dpkg-deb -x ./*.deb .)
    install "$folder${1##*:}" /usr/local/bin/
    rm -r "$folder"
}

mapfile -t packages < <(missing_packages)
mapfile -t files < <(missing_files)
[ "${#packages[@]}" -gt 0 ] || [ "${#files[@]}" -gt 0 ] || exit 0
if [ "$(id -u)" != 0 ] || ! command -v apt-get >/dev/null; then
    echo "Some tests need these packages: ${packages[*]} ${files[*]%%:*}" >&2
    exit 1
fi
echo "Installing what tests need: ${packages[*]} ${files[*]##*/}"
apt-get update -qq -o Acquire::Retries=3
for file in "${files[@]}"; do unpack "$file"; done
[ "${#packages[@]}" -gt 0 ] || exit 0
DEBIAN_FRONTEND=noninteractive apt-get install -y -qq -o Acquire::Retries=3 --no-install-recommends "${packages[@]}" >/dev/null
