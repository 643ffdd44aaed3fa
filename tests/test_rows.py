"""Rows that survive kills and full disks: no row is lost or doubled, the end is the same table, old files are kept."""

import json
import os
import resource
from contextlib import closing
from pathlib import Path

import pytest

from fenicsx_obstacle import InputError, Scene
from fenicsx_obstacle.__main__ import _run
from fenicsx_obstacle.cli import commands
from fenicsx_obstacle.safe_writing import write_text
from fenicsx_obstacle.studies import rows as rows_module
from fenicsx_obstacle.studies.convergence import Study
from fenicsx_obstacle.studies.rows import RowStore, row_key
from tests.cli.faults.kill import kills
from tests.conftest import CLEAN, DEMOS
from tests.helpers import inside, run

pytestmark = pytest.mark.serial

STUDY = ["study", str(DEMOS / "string.toml"), "--vary", "cells=4,6,8,10,12,14,16", "--method", "vi"]


@pytest.mark.parametrize("ranks", [1, 3])
@pytest.mark.slow
def test_killed_at_random_moments(ranks, tmp_path):
    """No lost or doubled row, same final table."""
    faults = [fault.wrong for fault in kills(tmp_path, CLEAN, {ranks: 3 if ranks == 1 else 1}, ["all"])]
    assert len(faults) > 2 and not any(faults), faults


@pytest.mark.slow
def test_finished_study_computes_nothing_again_unless_fresh(tmp_path):
    first = inside(*STUDY, "--output", tmp_path / "out")
    again = inside(*STUDY, "--output", tmp_path / "out")
    assert first.returncode == again.returncode == 0
    assert "* timed in an earlier run" in again.stdout
    assert "* timed" not in first.stdout
    assert len((tmp_path / "out" / "rows.jsonl").read_text().splitlines()) == 7
    fresh = inside(*STUDY, "--output", tmp_path / "out", "--fresh")
    assert "* timed" not in fresh.stdout


def test_a_row_that_other_keys_led_to(tmp_path):
    """It is taken, with the values of the keys that vary now."""
    for key in ("cells", "mesh.cells"):
        with closing(RowStore(tmp_path)) as store:
            row = Study(Scene.read(DEMOS / "string.toml"), {key: [4]}, {}).run(store=store)[0]
        assert row["vary"] == {key: 4} and row["run"] == 1


def test_torn_line_is_cut(tmp_path):
    """A process killed while writing leaves half a line: it is no row, and the next row starts on its own line."""
    store = RowStore(tmp_path)
    store.add("a", {"value": 1})
    store.close()
    with (tmp_path / "rows.jsonl").open("a") as file:
        file.write('{"key": "b", "val')
    again = RowStore(tmp_path)
    assert again.run == 2
    assert again.find("a") == {"key": "a", "run": 1, "value": 1}
    assert again.find("b") is None
    again.add("b", {"value": 2})
    assert [json.loads(line)["value"] for line in (tmp_path / "rows.jsonl").read_text().splitlines()] == [1, 2]
    with pytest.raises(InputError, match="another study is writing there"):
        RowStore(tmp_path)
    again.close()
    (tmp_path / "rows.jsonl").write_text("[1]\n")
    with pytest.raises(InputError, match="not written by a study"):
        RowStore(tmp_path)


def test_key_depends_on_everything_that_matters():
    """Scene, ranks and kind of study; files of a scene come below."""
    disk = Scene.read(DEMOS / "disk.toml")
    same, other = row_key(disk, "h", 1), row_key(disk.change({"define.c": 0.25}), "h", 1)
    assert same == row_key(Scene.read(DEMOS / "disk.toml"), "h", 1)
    assert len({same, other, row_key(disk, "h", 2), row_key(disk, "eps", 1)}) == 4


@pytest.mark.parametrize("chained", [True, False])
def test_interrupt_while_a_module_loads(chained, monkeypatch, capsys):
    """A compiled module makes an ImportError of it: still one line and status 130; other ImportErrors stay."""

    def load(*args, **options):
        raise ImportError("initialization failed") from (KeyboardInterrupt() if chained else None)

    monkeypatch.setattr(commands, "main", load)
    if chained:
        assert _run(["--help"], []) == 130
        assert capsys.readouterr().err == "interrupted\n"
    else:
        with pytest.raises(ImportError):
            _run(["--help"], [])


@pytest.mark.slow
def test_set_vary_grid_and_latex(tmp_path):
    """--set and --vary take any key of the scene; several --vary make a grid; --latex writes the table."""
    done = inside("study", DEMOS / "string.toml", "--set", "define.c=0.2", "--set", "mesh.x=[0, 1.5]", "--cells", 8,
               "--vary", "define.f=4,8", "--vary", "method=penalty,vi", "--output", tmp_path / "out",
               "--latex", tmp_path / "table.tex", "--json", tmp_path / "rows.json")  # fmt: skip
    assert done.returncode == 0, done.stderr
    rows = [json.loads(line) for line in (tmp_path / "rows.json").read_text().splitlines()]
    assert [row["vary"] for row in rows] == [{"define.f": f, "method": m} for f in (4, 8) for m in ("penalty", "vi")]
    latex = (tmp_path / "table.tex").read_text()
    assert latex.count(r"\\") == 5
    assert r"\toprule" in latex


SIZED = """
[mesh]
file = "{}"
[effects]
tension = 1
load = -1
[obstacle]
lower = -0.05
[[boundary]]
value = 0
"""
MINE = """
from fenicsx_obstacle.effects.effect import Effect, register
@register
class Mine(Effect):
    \"\"\"k u on the left side; unit of k: force per length^3.\"\"\"
    key = "mine"; equation = "mine u"; term = "+ int mine u v"; unit = "force/length^3"
    def terms(self, u, v, data): return {0} * data.cellwise(self.value, least=0.0) * u * v * data.dx
    def energy(self, u, data): return {0} * data.cellwise(self.value, least=0.0) * u**2 / 2 * data.dx
"""


def _geo(folder, size):
    (folder / "a.geo").write_text('SetFactory("OpenCASCADE");\nInclude "size.txt";\nRectangle(1) = {0, 0, 0, 1, 1};\n')
    (folder / "size.txt").write_text(f"Mesh.MeshSizeMax = {size};\n")
    (folder / "a.toml").write_text(SIZED.format("a.geo"))


def _xdmf(folder, width):
    from dolfinx import io, mesh
    from mpi4py import MPI

    found = mesh.create_unit_square(MPI.COMM_SELF, 6, 6)
    found.geometry.x[:, 0] *= width
    with io.XDMFFile(MPI.COMM_SELF, str(folder / "a.xdmf"), "w") as file:
        file.write_mesh(found)
    (folder / "a.toml").write_text(SIZED.format("a.xdmf"))


def _plugin(folder, factor):
    (folder / "mine.py").write_text(MINE.format(factor))
    (folder / "a.toml").write_text(
        SIZED.format("").replace('file = ""', 'shape = "interval"\ncells = 8').replace("load", "mine = 20\nload")
    )


@pytest.mark.slow
@pytest.mark.parametrize("change", [_geo, _xdmf, _plugin])
def test_rows_are_of_the_contents_of_files(change, tmp_path):
    """Included files, the .h5 of an .xdmf and the code of a plug-in: once these change a row is computed again."""
    study = ["study", "a.toml", "--vary", "effects.load=-1,-2", "--output", "out", "--json", "out.json", "--quiet"]
    if change is _plugin:
        study += ["--plugin", "mine.py"]
    energies = []
    for value in (0.3, 0.1, 0.3):
        change(tmp_path, value)
        # what Python and the compiler of forms remember of a plug-in is not that of a new process
        done = (run if change is _plugin else inside)(*study, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        energies.append([json.loads(line)["energy"] for line in (tmp_path / "out.json").read_text().splitlines()])
    assert energies[0] == energies[2]  # found again, to the last digit
    assert all(abs(a / b - 1) > 1e-3 for a, b in zip(*energies[:2], strict=True))
    if change is not _xdmf:  # HDF5 files have a date inside
        assert len((tmp_path / "out" / "rows.jsonl").read_text().splitlines()) == 4


ROWS = {
    "a row without its content": {"energy": 3.0},
    "a wrong energy": {"energy": "much"},
    "no contact": {"contact": None},
    "a run that is a text": {"run": "first"},
}


SHORT = ["study", str(DEMOS / "disk.toml"), "--vary", "cells=4,6", "--quiet", "--output"]


@pytest.fixture(scope="module")
def rows_of_a_study(tmp_path_factory):
    """The lines of rows.jsonl that the study SHORT has written."""
    folder = tmp_path_factory.mktemp("study")
    assert inside(*SHORT, folder).returncode == 0
    return (folder / "rows.jsonl").read_text().splitlines()


@pytest.mark.slow
@pytest.mark.parametrize("forged", [False, True], ids=["damaged", "forged"])
@pytest.mark.parametrize("what", ROWS)
def test_wrong_fields_of_rows(what, forged, rows_of_a_study, tmp_path):
    """One message; a row that was changed is never taken."""
    lines = []
    for line in rows_of_a_study:
        row = {**json.loads(line), **ROWS[what]}
        content = row.pop("content")
        lines.append(json.dumps({**row, "content": rows_module._content(row) if forged else content}))
    (tmp_path / "rows.jsonl").write_text("\n".join(lines) + "\n")
    done = inside(*SHORT, tmp_path)
    if forged and what == "a row without its content":  # another number is a number
        return
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1 and "rows.jsonl" in done.stderr, done.stderr


def test_rows_of_version_02_are_kept_but_not_taken(tmp_path):
    (tmp_path / "rows.jsonl").write_text('{"key": "a", "run": 1, "value": 1}\n')
    store = RowStore(tmp_path)
    assert store.find("a") is None
    store.add("a", {"value": 2})
    store.close()
    store = RowStore(tmp_path)
    assert store.find("a") == {"key": "a", "run": 1, "value": 2}
    store.close()


@pytest.mark.parametrize("name", ["rows.jsonl", ".lock"])
def test_rows_are_written_into_no_other_file(name, tmp_path):
    """A link in a folder of someone else leads nowhere; nor does a pipe wait."""
    (tmp_path / "mine").write_text("mine\n")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / name).symlink_to(tmp_path / "mine")
    with pytest.raises(InputError, match="choose another folder"):
        RowStore(tmp_path / "out")
    assert (tmp_path / "mine").read_text() == "mine\n"
    (tmp_path / "out" / name).unlink()
    os.mkfifo(tmp_path / "out" / name)
    with pytest.raises(InputError, match="is no file"):
        RowStore(tmp_path / "out")


def test_devices_are_written_as_they_are(tmp_path):
    """--json /dev/null must not put a file in its place; a full one is named."""
    link = tmp_path / "null"
    os.mkfifo(link)
    reader = os.open(link, os.O_RDONLY | os.O_NONBLOCK)
    write_text(link, "figures")
    assert os.read(reader, 100) == b"figures"
    os.close(reader)
    assert link.is_fifo()
    with pytest.raises(InputError, match="/dev/full: cannot be written: No space left on device"):
        write_text(Path("/dev/full"), "figures")
    assert not Path("/dev/full").is_file()


def test_a_file_that_cannot_be_written_leaves_the_earlier_one(tmp_path):
    """Neither half a file nor a scratch file beside it."""
    (tmp_path / "a").write_text("before")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10, limits[1]))
    try:
        with pytest.raises(InputError, match="File too large"):
            write_text(tmp_path / "a", "after" * 1000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert (tmp_path / "a").read_text() == "before"
    assert os.listdir(tmp_path) == ["a"]
