"""Checks of [report] and [profile] that need no mesh."""

from __future__ import annotations

import ast
from collections.abc import Mapping

from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.scenes.definitions import FIELDS, JUMP, NORMAL_FLUX, RESERVED, Definitions
from fenicsx_obstacle.scenes.formulas import FUNCTIONALS, Formula, check_name, parse
from fenicsx_obstacle.text import nearest

# of elastic bodies: fields, and numbers that are known without a functional
BODY_FIELDS = ("u_x", "u_y", "u_z", "p", "contact", "von_mises")
BODY_QUANTITIES = ("force_x", "force_y", "force_z", "moment", "moment_x", "moment_y", "moment_z", "contact_area",
                   "half_width", "peak", "approach")  # fmt: skip
DRAWN, DRAWN_OF_BODIES = ("u", "p"), ("u_x", "u_y", "u_z", "gap", "p", "von_mises")  # what a plot of a line can show


def parse_report(scene: Definitions) -> dict[str, Formula]:
    """The formulas of [report], in order.

    Raises:
        InputError: Naming the entry and the column.
    """
    found, quantities = dict[str, Formula](), _quantities(scene)
    for name, value in scene.tables.report.items():
        place = f"{scene.source}: [report] {name}"
        check_name(name, place)
        formula = parse(value, place, functionals=True)
        itself = formula.text == name and name in quantities  # in the output under its own name
        if (name in RESERVED | quantities and not itself) or name in scene.define:
            raise InputError(f"{place}: '{name}' has a meaning already; choose another name")
        _Checker(scene, formula, set(found)).check(formula.tree, inside=False)
        found[name] = formula
    return found


def _quantities(scene: Definitions) -> set[str]:
    """Names of numbers that are known without a functional."""
    if not scene.of_body:
        return set()
    for name in (*BODY_FIELDS, *BODY_QUANTITIES):
        if name in scene.define:
            raise InputError(f"{scene.source}: [define] {name}: has a meaning of elastic bodies; choose another name")
    return set(BODY_QUANTITIES)


class _Checker:
    """Names and arities of one entry; `earlier` are the entries before it."""

    def __init__(self, scene: Definitions, formula: Formula, earlier: set[str]):
        self.formula = formula
        fields, numbers = BODY_FIELDS if scene.of_body else FIELDS, earlier | _quantities(scene)
        self.varying = {*scene.known_names, *fields, *numbers}
        self.constant = {name for name in scene.known_names if scene.is_constant(name)} | numbers

    def check(self, node: ast.expr, *, inside: bool, on_part: bool = False) -> None:
        """Check a subtree; `inside` a functional, where fields have values; `on_part` of the mesh, by its name."""
        match node:
            case ast.Name(id=name):
                self._name(node, name, inside, on_part)
            case ast.Call(func=ast.Name(id=name), args=[first, *rest]) if name in FUNCTIONALS:
                self.check(first, inside=True, on_part=name == "integral" and len(rest) > 0)
                for coordinate in rest if name == "at" else ():
                    self.check(coordinate, inside=False)
            case ast.Call(args=args):
                for child in args:
                    self.check(child, inside=inside, on_part=on_part)
            case _:
                for operand in ast.iter_child_nodes(node):
                    if isinstance(operand, ast.expr):
                        self.check(operand, inside=inside, on_part=on_part)

    def _name(self, node: ast.expr, name: str, inside: bool, on_part: bool) -> None:
        if name in (NORMAL_FLUX, JUMP) and not on_part:
            where = "a part of the boundary" if name == NORMAL_FLUX else "a curve inside"
            message = f'{name} is defined on {where} only: integral({name}, "name")'
            raise InputError(self.formula.pointing(node, message))
        if name in (self.varying if inside else self.constant):
            return
        if name in self.varying:
            message = f"'{name}' is a field: use integral, at, max or min of it"
        else:
            message = f"unknown name '{name}'" + nearest(name, self.varying)
        raise InputError(self.formula.pointing(node, message))


def of_profile(scene: Definitions, name: str) -> dict[str, Formula]:
    """The formulas of comparison of a profile; errors as of `compared`."""
    return compared(scene, scene.tables.profile[name].compare, f"[profile.{name}] compare")


def compared(scene: Definitions, given: Mapping[str, float | str], place: str) -> dict[str, Formula]:
    """Formulas of comparison, by the quantity over which they are drawn.

    Args:
        scene: Whose definitions they may use.
        given: Their texts.
        place: Where they stand, for messages.

    Raises:
        InputError: If a quantity or a name in a formula is not known.
    """
    known, found = DRAWN_OF_BODIES if scene.of_body else DRAWN, dict[str, Formula]()
    for key, value in given.items():
        if key not in known:
            raise InputError(f"{scene.source}: {place} {key}: no quantity of this name{nearest(key, known)}")
        found[key] = scene.formula(value, f"{place} {key}")
        found[key].check_names(scene.known_names - {"distance"})
    return found
