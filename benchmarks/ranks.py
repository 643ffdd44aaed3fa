"""What a second rank is worth: the same solve on 1, 2, ... ranks compared with the Poisson solve on as many.

    .venv/bin/python benchmarks/ranks.py demos/ball.toml --cells 1024 --ranks 1,2

Memory bandwidth bounds both, so the speed-up of the Poisson solve is what to compare with.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

LADDER = Path(__file__).with_name("ladder.py")


def main() -> None:
    """Run the ladder on each number of ranks and print the ratios."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene")
    parser.add_argument("--cells", default="1024")
    parser.add_argument("--eps", default="h^2,1e-8,1e-12")
    parser.add_argument("--ranks", default="1,2")
    parser.add_argument("--times", default="3")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    print(f"{'ranks':>5} {'cells':>6} {'way':>12} {'Newton':>7} {'CG':>4} {'s':>7} {'speed-up':>9} "
          f"{'Poisson s':>10} {'speed-up':>9}")  # fmt: skip
    first: dict[tuple[str, int], dict] = {}
    for ranks in map(int, options.ranks.split(",")):
        for record in measured(ranks, options):
            one = first.setdefault((record["way"], record["cells"]), record)
            seconds, poisson = record["seconds"]["solve"], record["poisson_seconds"]
            print(f"{ranks:5} {record['cells']:6} {record['way']:>12} {record['newton_iterations']:7} "
                  f"{record['krylov_iterations']:4} {seconds:7.2f} {one['seconds']['solve'] / seconds:9.2f} "
                  f"{poisson:10.2f} {one['poisson_seconds'] / poisson:9.2f}", flush=True)  # fmt: skip
            if options.json is not None:
                with options.json.open("a") as file:
                    file.write(json.dumps(record) + "\n")


def measured(ranks: int, options: argparse.Namespace) -> list[dict]:
    """The records of one run of the ladder."""
    with tempfile.TemporaryDirectory() as folder:
        lines = Path(folder) / "lines"
        launcher = ["mpirun", "-n", str(ranks), "--bind-to", "none", sys.executable]
        keys = ["--cells", options.cells, "--eps", options.eps, "--times", options.times, "--json", str(lines)]
        command = [*launcher, str(LADDER), options.scene, *keys]
        environment = {"OMP_NUM_THREADS": "1", **os.environ}
        subprocess.run(command, check=True, env=environment, stdout=subprocess.DEVNULL)
        return [json.loads(line) for line in lines.read_text().splitlines()]


if __name__ == "__main__":
    main()
