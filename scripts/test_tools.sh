#!/usr/bin/env bash
# Install the programs that tests of promises need and Python does not bring: for root on Debian or Ubuntu.
# Anywhere else the tests that miss one are skipped, and say so; continuous integration fails for it.
set -euo pipefail

# Programs, and the packages that bring them.
TOOLS=(strace:strace chromium:chromium cc:gcc,libc6-dev curl:curl unshare:util-linux prlimit:util-linux)

missing_packages() {
    local entry
    for entry in "${TOOLS[@]}"; do
        command -v "${entry%%:*}" >/dev/null || tr ',' '\n' <<<"${entry##*:}"
    done | sort -u
}

needs_promtool() {
    ! command -v promtool >/dev/null
}

# promtool is one file of Debian's package of Prometheus, whose installation would start a server.
unpack_promtool() {
    local folder
    folder=$(mktemp -d)
    (cd "$folder" && apt-get download -qq -o APT::Sandbox::User=root prometheus && dpkg-deb -x prometheus_*.deb .)
    install "$folder/usr/bin/promtool" /usr/local/bin/promtool
    rm -r "$folder"
}

mapfile -t packages < <(missing_packages)
[ "${#packages[@]}" -gt 0 ] || needs_promtool || exit 0
if [ "$(id -u)" != 0 ] || ! command -v apt-get >/dev/null; then
    echo "Some tests need these packages: ${packages[*]} $(needs_promtool && echo prometheus)" >&2
    exit 1
fi
echo "Installing what tests need: ${packages[*]} $(needs_promtool && echo promtool)"
apt-get update -qq -o Acquire::Retries=3
! needs_promtool || unpack_promtool
[ "${#packages[@]}" -gt 0 ] || exit 0
DEBIAN_FRONTEND=noninteractive apt-get install -y -qq -o Acquire::Retries=3 --no-install-recommends "${packages[@]}" >/dev/null
