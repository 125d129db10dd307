"""How much a service writes into a PostgreSQL, in processes of its own, as ratios to pgbench on the same disk.

`python -m lab.cluster URL --pgbench PROGRAM`: the database must be empty, and is left with made-up rows. CPU of the
server is told where it runs on this machine.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path

from sqlalchemy import create_engine, text

from lab.cluster.workloads import Figures, acknowledge, queue_jobs, work_off
from revisit.service.engines.postgres.connections import server_url
from revisit.service.engines.postgres.migration import migrate

CLIENTS = 16
ROBOTS = 64
"""Of a gateway: scans that wait for their acknowledgement at a time."""

IN_FLIGHT = 6
"""As many of them as a gateway has of one tenant at a time, by its limit of clouds in flight."""

JOBS_A_SECOND = 600
"""More than are worked off."""


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
    bench = [_pgbench(url, pgbench, seconds)]
    by_itself = partial(acknowledge, together=False)
    told = {"acknowledgements, 1 gateway, each by itself": _figures(by_itself, url, 1, ROBOTS, seconds)}
    for gateways in (1, 3):
        told[f"acknowledgements, gateways: {gateways}"] = _figures(acknowledge, url, gateways, ROBOTS, seconds)
    for robots in (IN_FLIGHT, 1):
        told[f"acknowledgements, 1 gateway, robots: {robots}"] = _figures(acknowledge, url, 1, robots, seconds)
    queue_jobs(url, int(JOBS_A_SECOND * seconds))
    told[f"claims and completions, clients: {CLIENTS}"] = _figures(work_off, url, 4, CLIENTS // 4, seconds)
    bench.append(_pgbench(url, pgbench, seconds))
    base = sum(bench) / len(bench)
    ratios = {name: round(figures["a second"] / base, 2) for name, figures in told.items()}
    return {
        "load": os.getloadavg()[0],
        f"pgbench -N transactions/s with {CLIENTS} clients, before and after": bench,
        **told,
        "in those of pgbench": ratios,
    }


def _figures(
    work: Callable[[str, int, int, float], Figures], url: str, processes: int, each: int, seconds: float
) -> dict[str, float]:
    """Calls of `work` a second, in so many processes at once; CPU ms and statements of a call."""
    began_s = _server_cpu_s(url)
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        running = [pool.submit(work, url, number, each, seconds) for number in range(processes)]
        found = [run.result() for run in running]
    calls = max(1, sum(one.calls for one in found))
    return {
        "a second": round(calls / seconds, 1),
        "client CPU ms": round(1000 * sum(one.cpu_s for one in found) / calls, 3),
        "server CPU ms": round(1000 * (_server_cpu_s(url) - began_s) / calls, 3),
        "statements": round(sum(one.statements for one in found) / calls, 2),
    }


def _server_cpu_s(url: str) -> float:
    """CPU seconds that the server's processes have used; 0 where it runs elsewhere."""
    engine = create_engine(server_url(url))
    with engine.connect() as connection:
        told = Path(connection.execute(text("SHOW data_directory")).scalar_one()) / "postmaster.pid"
    engine.dispose()
    if not told.exists():
        return 0.0
    server = int(told.read_text().split()[0])
    stats = {pid: _stat(pid) for pid in Path("/proc").iterdir() if pid.name.isdecimal()}
    of_server = [stat for pid, stat in stats.items() if stat and server in (int(pid.name), stat[0])]
    # Those that have ended are in the sums of their parent.
    return sum(sum(times) for _, *times in of_server) / os.sysconf("SC_CLK_TCK")


def _stat(process: Path) -> tuple[int, ...]:
    """The parent of a process, and its clock ticks and those of its ended children."""
    try:
        fields = (process / "stat").read_text().rpartition(")")[2].split()
    except OSError:
        return ()
    return int(fields[1]), *(int(fields[at]) for at in (11, 12, 13, 14))


def _pgbench(url: str, program: str, seconds: float) -> float:
    """Transactions a second of pgbench's simple updates."""
    target = server_url(url).set(drivername="postgresql").render_as_string(hide_password=False)
    subprocess.run([program, "-i", "-q", "-s", "10", target], check=True, capture_output=True)
    command = [program, "-n", "-N", "-c", str(CLIENTS), "-j", "2", "-T", str(max(1, int(seconds))), target]
    told = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    found = re.search(r"tps = ([0-9.]+)", told)
    assert found is not None, told
    return round(float(found.group(1)), 1)


if __name__ == "__main__":
    main()
