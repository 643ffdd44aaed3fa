"""Files that are not scenes, and invalid scenes: very large input, contradictions, missing and truncated meshes."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path

from tests.cli.broken.case import SCENE, Broken, Content
from tests.cli.broken.lines import LINES, scene_text

PLAIN = scene_text({**LINES}).encode()
NAMES = 20000


def broken_files() -> Iterator[Broken]:
    """Scene files that cannot be read, or hold too much."""
    yield Broken("no scene file", [SCENE, "no such"])
    doubling = "".join(f'a{k} = "a{k - 1} + a{k - 1}"\n' for k in range(1, 60))
    many = "".join(f"n{k} = {k}\n" for k in range(NAMES))
    cases: list[tuple[str, Content, list[str]]] = [
        ("a folder", os.mkdir, []),
        ("a pipe that nobody writes to", os.mkfifo, []),
        ("a link to itself", lambda path: path.symlink_to(path.name), []),
        ("a device without end", lambda path: path.symlink_to("/dev/zero"), []),
        ("empty", b"", ["[mesh]"]),
        ("a comment", b"# nothing\n", ["[mesh]"]),
        ("Latin-1", 'title = "K\u00f6rper"\n'.encode("latin-1") + PLAIN, ["UTF-8"]),
        ("UTF-16", PLAIN.decode().encode("utf-16"), ["UTF-8"]),
        ("random bytes", bytes(range(256)) * 8, []),
        ("NUL bytes", b"\0" * 4096, []),
        ("a picture", b"\x89PNG\r\n\x1a\n" + bytes(200), []),
        ("JSON", b'{"mesh": {"shape": "rectangle"}}\n', ["TOML"]),
        ("a misspelt table", b"[mash]\n", ["unknown table or key 'mash'; did you mean 'mesh'"]),
        ("a key twice", PLAIN.replace(b"cells = 4", b"cells = 4\ncells = 5"), ["TOML", "line"]),
        ("a table twice", PLAIN + b"[mesh]\ncells = 8\n", ["TOML", "mesh"]),
        ("a table and a list of tables", PLAIN + b"[boundary]\nvalue = 1\n", ["TOML", "boundary"]),
        ("cut off in a text", PLAIN[: PLAIN.index(b'rectangle"') + 4], ["TOML"]),
        ("cut off in a table's name", PLAIN[: PLAIN.index(b"[mesh]") + 4], ["TOML"]),
        ("an assignment without value", PLAIN.replace(b"cells = 4", b"cells ="), ["TOML"]),
        ("a colon", PLAIN.replace(b"cells = 4", b"cells: 4"), ["TOML"]),
        ("1e5 brackets", b"a = " + b"[" * 100000 + b"]" * 100000, []),
        ("1e5 nested tables", b"a = " + b"{a = " * 100000 + b"1" + b"}" * 100000, []),
        ("1e4 dots in a key", b"a" + b".a" * 10000 + b" = 1\n", []),
        ("1e5 dots in a key", b"a" + b".a" * 10**5 + b" = 1\n", ["nested too deeply"]),
        ("1e5 dots in a key in braces", b"x = {a" + b".a" * 10**5 + b" = 1}\n", ["nested too deeply"]),
        ("1e5 dots in a table's name", b"[a" + b".'b'" * 10**5 + b"]\n", ["nested too deeply"]),
        ("1e5 dots in the name of a list of tables", b'[["a"' + b' . "b"' * 10**5 + b"]]\n", ["nested too deeply"]),
        ("1e5 characters in a key", b"[mesh]\n" + b"a" * 100000 + b" = 1\n", ["[mesh]"]),
        ("1e5 tables of a boundary", PLAIN + b"[[boundary]]\nvalue = nan\n" * 20000, ["boundary"]),
        ("64 MB", b"#" * (64 << 20), []),
        ("names that double", _bomb(doubling, "a59", "[exact] u"), ["[exact]"]),
        (
            "names that double, in an obstacle",
            _bomb(doubling, "a59 + q7", "[obstacle] lower"),
            ["lower", "q7"],
        ),
        ("2e4 names", _bomb(many, "q7", "[obstacle] lower"), ["q7"]),
        ("names in a circle", _bomb('a = "b"\nb = "a"\n', "a", "[obstacle] lower"), ["[define] a", "'b'"]),
        ("a name of itself", _bomb('a = "a + 1"\n', "a", "[obstacle] lower"), ["[define] a"]),
        (
            "a name that is taken",
            _bomb("sin = 1\n", "1", "[obstacle] lower"),
            ["[define] sin", "'sin' has a meaning already"],
        ),
        ("a word of Python as a name", _bomb("lambda = 1\n", "1", "[obstacle] lower"), ["[define] lambda"]),
        ("a name of Python's own", _bomb("__builtins__ = 1\n", "__builtins__.x", "[obstacle] lower"), ["[obstacle]"]),
    ]
    for what, content, names in cases:
        yield Broken(f"scene file: {what}", [SCENE, *names], files={SCENE: content})


def contradictions() -> Iterator[Broken]:
    """Scenes whose lines are right one by one, but not together."""
    cases: list[tuple[str, dict[str, str | None], list[str]]] = [
        ("no mesh", {"[mesh] shape": None, "[mesh] x": None, "[mesh] cells": None}, ["either a 'shape' or a 'file'"]),
        ("shape and file", {"[mesh] file": '"a.msh"'}, ["[mesh]", "file"]),
        ("a misspelt key", {"[mesh] cells": None, "[mesh] cels": "4"},
         ["[mesh] unknown key 'cels'; did you mean 'cells'"]),
        ("a misspelt effect", {"[effects] lod": "1"}, ["[effects] unknown effect 'lod'; did you mean 'load'"]),
        ("a misspelt word", {"[mesh] shape": '"rectangel"'}, ["'rectangel' is not known; did you mean 'rectangle'"]),
        ("a key of another shape", {"[mesh] radius": "4"},
         ["[mesh] radius = 4: does not belong to shape = 'rectangle'; its keys are: "]),
        ("no cells", {"[mesh] cells": '"many"'}, ["[mesh] cells = 'many': expected a whole number"]),
        ("an interval turned", {"[mesh] x": "[1, 0]"}, ["first end must be less than the second"]),
        ("one bracket", {"[[boundary]] on": None, "[[boundary]] value": None, "[boundary] value": "0"},
         ["[boundary]: write [[boundary]], in double brackets"]),
        ("a place in a formula", {"[effects] load": '"2*y + q"'},
         ["load: unknown name 'q'", "\n    2*y + q\n          ^"]),
        ("a place in no formula", {"[effects] load": '"2*^y"'}, ["cannot read this formula\n    2*^y\n       ^"]),
        ("a comment in a formula", {"[effects] load": '"2 # + y"'}, ["cannot read this formula\n    2 # + y\n      ^"]),
        ("an attribute", {"[effects] load": '"x.real"'}, ["not allowed in a formula"]),
        ("a subscript", {"[effects] load": '"x[0]"'}, ["not allowed in a formula; the coordinates are x, y and z"]),
        ("a prefix", {"[effects] load": '"np.sin(x)"'},
         ["not allowed in a formula; functions have no prefix: sin(...)"]),
        ("an import", {"[effects] load": "\"__import__('os')\""}, ["unknown function '__import__'"]),
        ("an integral", {"[effects] load": '"integral(x)"'}, ["unknown function 'integral'; it belongs in"]),
        ("a nested formula", {"[effects] load": f'"{"-" * 1500}1"'}, ["nested"]),
        ("a long formula", {"[effects] load": f'"{"-" * 100000}1"'}, ["the limit is 2000"]),
        ("no tension", {"[effects] tension": None}, ["[effects]", "add 'tension = 1'"]),
        ("tension negative in places", {"[effects] tension": '"x - 0.5"'},
         ["tension", "must be positive; it is -", "(0"]),
        ("a singular matrix as tension", {"[effects] tension": "[[1, 3], [3, 9]]"},
         ["tension: must be positive definite; its least eigenvalue is"]),
        ("no number beside the distance", {"[effects] load": '"sqrt(x - 2) + distance"'},
         ["load = sqrt(x - 2) + distance: is not a finite number: it is nan at"]),
        ("tension zero", {"[effects] tension": "0"}, ["tension", "positive"]),
        ("tension of materials without materials", {"[effects] tension": "{steel = 1}"}, ["tension", "steel"]),
        ("obstacles cross", {"[obstacle] lower": '"x"'}, ["[obstacle] lower is above upper: by 0.5 at (1, "]),
        ("a boundary value below", {"[obstacle] lower": "0.1"},
         ["[[boundary]] (no. 1) value = 0 lies below the lower obstacle: 0 against 0.1 at (0, 0), so that no u"]),
        ("a boundary value above", {"[obstacle] upper": "-0.001"}, ["[[boundary]]", "upper", "0.001"]),
        ("a side that is not there", {"[[boundary]] on": '"lft"'}, ["on", "no part named 'lft'; did you mean 'left'"]),
        ("no side", {"[[boundary]] on": "[]"}, ["[[boundary]]", "on"]),
        ("on and where", {"[[boundary]] where": '"x == 0"'}, ["on", "where"]),
        ("where nowhere", {"[[boundary]] on": None, "[[boundary]] where": '"x > 7"'}, ["where", "x > 7"]),
        ("where by distance", {"[[boundary]] on": None, "[[boundary]] where": '"distance < 1"'},
         ["where", "'distance' is 0 on the whole boundary"]),
        ("where without value", {"[[boundary]] on": None, "[[boundary]] where": '"sqrt(x - 10)"'},
         ["where = sqrt", "not a finite number"]),
        ("where undecided", {"[[boundary]] on": None, "[[boundary]] where": '"sqrt(x - 0.5) > 0.2"'},
         ["(no. 1) where = sqrt", "nan at (", "), where a side of a comparison has no value: first say"]),
        ("a load that is undecided",
         {"[define] on": '"not sqrt(x - 0.5) < 0.2"', "[effects] load": '"where(on, 1, 0)"'},
         ["load = where", "nan at (", "because of [define] on = ", ", where a side of a comparison has no value"]),
        ("no value", {"[[boundary]] value": None}, ["[[boundary]]", "the key 'value' is missing"]),
        ("nothing holds it", {key: None for key in LINES if "bound" in key or "obst" in key}, ["[[boundary]]"]),
        ("log of a coordinate", {"[obstacle] lower": '"ln(x - 0.5)"'},
         ["[obstacle] lower", "not a finite number", "(0"]),
        ("overflow at a point", {"[effects] load": '"exp(1000*x)"'}, ["[effects] load", "inf"]),
        ("triangles in a box", {"[mesh] shape": '"box"', "[mesh] cell": '"triangle"'}, ["[mesh] cell"]),
        ("hexahedra in a plane", {"[mesh] cell": '"hexahedron"'}, ["this shape has triangle or quadrilateral cells"]),
        ("an element that is not there", {"[solve] element": '"P3"'}, ["element = 'P3' is not known"]),
        ("an element for other cells", {"[mesh] cell": '"triangle"', "[solve] element": '"Q1"'},
         ["[solve]", "element Q1 is for quadrilateral, hexahedron cells, not for a triangle"]),
        ("refined quadrilaterals", {"[mesh] cell": '"quadrilateral"', "[mesh] refine": "1"}, ["[mesh] refine"]),
        ("too many refinements", {"[mesh] refine": "20"}, ["[mesh]", "memory", "refine"]),
        ("1e8 cells", {"[mesh] cells": "100000000"}, ["[mesh]", "memory", "cells"]),
        ("a thin strip", {"[mesh] x": "[0, 1e-9]", "[mesh] cells": "100"}, ["[mesh]", "memory"]),
        ("eps that turns negative", {"[solve] eps": '"0.5 - 10*h"'}, ["[solve] eps", "positive"]),
        ("eps below 0", {"[solve] eps": "-1"}, ["[solve] eps = -1: must be positive"]),
        ("eps by place", {"[solve] eps": '"x"'}, ["[solve] eps", "'x'"]),
        ("floor in the solution", {"[exact] u": '"floor(x)"'}, ["[exact] u", "floor"]),
        ("distance in the solution", {"[define] d": '"distance"', "[exact] u": '"d"'}, ["'distance' has no gradient"]),
        ("pressure without solution", {"[exact] pressure": "0"}, ["[exact] the key 'u' is missing"]),
        ("pressure of an unknown name", {"[exact] u": "0", "[exact] pressure": '"q7"'},
         ["[exact] pressure: unknown name 'q7'"]),
        ("a misspelt pressure", {"[exact] u": "0", "[exact] presure": "0"},
         ["[exact] unknown key 'presure'; did you mean 'pressure'"]),
        ("pressure by distance", {"[exact] u": "0", "[exact] pressure": '"distance"'}, ["not allowed in [exact"]),
        ("a rate of no norm", {"[exact] u": "0", "[exact] rates": "{l3 = 1}"}, ["unknown key 'l3'"]),
        ("a field outside of a functional", {"[report] q": '"2*u"'},
         ["[report] q", "'u' is a field: use integral, at, max or min of it\n    2*u\n      ^"]),
        ("a definition outside", {"[define] f": '"x"', "[report] q": '"1 + f"'}, ["[report] q", "'f' is a field"]),
        ("a point that varies", {"[report] q": '"at(u, x, 0)"'}, ["[report] q", "'x' is a field"]),
        ("an unknown field", {"[report] q": '"integral(v)"'},
         ["[report] q: unknown name 'v'", "\n    integral(v)\n             ^"]),
        ("a figure of a later one", {"[report] q": '"q2"', "[report] q2": "1"}, ["[report] q", "unknown name 'q2'"]),
        ("a figure named like a field", {"[report] p": "1"}, ["[report] p", "'p' has a meaning already"]),
        ("a figure with a strange name", {"[report] 'a-b'": "1"}, ["[report] a-b: not a name"]),
        ("a micro sign, a Greek mu in formulas", {"[report] '\u00b5'": "1"}, ["[report] \u00b5: not a name"]),
        ("a part that is not there", {"[report] q": "\"integral(u, 'lft')\""},
         ["[report] q", "no part of the mesh named 'lft'; did you mean 'left'"]),
        ("a part without name", {"[report] q": '"integral(u, left)"'},
         ["[report] q", "expected the name of a part of the mesh, in quotes"]),
        ("a text in place of a field", {"[report] q": "\"integral('left')\""},
         ["[report] q", "not allowed in a formula"]),
        ("at a place outside", {"[report] q": '"at(u, 7, 7)"'}, ["[report] q", "the point (7, 7) is outside the mesh"]),
        ("at a place outside that is computed", {"[report] q": '"at(u, 2*integral(1), 0.5)"'},
         ["the point (2, 0.5) is outside the mesh"]),
        ("at with one coordinate", {"[report] q": '"1 + at(u, 1)"'},
         ["[report] q", "at() needs 2 coordinates here, not 1\n    1 + at(u, 1)\n        ^"]),
        ("at a place that is no number", {"[report] q": '"at(u, 0/0, 0)"'}, ["[report] q"]),
        ("sup of two arguments", {"[report] q": '"sup(u, 1)"'}, ["[report] q", "sup takes 1 argument, not 2"]),
        ("max of no argument", {"[report] q": '"max()"'}, ["[report] q", "max takes 2 to 9 arguments, not 0"]),
        ("normal flux in the domain", {"[report] q": '"integral(normal_flux)"'},
         ["[report] q", "normal_flux is defined on a part of the boundary only: integral(n"]),
        ("normal flux at a point", {"[report] q": '"at(normal_flux, 0, 0)"'},
         ["[report] q", "normal_flux is defined on a part of the boundary"]),
        ("normal flux alone", {"[report] q": '"1 + normal_flux"'},
         ["[report] q", "normal_flux is defined on a part of the boundary"]),
        ("an exact solution with a pole", {"[exact] u": '"1/x"'}, ["[exact] u"]),
        ("an exact solution that is NaN", {"[exact] u": '"sqrt(x - 2)"'}, ["[exact] u"]),
    ]  # fmt: skip
    for what, changed, names in [*cases, *_profiles()]:
        text = scene_text({**LINES, **changed})
        yield Broken(f"scene: {what}", [SCENE, *names], files={SCENE: text.encode()})
    several = PLAIN.replace(b"upper = 0.5", b"upper = '3/2 - y'") + b"[[boundary]]\non = 'top'\nvalue = 'x'\n"
    yield Broken(
        "scene: a boundary value above, of the last of several parts",
        [
            SCENE,
            "(no. 2) value = x lies above the upper obstacle: 1 against 0.5 at (1, 1), so that no u satisfies both",
        ],
        files={SCENE: several},
    )


def broken_heights() -> Iterator[Broken]:
    """Tables of heights that are none."""
    square = b"0,0,1\n1,0,2\n0,1,3\n1,1,4\n"
    cases: list[tuple[bytes | None, str, str]] = [
        (None, "", "no such file"),
        (b"", "", "is empty"),
        (b"x,y,z\n", "", "holds no numbers"),
        (b"0,0,1\n1,0,2\n0,1\n", "", "line 3 has 2 columns, the lines before it 3"),
        (b"x,y,z\n0,0,1\n1,0,two\n0,1,1\n", "", "line 3: 'two' is no number"),
        (b"0,0,1\n1,0,nan\n0,1,\n1,1,1\n", "",
         "2 of 4 values are not finite numbers: at (1, 0); (0, 1); replace"),
        (b"0,0,1\n1,1,2\n2,2,3\n", "", "3 points that span no area"),
        (b"0,0,1\n1,0,2\n0,1,3\n0,0,4\n", "", "two heights or more at (0, 0)"),
        (b"1,2,3,4\n1,2,3,4\n", "", "heights alone, 2 x 4: give extents, x = "),
        (b"1,2,3,4\n1,2,3,4\n", "x = [1, 0], y = [0, 1]", "x must ascend"),
        (square, "x = [0, 1]", "x has no meaning for data that have coordinates"),
        (square, "scale = 0", "scale = 0"),
        (square, "shift = [1, 2]", "shift = [1.0, 2.0]: expected [x, y, z]"),
        (square, "shft = [1, 2, 3]", "unknown key 'shft'; did you mean 'shift'"),
        (b"0,0,1\n1,0,2\n0,1,3\n", "smooth = 0.1", "smooth is for heights on a grid"),
        (square.replace(b"\n1,", b"\n0.9,"), "", "; the data reach over x = 0 .. 0.9, y = 0 .. 1"),
    ]  # fmt: skip
    for content, keys, message in cases:
        datum = f'{{file = "bad.csv"{", " * bool(keys)}{keys}}}'
        text = scene_text({**LINES, "[obstacle] upper": None, "[obstacle] lower": datum})
        yield Broken(f"heights: {message}", [SCENE, "[obstacle] lower", message],
                     files={SCENE: text.encode(), **({} if content is None else {"bad.csv": content})})  # fmt: skip


def _profiles() -> Iterator[tuple[str, dict[str, str | None], list[str]]]:
    """Lines that are none: what is wrong, the keys of [profile.line], and the message."""
    cases: list[tuple[str, dict[str, str], str]] = [
        ("outside", {"from": "[0, 0]", "to": "[1, 2]"}, ") is outside the mesh"),
        ("in space", {"from": "[0, 0, 0]", "to": "[1, 1, 0]"}, "from: needs 2 coordinates, not 3"),
        ("without end", {"from": "[0, 0]"}, "needs the keys 'from' and 'to', or 'on'"),
        ("of one point", {"from": "[0, 0]", "to": "[0, 0]"}, "from and to are the same point"),
        ("of n = 1", {"from": "[0, 0]", "to": "[1, 0]", "n": "1"}
         , "[profile.line] n = 1: expected a whole number >= 2"),
        ("on no curve", {"on": '"tob"'}, "no curve named 'tob'; did you mean 'top'"),
        ("with an unknown key", {"from": "[0, 0]", "to": "[1, 1]", "m": "3"}, "unknown key 'm'"),
        ("beside no quantity", {"on": '"top"', "compare": '{gap = "x"}'},
         "compare gap: no quantity of this name (known: p, u)"),
        ("beside no formula", {"on": '"top"', "compare": '{p = "q*x"}'}, "unknown name 'q'"),
        ("beside a list", {"on": '"top"', "compare": "{p = [1]}"}, "a number or a formula"),
        ("beside a pole", {"from": "[0, 0]", "to": "[1, 1]", "compare": '{u = "1/x"}'}, "[profile."),
    ]  # fmt: skip
    moving: dict[str, str | None] = {"[time] end": "1", "[time] steps": "2"}
    for what, keys, message in cases:
        lines: dict[str, str | None] = {f"[profile.line] {key}": value for key, value in keys.items()}
        yield f"a profile {what}", lines, ["[profile.line]", message]
        yield f"a profile {what}, in time", {**lines, **moving}, ["[profile.line]", message]
    for name in ("a" * 200, "\u00e9" * 60):
        table = f"[profile.'{name}']"
        yield "a profile's long name", {f"{table} from": "[0, 0]", f"{table} to": "[1, 1]", **moving}, ["[profile."]


def broken_meshes(right: Mapping[str, bytes]) -> Iterator[Broken]:
    """Mesh files torn at every tenth, and holding what is no mesh.

    Args:
        right: Mesh files that can be read, by name; an .xdmf with its .h5.
    """
    for name, content in right.items():
        mesh = name if name.endswith((".msh", ".geo", ".xdmf")) else name.replace(".h5", ".xdmf")
        for tenth in range(10):
            torn = content[: len(content) * tenth // 10]
            beside = {other: whole for other, whole in right.items() if Path(other).stem == Path(name).stem}
            yield _mesh(f"{name} torn at {tenth}/10", mesh, {**beside, name: torn}, [Path(name).stem])
    cases: list[tuple[str, str, Content | None, list[str]]] = [
        ("not there", "none.msh", None, ["no such"]),
        ("a folder", "a.msh", os.mkdir, []),
        ("a pipe", "a.msh", os.mkfifo, []),
        ("a folder, XDMF", "a.xdmf", os.mkdir, []),
        ("with a strange ending", "a.vtk", b"", [".msh"]),
        ("a text", "a.msh", b"no mesh at all\n", []),
        ("random bytes", "a.msh", bytes(range(256)) * 20, []),
        ("a text, XDMF", "a.xdmf", b"no mesh at all\n", []),
        ("XDMF without grid", "a.xdmf", b"<Xdmf><Domain></Domain></Xdmf>", ["mesh"]),
        ("XML that doubles", "a.xdmf", _billion_laughs(), []),
        ("a node that is not a number", "a.msh", _msh(nodes={2: ("nan", 0)}), []),
        ("a node at infinity", "a.msh", _msh(nodes={2: ("1e999", 0)}), []),
        ("a triangle without area", "a.msh", _msh(nodes={2: (0, 0)}), ["area"]),
        ("a triangle with a node that is not there", "a.msh", _msh(triangles=((1, 2, 9), (1, 3, 4))), []),
        ("a triangle twice", "a.msh", _msh(triangles=((1, 2, 3), (1, 2, 3), (1, 3, 4))), []),
        ("no triangles", "a.msh", _msh(triangles=()), []),
        ("cubic triangles", "a.msh", _msh(kind=21, triangles=((1, 2, 3, 4, 5, 6, 1, 2, 3, 4),)), ["degree"]),
        ("a count of 1e9", "a.msh", _msh().replace(b"$Nodes\n6", b"$Nodes\n1000000000"), []),
        ("a negative count", "a.msh", _msh().replace(b"$Nodes\n6", b"$Nodes\n-6"), []),
        ("geometry with a mistake", "a.geo", b"Point(1) = {0, 0, 0, 1;\n", []),
        ("geometry without surface", "a.geo", b"Point(1) = {0, 0, 0, 1};\n", ["cells"]),
        ("geometry that is open", "a.geo", b"Point(1) = {0, 0, 0};\nPoint(2) = {1, 0, 0};\nLine(1) = {1, 2};\n"
                                            b"Curve Loop(1) = {1};\nPlane Surface(1) = {1};\n", []),
    ]  # fmt: skip
    for what, name, given, names in cases:
        yield _mesh(f"mesh file: {what}", name, {} if given is None else {name: given}, [name, *names])
    yield _mesh("mesh file: a NUL in a name", "a\\u0000.msh", {}, ["a\\x00.msh: no such"])
    shape_in_file = scene_text({**LINES, "[mesh] shape": None, "[mesh] file": '"a.msh"', "[mesh] cells": None,
                                "[mesh] x": None, "[[boundary]] on": '"lft"'})  # fmt: skip
    quadrilaterals = scene_text({"[mesh] file": '"a.msh"', "[effects] tension": "1", "[[boundary]] value": "0",
                                 "[solve] element": '"P1"'})  # fmt: skip
    yield Broken("mesh file: an element for other cells", [SCENE, "[solve] element", "quadrilateral", "Q1"],
                 files={SCENE: quadrilaterals.encode(), "a.msh": _msh(kind=3, triangles=((1, 2, 3, 4),))})  # fmt: skip
    yield Broken("mesh file: a part that is not there", [SCENE, "lft"], files={SCENE: shape_in_file.encode(),
                                                                               "a.msh": _msh()})  # fmt: skip


def _mesh(what: str, mesh: str, files: Mapping[str, Content], names: list[str]) -> Broken:
    lines = {"[mesh] file": f'"{mesh}"', "[effects] tension": "1", "[effects] load": "-1", "[[boundary]] value": "0"}
    return Broken(what, names, files={SCENE: scene_text(lines).encode(), **files})


def _bomb(definitions: str, formula: str, key: str) -> bytes:
    changed = {"[obstacle] upper": None, "[define] c": None, "[effects] load": "-1", key: f'"{formula}"'}
    lines: dict[str, str | None] = {**LINES, **changed}
    del lines["title"], lines["u"]
    return f"[define]\na0 = 'x'\n{definitions}{scene_text(lines)}".encode()


def _msh(
    nodes: Mapping[int, tuple[object, object]] | None = None,
    triangles: tuple[tuple[int, ...], ...] = ((1, 2, 3), (1, 3, 4)),
    kind: int = 2,
) -> bytes:
    """A Gmsh file, version 2.2, of a square with its diagonal; node 5 is its middle, node 6 is outside."""
    places: dict[int, tuple[object, object]] = {1: (0, 0), 2: (1, 0), 3: (1, 1), 4: (0, 1), 5: (0.5, 0.5), 6: (0.5, 2)}
    places |= dict(nodes or {})
    points = "\n".join(f"{number} {x} {y} 0" for number, (x, y) in places.items())
    cells = "\n".join(f"{k} {kind} 2 1 1 {' '.join(map(str, cell))}" for k, cell in enumerate(triangles, start=1))
    head = "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n"
    text = f"{head}$Nodes\n6\n{points}\n$EndNodes\n$Elements\n{len(triangles)}\n{cells}\n$EndElements\n"
    return text.encode()


def _billion_laughs() -> bytes:
    rows = "".join(f'<!ENTITY a{k} "{f"&a{k - 1};" * 10}">\n' for k in range(1, 12))
    return f'<?xml version="1.0"?><!DOCTYPE Xdmf [<!ENTITY a0 "ha">\n{rows}]><Xdmf>&a11;</Xdmf>\n'.encode()
