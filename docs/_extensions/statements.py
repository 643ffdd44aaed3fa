"""The page of statements: number, subject and code of each, from the decorators `@statement` in tests/theory."""

import ast
from collections.abc import Iterator
from pathlib import Path

from sphinx.application import Sphinx

ROOT = Path(__file__).parent.parent.parent
FOLDER = ROOT / "tests" / "theory"
HEAD = """# Statements and their code

This table is made from the code. `./obstacle theory NUMBER` checks a statement, and also takes the other numbers;
`./obstacle theory` checks all. {doc}`../theory` has the results.

| number | statement | other numbers | code |
| --- | --- | --- | --- |
"""


def modules() -> list[str]:
    """Names of the modules with statements, in the order of the paper."""
    tree = ast.parse((FOLDER / "statement.py").read_text())
    (names,) = (node.value for node in tree.body if isinstance(node, ast.AnnAssign) and node.target.id == "_MODULES")
    return list(ast.literal_eval(names))


def statements() -> Iterator[tuple[str, str, list[str], str]]:
    """Number, title, other numbers and place in the code of each statement."""
    for module in modules():
        for node in ast.parse((FOLDER / f"{module}.py").read_text()).body:
            for mark in getattr(node, "decorator_list", []):
                if isinstance(mark, ast.Call) and getattr(mark.func, "id", "") == "statement":
                    number, title, *others = map(ast.literal_eval, mark.args)
                    yield number, title, others, f"`tests/theory/{module}.py`, `{node.name}`"


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the page before pages are read."""
    folder = Path(app.srcdir) / "generated"
    folder.mkdir(exist_ok=True)
    rows = (
        f"| `{number}` | {title} | {', '.join(f'`{other}`' for other in others)} | {place} |\n"
        for number, title, others, place in statements()
    )
    escaped = (row.replace("||", r"\|\|") for row in rows)
    (folder / "statements.md").write_text(HEAD + "".join(escaped))
    return {"parallel_read_safe": True}
