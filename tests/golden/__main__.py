"""Golden results: what the program computes, recorded from one version and compared with another.

    python tests/golden record --code FOLDER     record the baseline from a checkout (with its .venv)
    python tests/golden compare                  this checkout against the baseline; status 1 if anything differs
    python tests/golden compare --ranks 1 --only 'bound/*'

The results stand in tests/golden/baseline/RANKS.jsonl, one line each. `allowed.toml` lists differences that an issue
has declared. Numbers agree if they differ by 1e-9 of their scale; counts agree exactly, and those of linear steps to 2
on several ranks. What the recorded version itself does not repeat from run to run has the tolerance `loose` in its
line, or is not recorded (`varies`).
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parents[1])]

from differences import Difference, agreed, differences, expanded, shortened  # noqa: E402

from fenicsx_obstacle.launcher import environment, mpirun  # noqa: E402
from tests.processes import records  # noqa: E402

BASELINE = HERE / "baseline"
SILENCE = 1000.0  # seconds without a result after which the ranks are ended
ALWAYS = {"NUMPY_MADVISE_HUGEPAGE": "0", "COLUMNS": "120", "TERM": "dumb"}  # what memory and words depend on
Results = dict[str, dict[str, Any]]


def results(code: Path, ranks: int, only: str) -> Results:
    """Run the cases with the package of a checkout: name and values of each."""
    python = next((path for path in [code / ".venv" / "bin" / "python"] if path.exists()), Path(sys.executable))
    given = {**environment(), **ALWAYS, "PYTHONPATH": str(code)}  # first: the package of this checkout
    found: Results = {}
    with tempfile.TemporaryDirectory(prefix="golden") as scratch:
        work = [*(mpirun(ranks) if ranks > 1 else []), str(python), str(HERE / "worker.py"), scratch, only]
        for _ in range(20):  # a case that hangs or crashes is left out, and the others continue
            started = None
            for line in records(work, given, SILENCE, json.dumps(list(found))):
                if "last" in line:
                    return found
                started = line.get("begins")
                if started is None:
                    found[line["name"]] = line["values"]
            if started is None:
                raise SystemExit(f"no result could be computed: {' '.join(work)}")
            print(f"{ranks} ranks: {started} ended the run, or did not end", file=sys.stderr)
            found[started] = {"died": "took the process down, or did not end"}
    raise SystemExit("too many cases died")


def record(code: Path, ranks: int, only: str, repeats: int) -> None:
    """Write the baseline of so many ranks from several runs; lines that are not chosen stay."""
    runs = [results(code, ranks, only) for _ in range(repeats)]
    lines = {name: line for name, line in read(ranks).items() if not fnmatch(name, only)}
    for name in runs[0]:
        lines[name] = agreed(name, [run[name] for run in runs if name in run], ranks)
    write(lines, ranks)
    loose = sum(bool(line.get("loose") or line.get("varies")) for line in lines.values())
    print(f"{ranks} ranks: {len(runs[0])} results recorded, {loose} of {len(lines)} with values that vary")


def compare(code: Path, ranks: int, only: str, allowed: list[dict[str, str]]) -> list[Difference]:
    """Differences from the baseline that are not allowed."""
    before, after = read(ranks), results(code, ranks, only)
    found: list[Difference] = []
    for name in sorted({*after, *(name for name in before if fnmatch(name, only))}):
        if name not in before:
            found.append(Difference(name, "", "not in the baseline", "a result"))
        elif name not in after:
            found.append(Difference(name, "", "a result", "none"))
        else:
            found += differences(name, before[name], after[name], ranks)
    left = [one for one in found if not any(_matches(entry, one, ranks) for entry in allowed)]
    print(f"{ranks} ranks: {len(after)} results, {len(left)} differences, {len(found) - len(left)} allowed ones")
    return left


def _matches(entry: dict[str, str], one: Difference, ranks: int) -> bool:
    here = ranks in entry.get("ranks", [1, 2, 3])
    return here and fnmatch(one.name, entry["name"]) and fnmatch(one.field, entry.get("field", "*"))


def read(ranks: int) -> Results:
    """The baseline by name."""
    file = BASELINE / f"{ranks}.jsonl"
    lines = map(json.loads, file.read_text().splitlines()) if file.exists() else ()
    found = {line.pop("name"): line for line in lines}
    if ranks == 1:
        return found
    first = read(1)
    return {name: expanded(line, first.get(name)) for name, line in found.items()}


def write(lines: Results, ranks: int) -> None:
    """Write the baseline: on several ranks what differs from that of one rank."""
    if ranks > 1:
        first = read(1)
        lines = {name: shortened(line, first.get(name), ranks) for name, line in lines.items()}
    BASELINE.mkdir(exist_ok=True)
    text = "".join(
        json.dumps({"name": name, **line}, separators=(",", ":")) + "\n" for name, line in sorted(lines.items())
    )
    (BASELINE / f"{ranks}.jsonl").write_text(text)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python tests/golden", description=__doc__.split("\n\n")[0])
    parser.add_argument("what", choices=("record", "compare", "list"))
    parser.add_argument("--code", type=Path, default=HERE.parents[1], help="The checkout to run.  [this one]")
    parser.add_argument("--ranks", type=int, choices=(1, 2, 3), action="append", help="Once or more.  [1 2 3]")
    parser.add_argument("--only", default="*", metavar="PATTERN", help="Cases, such as 'bound/*'.")
    parser.add_argument("--repeats", type=int, default=3, help="Runs of a record.  [3]")
    given = parser.parse_args()
    code, every = given.code.resolve(), given.ranks or [1, 2, 3]
    if given.what == "list":
        print("\n".join(name for name in read(every[0]) if fnmatch(name, given.only)))
        return 0
    if given.what == "record":
        for ranks in every:
            record(code, ranks, given.only, given.repeats)
        return 0
    import tomllib

    allowed = tomllib.loads((HERE / "allowed.toml").read_text()).get("allowed", [])
    left = [one for ranks in every for one in _told(compare(code, ranks, given.only, allowed), ranks)]
    return 1 if left else 0


def _told(found: list[Difference], ranks: int) -> list[Difference]:
    for one in found:
        before, after = (json.dumps(value) for value in (one.before, one.after))
        first, then = (" ", " -> ") if len(before) + len(after) < 100 else ("\n     before ", "\n     after  ")
        print(f"  {ranks}: {one.name}: {one.field}:{first}{before}{then}{after}")
    return found


if __name__ == "__main__":
    sys.exit(main())
