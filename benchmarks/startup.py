"""How long the command line takes to answer: seconds of whole processes, the fastest of several.

    .venv/bin/python benchmarks/startup.py

Forms are compiled, and the file system is warm, from the first call of each on.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SCENE = str(ROOT / "demos" / "ball.toml")
COMMANDS = {
    "--help": ["--help"],
    "explain demos/ball.toml": ["explain", SCENE],
    "solve demos/ball.toml": ["solve", SCENE, "--output", "{folder}"],
    "--ranks 2 solve demos/ball.toml": ["--ranks", "2", "solve", SCENE, "--output", "{folder}"],
    "solve --plot demos/ball.toml": ["solve", SCENE, "--plot", "--output", "{folder}"],
}


def main() -> None:
    """Time every command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", type=int, default=5)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    for name, arguments in COMMANDS.items():
        with tempfile.TemporaryDirectory() as folder:
            command = [str(ROOT / "obstacle"), *(argument.format(folder=folder) for argument in arguments)]
            seconds = min(timed(command) for _ in range(options.times + 1))
        print(f"{seconds:6.2f} s  {name}", flush=True)
        if options.json is not None:
            with options.json.open("a") as file:
                file.write(json.dumps({"command": name, "seconds": seconds}) + "\n")


def timed(command: list[str]) -> float:
    """Seconds of one process."""
    start = time.perf_counter()
    subprocess.run(command, check=True, capture_output=True)
    return time.perf_counter() - start


if __name__ == "__main__":
    main()
