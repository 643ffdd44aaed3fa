"""The command that results and messages name: the launcher in a clone, otherwise what the user started."""

import sys

import pytest

from fenicsx_obstacle import InputError, checkout, origin
from fenicsx_obstacle.cli import commands
from fenicsx_obstacle.parallel import on_root
from tests.conftest import COMM


def test_commands_in_a_clone(monkeypatch):
    """The launcher, with its option for ranks; a script keeps its name."""
    monkeypatch.setattr(sys, "argv", ["/bin/fenicsx-obstacle", "solve", "a b.toml"])
    assert origin.command(1) == "./obstacle solve 'a b.toml'" and origin.program() == "./obstacle"
    assert origin.command(3) == "./obstacle --ranks 3 solve 'a b.toml'"
    monkeypatch.setattr(sys, "argv", ["mine.py", "7"])
    assert origin.command(2) == "mpirun -n 2 python3 mine.py 7"


@pytest.mark.parametrize(("file", "program"), [
    ("/env/bin/fenicsx-obstacle", "fenicsx-obstacle"),
    ("/env/fenicsx_obstacle/__main__.py", "python3 -m fenicsx_obstacle"),
])  # fmt: skip
def test_commands_of_an_installed_package(folder, monkeypatch, file, program):
    """No launcher is named where none is."""
    monkeypatch.setattr(checkout, "ROOT", folder)
    monkeypatch.setattr(sys, "argv", [file, "solve", "ball"])
    assert origin.program() == program
    assert origin.command(1) == f"{program} solve ball"
    assert origin.command(2) == f"mpirun -n 2 {program} solve ball"


def test_what_needs_a_clone(folder, monkeypatch, capsys):
    """`theory` and `demo` say so before they begin; a folder demos/ beside the package is not that of the project."""
    monkeypatch.setattr(checkout, "ROOT", folder)
    on_root(COMM, (folder / "demos").mkdir)
    for command in ("theory", "demo"):
        with pytest.raises(InputError, match="runs in a clone"):
            commands.main([command, "--output", str(folder / "out")], standalone_mode=False)
    assert not capsys.readouterr().out
