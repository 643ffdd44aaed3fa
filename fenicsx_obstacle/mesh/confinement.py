"""A process that may read, but starts no program, writes no file and opens no connection: the kernel sees to it.

A .geo is a program: `SystemCall` runs a command, `Save` and `Print` write files, and a field may start a process. A
scan of its text proves nothing, since it may include or compose what it runs. So the process that reads it gives these
system calls up for good (seccomp); one that makes such a call all the same is ended by SIGSYS.
"""

from __future__ import annotations

import ctypes
import os

_ALLOW, _END, _MISSING = 0x7FFF0000, 0x80000000, 0x00050000 | 38  # actions of libseccomp: run, SIGSYS, ENOSYS
_MASKED = 7  # comparison: argument & a == b
_ALL_THREADS = 4  # attribute: the filter is for all threads
_THREAD = 0x10000  # CLONE_THREAD
_REFUSED = (
    "execve", "execveat", "fork", "vfork", "kill", "ptrace", "socket", "io_uring_setup", "openat2", "creat", "truncate",
    "mknod", "mknodat", "mkdir", "mkdirat", "rmdir", "unlink", "unlinkat", "rename", "renameat", "renameat2", "link",
    "linkat", "symlink", "symlinkat", "chmod", "fchmodat", "chown", "fchownat", "lchown",
)  # fmt: skip


class _Comparison(ctypes.Structure):
    _fields_ = (("argument", ctypes.c_uint), ("kind", ctypes.c_int), ("a", ctypes.c_uint64), ("b", ctypes.c_uint64))


def confine() -> bool:
    """Give up starting programs, writing files and opening connections; files that are open stay so (local).

    Returns:
        Whether the kernel enforces it; False without libseccomp, or where the system does not allow filters.
    """
    try:
        library = ctypes.CDLL("libseccomp.so.2")
    except OSError:
        return False
    library.seccomp_init.restype = ctypes.c_void_p
    library.seccomp_rule_add_array.argtypes = (
        ctypes.c_void_p, ctypes.c_uint32, ctypes.c_int, ctypes.c_uint, ctypes.POINTER(_Comparison),
    )  # fmt: skip
    rules = ctypes.c_void_p(library.seccomp_init(ctypes.c_uint32(_ALLOW)))

    def add(action: int, name: str, *comparison: int) -> int:
        number = library.seccomp_syscall_resolve_name(name.encode())
        if number == -1:  # an older library does not know the call
            return 0
        where = _Comparison(comparison[0], _MASKED, *comparison[1:]) if comparison else None
        return library.seccomp_rule_add_array(rules, action, number, len(comparison) // 3, where)

    wrong = [add(_END, name) for name in _REFUSED]
    wrong += [add(_MISSING, "clone3"), add(_END, "clone", 0, _THREAD, 0)]  # a new thread is no new process
    for name, flags in (("open", 1), ("openat", 2)):
        wrong += [add(_END, name, flags, os.O_ACCMODE, mode) for mode in (os.O_WRONLY, os.O_RDWR)]
        wrong += [add(_END, name, flags, flag, flag) for flag in (os.O_CREAT, os.O_TRUNC)]
    wrong += [library.seccomp_attr_set(rules, _ALL_THREADS, 1)]
    # negative numbers stand for calls that this kind of processor does not have
    return not any(wrong) and library.seccomp_load(rules) == 0
