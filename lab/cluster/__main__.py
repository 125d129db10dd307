"""How much a service writes into a PostgreSQL, in processes of its own, as ratios to pgbench on the same disk.

`python -m lab.cluster URL --pgbench PROGRAM`: the database must be empty, and is left with made-up rows.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from lab.cluster.workloads import acknowledge, queue_jobs, work_off
from revisit.service.engines.postgres.connections import server_url
from revisit.service.engines.postgres.migration import migrate

CLIENTS = 16
ROBOTS = 64
"""Of a gateway: scans that wait for their acknowledgement at a time."""

JOBS = 20_000


def main() -> None:
    """Measure, and print one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("url")
    parser.add_argument("--pgbench", default="pgbench", help="the program of the server's version")
    parser.add_argument("--seconds", type=float, default=15.0, help="of each measurement")
    options = parser.parse_args()
    migrate(server_url(options.url))
    print(json.dumps(_measured(options.url, options.pgbench, options.seconds), indent=2))


def _measured(url: str, pgbench: str, seconds: float) -> dict[str, object]:
    bench = {clients: _pgbench(url, pgbench, clients, seconds) for clients in (1, CLIENTS)}
    figures = {f"acknowledgements/s, {n} gateways": _rate(acknowledge, url, n, ROBOTS, seconds) for n in (1, 3)}
    queue_jobs(url, JOBS)
    figures[f"claims and completions/s, {CLIENTS} clients"] = _rate(work_off, url, 4, CLIENTS // 4, seconds)
    after = {clients: _pgbench(url, pgbench, clients, seconds) for clients in (1, CLIENTS)}
    base = (bench[CLIENTS] + after[CLIENTS]) / 2
    return {
        "load": os.getloadavg()[0],
        "pgbench -N transactions/s, before and after": {clients: (bench[clients], after[clients]) for clients in bench},
        **{name: round(rate) for name, rate in figures.items()},
        "in those of pgbench with 16 clients": {name: round(rate / base, 2) for name, rate in figures.items()},
    }


def _rate(work: Callable[[str, int, int, float], int], url: str, processes: int, each: int, seconds: float) -> float:
    """Calls of `work` a second, in so many processes at once."""
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        running = [pool.submit(work, url, number, each, seconds) for number in range(processes)]
        return sum(run.result() for run in running) / seconds


def _pgbench(url: str, program: str, clients: int, seconds: float) -> float:
    """Transactions a second of pgbench's simple updates."""
    target = server_url(url).set(drivername="postgresql").render_as_string(hide_password=False)
    subprocess.run([program, "-i", "-q", "-s", "10", target], check=True, capture_output=True)
    command = [program, "-n", "-N", "-c", str(clients), "-j", "2", "-T", str(max(1, int(seconds))), target]
    told = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    found = re.search(r"tps = ([0-9.]+)", told)
    assert found is not None, told
    return round(float(found.group(1)), 1)


if __name__ == "__main__":
    main()
