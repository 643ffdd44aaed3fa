"""Full disks and folders that cannot be written: one clear message, and old files are kept.

A small file system of its own is mounted where that is permitted, in a mount namespace that ends with the process;
elsewhere files may not grow beyond a size.
"""

from __future__ import annotations

import hashlib
import os
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path

from tests.cli.faults.kill import Fault
from tests.processes import launch, launch_module

SIZES = (0, 100, 1000, 4000, 20000)  # bytes that a file may have, or that are left on the disk
FULL, READ_ONLY = ("No space left", "File too large"), ("Read-only file system",)
COMMANDS = {
    "solve": ("solve", "disk_flat", "--cells", "24"),
    "solve with a picture": ("solve", "disk_flat", "--cells", "12", "--plot"),
    "study": ("study", "disk_flat", "--cells", "8", "--vary", "eps=1e-1..1e-3"),
}
OF_PICTURES = {"answer.png", "report.html"}
PATIENCE = 60.0
ALONE = {"OMPI_MCA_btl": "self"}  # one rank needs no shared memory, which Open MPI 5 and 6 make of files


def disks(root: Path, environment: Mapping[str, str]) -> Iterator[Fault]:
    """All of them, on one rank, and where a disk can be mounted on two."""
    earlier = root / "earlier"
    for name, command in COMMANDS.items():
        done = _run(1, [*command[:2], "--cells", "8", *command[4:]], earlier / name, environment)
        if done.returncode != 0:
            yield Fault(f"{name}, undisturbed", done.stderr[-300:], 0.0)
            return
    for name, command in COMMANDS.items():
        for size in SIZES:
            folder = root / f"limited-{size}" / name
            shutil.copytree(earlier / name, folder)
            limit = partial(resource.setrlimit, resource.RLIMIT_FSIZE, (size, size))
            alone = {**environment, **ALONE}
            yield _refused(f"{name}: files of {size} bytes at most", 1, command, folder, alone, FULL, limit)
    yield from _mounted(root, earlier, environment)


def _mounted(root: Path, earlier: Path, environment: Mapping[str, str]) -> Iterator[Fault]:
    if subprocess.run(["unshare", "-m", "true"], capture_output=True, check=False).returncode != 0:
        return
    for ranks in (1, 2):
        for name, command in COMMANDS.items():
            for size in (*SIZES[1::2], None):
                mount = root / f"mounted-{ranks}-{size}" / name
                mount.mkdir(parents=True)
                words = ["unshare", "-m", *launch_module(1, "tests.cli.faults.disk"), str(mount), str(earlier / name),
                         str(-1 if size is None else size), str(ranks), *command]  # fmt: skip
                start = time.perf_counter()
                done = subprocess.run(words, env=environment, capture_output=True, text=True, check=False)
                what = "that is read-only" if size is None else f"with {size} bytes left"
                wrong = (done.stdout + done.stderr[-300:]).strip()
                yield Fault(f"{name} on {ranks}: a disk {what}", wrong, time.perf_counter() - start)


def _refused(
    name: str, ranks: int, command: tuple[str, ...], folder: Path, environment: Mapping[str, str],
    words: tuple[str, ...], preexec: Callable[[], object] | None = None,
) -> Fault:  # fmt: skip
    """A command that cannot write says so, and leaves the folder as it was, but for rows that are whole.

    Where a picture alone cannot be written the new answer is there, without picture and page of the earlier one.
    """
    before, start = _prints(folder), time.perf_counter()
    done = _run(ranks, list(command), folder, environment, preexec)
    after, wrong = _prints(folder), ""
    if done.returncode not in (0, 2) or (done.returncode == 0 and preexec is None):
        wrong = f"status {done.returncode}: {done.stderr.strip()[-300:]}"
    elif done.returncode == 2 and not any(word in done.stderr for word in words):
        wrong = f"unclear: {done.stderr.strip()[-300:]}"
    elif done.returncode == 2 and (done.stderr.count("Error: ") != 1 or "Traceback" in done.stderr):
        wrong = f"not one message: {done.stderr.strip()[-300:]}"
    elif done.returncode == 2:
        changed = [file for file, print_ in before.items() if after.get(file) != print_ and "rows." not in file]
        added = sorted(set(after) - set(before))
        if "--plot" in command and set(before) - set(after) == OF_PICTURES and _is_whole(folder, environment):
            changed, added = [], []
        wrong = f"changed {changed}, left {added}" if changed or added else ""
    return Fault(name, wrong, time.perf_counter() - start)


def _is_whole(folder: Path, environment: Mapping[str, str]) -> bool:
    """Whether a saved answer can be read: its files are those that it states."""
    words = [*launch(1, "-m", "fenicsx_obstacle", "compare"), str(folder), str(folder)]
    return subprocess.run(words, env=environment, capture_output=True, check=False, timeout=PATIENCE).returncode == 0


def _run(
    ranks: int, command: list[str], folder: Path, environment: Mapping[str, str],
    preexec: Callable[[], object] | None = None,
) -> subprocess.CompletedProcess[str]:  # fmt: skip
    words = [*launch(ranks, "-m", "fenicsx_obstacle", *command), "--output", str(folder)]
    return subprocess.run(words, env=environment, capture_output=True, text=True, errors="replace", check=False,
                          timeout=PATIENCE, preexec_fn=preexec)  # fmt: skip


def _prints(folder: Path) -> dict[str, str]:
    """A hash of each file, by its name."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def main() -> None:
    """In a mount namespace of its own: mount, copy, fill up or lock, run, and print what is wrong."""
    mount, earlier, size, ranks, *command = sys.argv[1:]
    done = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=2m", "tmpfs", mount], capture_output=True, check=False)
    if done.returncode != 0:
        return  # not permitted: the limits of the size of files have shown what they can
    folder = Path(mount) / "out"
    shutil.copytree(earlier, folder)
    if int(size) < 0:
        subprocess.run(["mount", "-o", "remount,ro", mount], check=True)
    else:
        left = os.statvfs(mount).f_bavail * os.statvfs(mount).f_frsize
        (Path(mount) / "filler").write_bytes(bytes(max(left - int(size), 0)))
    words = READ_ONLY if int(size) < 0 else FULL
    fault = _refused("", int(ranks), tuple(command), folder, os.environ, words)
    sys.stdout.write(fault.wrong + "\n")


if __name__ == "__main__":
    main()
