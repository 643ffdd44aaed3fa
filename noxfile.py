"""Sessions for contributors: `nox -s quick` in two minutes; `./obstacle test`, `docs` and `coverage` call the others.

All sessions run in the environment that the script `obstacle` makes and keeps; a container has no lint.
"""

from __future__ import annotations

from pathlib import Path

import nox

nox.options.default_venv_backend = "none"
nox.options.sessions = ["quick"]
ROOT = Path(__file__).parent
LAUNCHER = str(ROOT / "obstacle")
BIN = ROOT / ".venv" / "bin"
ON_ALL_CORES = ("-n", "auto", "--maxprocesses", "8", "--dist", "worksteal")
NOT_SLOW = ("-m", "not slow", "--few")
SUITES = {
    "scenes": ("hard",), "broken": ("hard", "--broken"), "faults": ("hard", "--faults"),
    "random": ("hard", "--random", "1000"), "theory": ("theory",),
}  # fmt: skip


@nox.session
def lint(session: nox.Session) -> None:
    """Lint and format, dead code, types, and the order of imports."""
    check(session)


def check(session: nox.Session) -> None:
    """What `lint` does; nothing in a container."""
    if (ROOT / ".venv" / "image").exists():
        session.log("in a container: the tests alone, without lint and types")
        return
    session.run(LAUNCHER, "--version", silent=True, external=True)  # sets up what is missing
    for words in (("ruff", "check", "."), ("ruff", "format", "--check", "."), ("vulture",), ("mypy",),
                  ("lint-imports", "pyproject.toml")):  # fmt: skip
        session.run(str(BIN / words[0]), *words[1:], external=True)


@nox.session
def quick(session: nox.Session) -> None:
    """Lint, and the quick tests on one rank, of many cases the first."""
    check(session)
    session.run(LAUNCHER, "--ranks", "1", "pytest", *NOT_SLOW, *ON_ALL_CORES, *session.posargs, external=True)


@nox.session
def tests(session: nox.Session) -> None:
    """The quick tests, of many cases the first; or lint, then every test, with --all.

    They run on 1 rank, then two thirds of the files on 2 ranks, and the others on 3.

    Arguments: [--ranks N] [--all] [ARGUMENTS OF PYTEST...]. Tests that are named by file or id run on all ranks.
    """
    given = list(session.posargs)
    ranks = ["1", "2", "3"]
    alone = given[:1] == ["--ranks"]
    if alone:
        ranks, given = given[1:2], given[2:]
    chosen = NOT_SLOW
    if given[:1] == ["--all"]:
        chosen, given = (), given[1:]
        if not alone:
            check(session)
    files = [word.partition("::")[0] for word in given]
    if missing := [file for file in files if file.endswith(".py") and not Path(file).exists()]:
        session.error(f"no such file: {', '.join(missing)}")
    named = any(Path(file).exists() for file in files)
    for number in ranks:
        words = [*(() if named else chosen), *(ON_ALL_CORES if number == "1" else ())]
        if not (alone or named or number == "1"):
            words.append("--by-file")
        session.log(f"tests on {number} rank{'s' * (number != '1')}")
        session.run(LAUNCHER, "--ranks", number, "pytest", *words, *given, external=True)


@nox.session
@nox.parametrize("words", [nox.param(words, id=name) for name, words in SUITES.items()])
def hard(session: nox.Session, words: tuple[str, ...]) -> None:
    """The suites, each a session, such as "hard(random)": hard scenes, invalid input, faults, random scenes, theory."""
    session.run(LAUNCHER, *words, *session.posargs, external=True)


@nox.session
def coverage(session: nox.Session) -> None:
    """All tests on one rank, and the lines that none runs."""
    session.run(LAUNCHER, "pytest", "--cov", "--cov-report=term:skip-covered", *session.posargs, external=True)


@nox.session
def docs(session: nox.Session) -> None:
    """The pages as a site in out/docs; a warning is an error."""
    session.run(
        str(BIN / "python"), "-m", "pip", "install", "--quiet", "--disable-pip-version-check",
        "--constraint", str(ROOT / ".venv" / "constraints.txt"), "--editable", f"{ROOT}[docs]", external=True,
    )  # fmt: skip
    # what is generated of modules that are gone would stay
    session.run("rm", "-rf", "docs/generated", "docs/reference", "out/docs", external=True)
    words = ("-W", "--keep-going", "-q", "-b", "html", "docs", "out/docs")
    session.run(str(BIN / "python"), "-m", "sphinx", *words, external=True)
    session.log("the documentation is in out/docs/index.html")


@nox.session
def releases(session: nox.Session) -> None:
    """All tests on several releases of Debian."""
    session.run("tests/releases.sh", *session.posargs, external=True)
