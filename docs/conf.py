"""How Sphinx makes a site of these pages; `./obstacle docs` runs it, and any warning is an error."""

import sys
from importlib.metadata import version as version_of
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "_extensions"))

project = "fenicsx_obstacle"
author = "the fenicsx_obstacle developers"
version = release = version_of(project)

extensions = [
    "myst_parser",
    "sphinx.ext.apidoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_click",
    "mathml",
    "measured",
    "notebooks",
    "packages",
    "pictures",
    "plain_docstrings",
    "statements",
]
exclude_patterns = ["_extensions", "measured", "out", "paper"]

# generated and not committed: every module of the package, with everything that has a docstring
apidoc_modules = [
    {
        "path": "../fenicsx_obstacle",
        "destination": "reference",
        "exclude_patterns": ["../fenicsx_obstacle/__main__.py"],
        "separate_modules": False,
        "module_first": True,
        "automodule_options": {"members", "show-inheritance"},
    }
]
autodoc_member_order = "bysource"
autodoc_class_signature = "separated"
autodoc_default_options = {"exclude-members": "__new__"}
autodoc_typehints = "signature"
python_use_unqualified_type_names = True
napoleon_numpy_docstring = False
napoleon_use_rtype = False
default_role = "code"
napoleon_use_ivar = True
toc_object_entries = False  # one page for each layer; its modules are in the contents, its functions are not

myst_heading_anchors = 3
myst_enable_extensions = ["dollarmath"]
nitpicky = True  # names of this package must exist; names of other packages are not checked
nitpick_ignore_regex = [
    ("py:.*", r"(?!fenicsx_obstacle\.).*"),
    ("py:class", r".*\.(Name|Result|Sampled|T|Value|_PartTable)"),  # type variables, a private base class
]
suppress_warnings = ["ref.python"]  # two modules may have a Row or a Distance of their own

html_math_renderer = "mathml"
html_static_path = ["_static"]
html_css_files = ["pages.css"]
html_show_copyright = False
html_theme = "furo"
html_title = f"{project} {release}"
