"""Run a command under the system calls and the address families that a unit file of systemd leaves it.

`python -m tests.support.confined UNIT COMMAND...` loads the filter that systemd would load, by libseccomp, and becomes
the command. Without systemd as the first process this is as near as one comes; `systemd-analyze` tells the calls.
"""

from __future__ import annotations

import ctypes
import errno
import os
import re
import socket
import subprocess
import sys
from pathlib import Path

ALLOW, REFUSE, EQUAL = 0x7FFF0000, 0x00050000, 4
FAMILIES = range(46)


class _Condition(ctypes.Structure):
    """`struct scmp_arg_cmp`: a condition on one argument of a system call."""

    _fields_ = (("arg", ctypes.c_uint), ("op", ctypes.c_int), ("a", ctypes.c_uint64), ("b", ctypes.c_uint64))


def values(unit: str, name: str) -> list[str]:
    """The values of a setting, in the order of the unit file."""
    return re.findall(rf"^{name}=(.*)$", unit, re.MULTILINE)


def allowed_calls(unit: str) -> set[str]:
    """The system calls that the SystemCallFilter lines allow: groups opened, those behind `~` taken away."""
    allowed: set[str] = set()
    for line in values(unit, "SystemCallFilter"):
        calls = set().union(*(_opened(name) for name in line.removeprefix("~").split()))
        allowed = allowed - calls if line.startswith("~") else allowed | calls
    return allowed


def _opened(name: str) -> set[str]:
    if not name.startswith("@"):
        return {name}
    listed = subprocess.run(["systemd-analyze", "syscall-filter", name], capture_output=True, text=True, check=True)
    names = (line.strip() for line in listed.stdout.splitlines()[1:])
    return set().union(*(_opened(one) for one in names if one and not one.startswith("#")))


def confine(unit: str) -> None:
    """Leave this process, and what it becomes, no more than the unit does. Raises OSError where the kernel refuses."""
    library = ctypes.CDLL("libseccomp.so.2", use_errno=True)
    library.seccomp_init.restype = ctypes.c_void_p
    number = library.seccomp_syscall_resolve_name
    held = ctypes.c_void_p(library.seccomp_init(REFUSE | errno.EPERM))
    for name in allowed_calls(unit) - {"socket"}:
        # A call of another architecture has a negative number.
        if (call := number(name.encode())) >= 0:
            library.seccomp_rule_add_array(held, ALLOW, call, 0, None)
    kept = {int(getattr(socket, name)) for line in values(unit, "RestrictAddressFamilies") for name in line.split()}
    for family in FAMILIES:
        condition = _Condition(0, EQUAL, family, 0)
        action = ALLOW if family in kept else REFUSE | errno.EAFNOSUPPORT
        library.seccomp_rule_add_array(held, action, number(b"socket"), 1, ctypes.byref(condition))
    if refused := library.seccomp_load(held):
        raise OSError(-refused, os.strerror(-refused))


if __name__ == "__main__":
    confine(Path(sys.argv[1]).read_text())
    os.execvp(sys.argv[2], sys.argv[2:])
