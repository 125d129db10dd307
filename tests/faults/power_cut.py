"""Power cuts, replayed: the writes of a real run as strace saw them, cut anywhere, with what was not synced half there.

The model of a disk is as unkind as POSIX allows: bytes of a file are durable after fsync or fdatasync of that file, a
name is durable after fsync of its directory. Of everything else any part may be there after the cut: none of it, all
of it, the first writes with the last one torn at a sector, or any subset of the writes; names in the order in which
they were made. SQLite's shared memory file (-shm) is left out: it is never synced and made anew.
"""

from __future__ import annotations

import os
import random
import re
import shutil
import subprocess
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

SECTOR_BYTES = 512
SYSCALLS = (
    "openat,write,pwrite64,ftruncate,fsync,fdatasync,rename,renameat,renameat2,unlink,unlinkat,mkdir,mkdirat,rmdir"
)


@dataclass(frozen=True)
class Step:
    """A system call that changed the disk, or made a change durable. `offset` None appends; `target` is a new name."""

    call: str
    path: str
    data: bytes = b""
    offset: int | None = None
    target: str = ""


@dataclass(frozen=True)
class Recording:
    """What a program did below `root`, a folder that was empty at first, and what it appended to its log when."""

    root: str
    log: str
    steps: list[Step]


def record(folder: Path, program: list[str], cwd: Path) -> Recording:
    """Run `program` with the arguments folder/home and folder/log under strace. Raises CalledProcessError."""
    trace = folder / "trace"
    strace = ["strace", "-f", "-y", "-qq", "-xx", "-s", "100000000", "--seccomp-bpf", "-o", str(trace), "-e", SYSCALLS]
    arguments = [str(folder / "home"), str(folder / "log")]
    subprocess.run([*strace, *program, *arguments], cwd=cwd, check=True, capture_output=True)
    steps = [step for line in _whole_lines(trace.read_text()) if (step := _step(line, str(folder))) is not None]
    return Recording(arguments[0], arguments[1], steps)


_HEX = r"((?:\\x[0-9a-f]{2})*)"
_CALL = re.compile(rf"(\w+)\((?:\d+<{_HEX}>)?.* = (\d+)(?:<{_HEX}>)?", re.DOTALL)
_STRING = re.compile(rf'"{_HEX}"')
_NUMBERS = re.compile(r", (\d+)(?=[,)])")


def _whole_lines(trace: str) -> Iterator[str]:
    """The calls of all threads in the order in which they returned."""
    begun: dict[str, str] = {}
    for line in trace.splitlines():
        thread, _, text = line.partition(" ")
        text = text.lstrip()
        if text.endswith("<unfinished ...>"):
            begun[thread] = text.removesuffix("<unfinished ...>").rstrip()
        elif text.startswith("<... "):
            yield begun.pop(thread) + text.partition(" resumed>")[2]
        else:
            yield text


def _step(line: str, folder: str) -> Step | None:
    """The step of a call that succeeded below `folder`."""
    match = _CALL.match(line)
    if match is None:
        return None
    call, handle, result = match[1], _bytes(match[2]).decode(), int(match[3])
    strings = [_bytes(text) for text in _STRING.findall(line)]
    numbers = [int(number) for number in _NUMBERS.findall(line)]
    if call == "openat":
        path = _bytes(match[4]).decode()
        made = Step("create", path) if "O_CREAT" in line else None
        return made if path.startswith(folder) else None
    path = handle or strings[0].decode()
    if not path.startswith(folder):
        return None
    if call in ("write", "pwrite64"):
        return Step("write", path, strings[0][:result], numbers[-1] if call == "pwrite64" else None)
    if call == "ftruncate":
        return Step("truncate", path, offset=numbers[-1])
    if call.startswith("rename"):
        return Step("rename", strings[0].decode(), target=strings[1].decode())
    names = {"fsync": "sync", "fdatasync": "sync", "unlink": "remove", "unlinkat": "remove", "rmdir": "remove"}
    return Step(names.get(call, "make_directory"), path)


def _bytes(text: str | None) -> bytes:
    return bytes.fromhex((text or "").replace("\\x", ""))


@dataclass
class _File:
    """Durable bytes, and the writes (offset, bytes) and truncations (size) since."""

    durable: bytes = b""
    pending: list[tuple[int, bytes | None]] = field(default_factory=list)
    size: int = 0

    def write(self, offset: int | None, data: bytes) -> None:
        start = self.size if offset is None else offset
        self.pending.append((start, data))
        self.size = max(self.size, start + len(data))

    def truncate(self, size: int) -> None:
        self.pending.append((size, None))
        self.size = size

    def sync(self) -> None:
        self.durable, self.pending = _applied(self.durable, self.pending), []


@dataclass
class _Directory:
    """Durable names, and the changes (name, what it stands for now or None; a rename has two) since."""

    durable: dict[str, _Node] = field(default_factory=dict)
    pending: list[dict[str, _Node | None]] = field(default_factory=list)
    now: dict[str, _Node] = field(default_factory=dict)

    def change(self, names: dict[str, _Node | None]) -> None:
        self.pending.append(names)
        self.now = _renamed(self.now, [names])

    def sync(self) -> None:
        self.durable, self.pending = dict(self.now), []


_Node = _File | _Directory


class Disk:
    """The files below a folder, as a running program sees them and as they may be after a power cut."""

    def __init__(self, root: str) -> None:
        """`root` is empty and durable."""
        self._root = root
        self._top = _Directory()

    def take(self, step: Step) -> None:
        """Do what the program did. Calls on files that have no name any more change nothing that can be found."""
        if not step.path.startswith(self._root + "/"):
            if step.call == "sync" and step.path == self._root:
                self._top.sync()
            return
        directory, name = self._parent(step.path)
        node = directory.now.get(name)
        match step.call:
            case "create" if node is None:
                directory.change({name: _File()})
            case "make_directory":
                directory.change({name: _Directory()})
            case "remove" if node is not None:
                directory.change({name: None})
            case "rename" if node is not None:
                self._rename(directory, name, node, step.target)
            case "sync" if node is not None:
                node.sync()
            case "write" if isinstance(node, _File):
                node.write(step.offset, step.data)
            case "truncate" if isinstance(node, _File):
                node.truncate(step.offset or 0)

    def after_cut(self, how: str, rng: random.Random) -> dict[str, bytes]:
        """Files by their path below the root. `how`: nothing, everything, prefix or subset of what was not synced."""
        return dict(_survivors(self._top, "", how, rng))

    def _rename(self, directory: _Directory, name: str, node: _Node, target: str) -> None:
        other, new_name = self._parent(target)
        if other is directory:
            directory.change({name: None, new_name: node})
        else:
            other.change({new_name: node})
            directory.change({name: None})

    def _parent(self, path: str) -> tuple[_Directory, str]:
        directory: _Node = self._top
        *parents, name = Path(path).relative_to(self._root).parts
        for parent in parents:
            assert isinstance(directory, _Directory)
            directory = directory.now[parent]
        assert isinstance(directory, _Directory)
        return directory, name


def _survivors(directory: _Directory, prefix: str, how: str, rng: random.Random) -> Iterator[tuple[str, bytes]]:
    kept = {"nothing": 0, "everything": len(directory.pending)}.get(how, rng.randint(0, len(directory.pending)))
    for name, node in _renamed(directory.durable, directory.pending[:kept]).items():
        if isinstance(node, _Directory):
            yield from _survivors(node, f"{prefix}{name}/", how, rng)
        elif not name.endswith("-shm"):
            yield prefix + name, _applied(node.durable, _chosen(node.pending, how, rng))


def _chosen(pending: list[tuple[int, bytes | None]], how: str, rng: random.Random) -> list[tuple[int, bytes | None]]:
    """The writes that reached the disk."""
    if how in ("nothing", "everything"):
        return pending if how == "everything" else []
    if how == "prefix":
        chosen = pending[: rng.randint(0, len(pending))]
        return chosen[:-1] + [_torn(write, rng) for write in chosen[-1:]]
    return [_torn(write, rng) if rng.random() < 0.2 else write for write in pending if rng.random() < 0.5]


def _torn(write: tuple[int, bytes | None], rng: random.Random) -> tuple[int, bytes | None]:
    """Only some of the first sectors of a write."""
    offset, data = write
    return write if data is None else (offset, data[: SECTOR_BYTES * rng.randint(0, len(data) // SECTOR_BYTES)])


def _applied(content: bytes, writes: Iterable[tuple[int, bytes | None]]) -> bytes:
    made = bytearray(content)
    for offset, data in writes:
        made.extend(bytes(max(0, offset - len(made))))
        if data is None:
            del made[offset:]
        else:
            made[offset : offset + len(data)] = data
    return bytes(made)


def _renamed(names: dict[str, _Node], changes: Iterable[dict[str, _Node | None]]) -> dict[str, _Node]:
    made: dict[str, _Node | None] = dict(names)
    for change in changes:
        made.update(change)
    return {name: node for name, node in made.items() if node is not None}


@dataclass(frozen=True)
class CrashState:
    """The disk after a cut behind the `step`-th call, and the program's log up to there."""

    step: int
    how: str
    files: dict[str, bytes]
    log: bytes

    def restore(self, home: Path) -> None:
        """Make `home` hold these files and nothing else."""
        shutil.rmtree(home, ignore_errors=True)
        home.mkdir(parents=True)
        for name, content in self.files.items():
            path = home / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)


def crash_states(recording: Recording, count: int, seed: int = 0) -> Iterator[CrashState]:
    """At most `count` different states: behind every call without what was not synced, then with parts or all of it."""
    rng = random.Random(seed)
    seen: set[int] = set()
    for turn in range(count):
        disk, log = Disk(recording.root), b""
        for number, step in enumerate(recording.steps, start=1):
            disk.take(step)
            log += step.data if step.path == recording.log else b""
            how = rng.choice(("prefix", "subset", "everything")) if turn else "nothing"
            state = CrashState(number, how, disk.after_cut(how, rng), log)
            key = hash((log, *sorted(state.files.items())))
            if key not in seen:
                seen.add(key)
                yield state
            if len(seen) == count:
                return


def can_record() -> str:
    """Why calls cannot be recorded here; empty where they can."""
    if shutil.which("strace") is None:
        return "strace is not installed"
    tried = subprocess.run(["strace", "-qq", "-o", os.devnull, "true"], capture_output=True, check=False)
    return "" if tried.returncode == 0 else f"strace may not trace here: {tried.stderr.decode()[:200]}"


def python_program(module: str) -> list[str]:
    """The command that runs a module with this interpreter."""
    return [sys.executable, "-m", module]
