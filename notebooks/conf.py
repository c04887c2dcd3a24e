"""Sphinx configuration of the site: the notebooks, executed, and every public name.

python -m sphinx -W notebooks build/site
"""

import importlib
import re
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
import dependencies

import oee_tabular

project = "oee_tabular"
author = "The oee_tabular maintainers"
release = version = oee_tabular.__version__
extensions = ["sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode", "myst_nb"]
root_doc = "index"
exclude_patterns = ["results", "site"]
html_theme = "pydata_sphinx_theme"
html_title = "oee_tabular"
html_show_sourcelink = False
html_theme_options = {"show_prev_next": True, "navigation_depth": 2}
nb_execution_mode = "cache"
nb_execution_timeout = 300
nb_execution_raise_on_error = True
nb_merge_streams = True
suppress_warnings = ["myst.header", "misc.highlighting_failure", "ref.python"]  # fields of one name in several classes
autodoc_member_order = "bysource"
autodoc_typehints = "none"
napoleon_use_param = False
napoleon_use_rtype = False
napoleon_use_ivar = True
MODULES = (
    "paper",
    "mdp",
    "data",
    "exact",
    "simulate",
    "tasks",
    "ratio",
    "estimators",
    "theory",
    "inference",
    "design",
    "testing",
    "report",
    "plots",
    "bench",
)

SECTIONS = {
    "Parameters", "Returns", "Raises", "Notes", "Examples", "Attributes", "Yields", "Warns", "See Also", "References",
}  # fmt: skip
RULE = re.compile(r"^-{3,}$")


def plain_docstrings(app, what, name, obj, options, lines):
    """Docstrings are plain text with formulas, not markup: what would be markup is escaped before napoleon reads it.

    A section's entries and prose keep their lines; indented formulas become literal blocks.
    """
    out, example = [], False
    for k, line in enumerate(lines):
        stripped = line.strip()
        if stripped in SECTIONS and k + 1 < len(lines) and RULE.match(lines[k + 1].strip()):
            example = stripped == "Examples"
            out.append(line)
            continue
        if RULE.match(stripped):
            out.append(line)
            continue
        if stripped.startswith(">>>") or (example and stripped):
            out.append(line)
            continue
        out.append(escaped(line))
    lines[:] = out


def escaped(line):
    """The line with what is markup in reStructuredText escaped, outside ``code``."""
    parts = re.split(r"(``[^`]+``)", line)
    return "".join(
        part if part.startswith("``") else re.sub(r"([\\*|`])|(?<=\w)_(?=\W|$)", lambda m: "\\" + m[0], part)
        for part in parts
    )


def public_names():
    """Module -> its public names: its ``__all__``."""
    found = {}
    for module in MODULES:
        loaded = importlib.import_module(f"oee_tabular.{module}")
        names = getattr(loaded, "__all__", None)
        if names is None:
            top = {name: getattr(getattr(oee_tabular, name), "__module__", "") for name in oee_tabular.__all__}
            names = [name for name, origin in top.items() if origin.startswith(f"oee_tabular.{module}")]
        found[module] = sorted(names)
    return found


def write_api(app):
    """A page for each module, from the names that it exports, and one of dependencies."""
    folder = Path(app.srcdir) / "api"
    folder.mkdir(exist_ok=True)
    for module, names in public_names().items():
        title = f"oee_tabular.{module}"
        text = [title, "=" * len(title), "", f".. automodule:: {title}", "   :no-members:", ""]
        for name in names:
            value = getattr(importlib.import_module(title), name)
            if isinstance(value, type):
                text += [f".. autoclass:: {title}.{name}", "   :members:", ""]
            elif callable(value):
                text += [f".. autofunction:: {title}.{name}", ""]
            else:
                shown = repr(value) if len(repr(value)) < 300 else f"{type(value).__name__} of {len(value)}"
                text += [f".. py:data:: {title}.{name}", "", f"   ``{shown}``", ""]
        write(folder / f"{module}.rst", "\n".join([*text, *short_names(module)]))
    write(folder / "dependencies.md", dependencies.page())


def short_names(module):
    """On the page of estimators: those that the command and ``evaluate`` know by name."""
    if module != "estimators":
        return []
    from oee_tabular.estimators.names import NAMED

    rows = [line for name, named in NAMED.items() for line in (f"``{name}``", f"    {escaped(named.meaning)}", "")]
    return ["Short names", "-----------", "", *rows]


def write(page, content):
    """The page, which Sphinx reads again only where it has changed."""
    if not page.is_file() or page.read_text() != content:
        page.write_text(content)


def setup(app):
    """Called by Sphinx."""
    app.connect("builder-inited", write_api)
    app.connect("autodoc-process-docstring", plain_docstrings, priority=100)
