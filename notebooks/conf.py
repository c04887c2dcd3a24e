"""Sphinx configuration of the site: the guide, the notebooks with their stored outputs,
commands and public names.

python -m sphinx -W notebooks build/site
"""

import importlib
import inspect
import re
import subprocess
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
import dependencies
import subjects
from docutils import nodes
from numpydoc.docscrape import NumpyDocString

import oee_tabular
from oee_tabular.cli.details import EXIT_CODES

project = "oee_tabular"
author = "The oee_tabular maintainers"
release = version = oee_tabular.__version__
extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "sphinx.ext.viewcode",
    "sphinx.ext.mathjax",
    "myst_nb",
]
root_doc = "index"
exclude_patterns = ["results", "site", "assignments/source"]
html_static_path = ["site.css", "static"]
myst_enable_extensions = ["dollarmath", "amsmath"]
# MathJax 3.2.2, which is part of the site: no page needs a network
mathjax_path = "mathjax/tex-svg.js"
html_css_files = ["site.css"]
myst_heading_anchors = 2
html_theme = "pydata_sphinx_theme"
html_title = "oee_tabular"
html_show_sourcelink = False
html_sidebars = {
    "*": [],
    "api/commands": [],
    "api/dependencies": [],
}  # pages that have none below them: the room is the code's
html_context = {"default_mode": "auto"}
html_theme_options = {
    "show_prev_next": True,
    "navigation_depth": 2,
    "header_links_before_dropdown": 5,
}
nb_execution_mode = "off"  # python tests/saved_notebook.py stores the outputs
nb_merge_streams = True
# fields of one name in several classes
suppress_warnings = ["myst.header", "misc.highlighting_failure", "ref.python"]
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the types stand in the docstrings, in words
autosummary_generate = False  # its tables link to the entries on the pages themselves
numpydoc_show_class_members = False
smartquotes = False  # which would make a dash of the two hyphens of an option


# the theme tells the console which colours it took; a page that has nothing to say is
# silent
SILENT = (
    'console.log = (log => (...words) => String(words[0]).startsWith("[PST]") ||'
    " log(...words))(console.log);"
)


def describe_pictures(app, doctree):
    """A picture of a notebook is described by the titles in the code that draws it."""
    for picture in doctree.findall(nodes.image):
        cell = picture.parent
        while cell and "cell" not in cell.get("classes", ()):
            cell = cell.parent
        if cell:
            code = next(cell.findall(nodes.literal_block)).astext()
            titles = re.findall(r'title(?:\(|=)\s*"([^"]+)"', code)
            picture["alt"] = (
                "; ".join(titles).replace("$", "")
                or "The picture that the code above draws"
            )


def nest_modules(app, page, template, context, doctree):
    """Sphinx's list of sources has lists between its items; they belong to the item
    before.
    """
    if page == "_modules/index":
        body = context["body"].replace("</li>\n<ul>", "\n<ul>")
        context["body"] = body.replace("</ul><li>", "</ul></li>\n<li>").replace(
            "</ul></ul>", "</ul></li></ul>"
        )


def write_api(app):
    """Write a page for each module, one of all names, of the commands, of dependencies.

    A module's page has for each subject a table, one line a name, and the entries.
    """
    folder = Path(app.srcdir) / "api"
    folder.mkdir(exist_ok=True)
    for module, headings in subjects.SUBJECTS.items():
        title = f"oee_tabular.{module}"
        text = [*heading(title, "="), f".. automodule:: {title}", "   :no-members:", ""]
        for subject, names in headings.items():
            text += [*heading(subject, "-"), *table(title, names, "")]
            for name in names:
                text += directive(title, name)
        write(folder / f"{module}.rst", "\n".join([*text, *short_names(module)]))
    write(folder / "index.rst", index())
    write(folder / "commands.md", commands())
    write(folder / "dependencies.md", dependencies.page())


def heading(text, line):
    """Return the lines of a heading."""
    return [text, line * len(text), ""]


def table(module, names, prefix=None):
    """Return the lines of a table that has a line for each name, with its summary.

    On the module's own page names have no prefix, elsewhere the module's.
    """
    loaded = importlib.import_module(module)
    shown = [name for name in names if callable(getattr(loaded, name))]
    if not shown:
        return []
    before = f"~{module}." if prefix is None else prefix
    rows = [f"   {before}{name}" for name in shown]
    return [".. autosummary::", "   :nosignatures:", "", *rows, ""]


def directive(module, name):
    """Return the lines that make autodoc show a name."""
    value = getattr(importlib.import_module(module), name)
    if isinstance(value, type):
        lines = [f".. autoclass:: {module}.{name}", "   :members:"]
        if hidden := ", ".join(hidden_members(value)):
            lines.append(f"   :exclude-members: {hidden}")
        return [*lines, ""]
    if callable(value):
        return [f".. autofunction:: {module}.{name}", ""]
    text = repr(value)
    if len(text) >= 300:
        text = f"{type(value).__name__} of {len(value)}"
    return [f".. py:data:: {module}.{name}", "", f"   ``{text}``", ""]


def hidden_members(kind):
    """Return the members of a class that need no entry of their own.

    These are the properties that its list of attributes has already, and other names
    of private functions.
    """
    text = inspect.cleandoc(kind.__doc__ or "")
    listed = {
        name.strip()
        for entry in NumpyDocString(text)["Attributes"]
        for name in entry.name.split(",")
    }
    for name, value in vars(kind).items():
        is_listed = isinstance(value, property) and name in listed
        is_private = getattr(value, "__name__", name).startswith("_")
        is_private |= issubclass(kind, dict) and name in vars(dict)
        if not name.startswith("_") and (is_listed or is_private):
            yield name


def hide_private_parameters(app, what, name, value, options, signature, returned):
    """Leave parameters that begin with an underscore out of the signatures."""
    if signature:
        return re.sub(r", _\w+=[^,)]*", "", signature), returned
    return None


def index():
    """Return the page of all public names, one line each, by module and subject."""
    text = [*heading("Public names", "=")]
    text += ["What ``import oee_tabular`` gives, by subject.", ""]
    for module, headings in subjects.SUBJECTS.items():
        title = f"oee_tabular.{module}"
        summary = importlib.import_module(title).__doc__.split("\n\n")[0]
        text += [*heading(title, "-"), " ".join(summary.split()), ""]
        text += [f":doc:`All about {module} <{module}>`", ""]
        for subject, names in headings.items():
            text += [f".. rubric:: {subject}", "", *table(title, names)]
    text += [".. toctree::", "   :hidden:", ""]
    return "\n".join([*text, *(f"   {module}" for module in subjects.SUBJECTS), ""])


def commands():
    """The reference of the command, which typer makes from it."""
    words = [
        sys.executable,
        "-m",
        "typer",
        "oee_tabular.cli",
        "utils",
        "docs",
        "--name",
        "oee",
    ]
    made = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    rows = "".join(f"| {code} | {text} |\n" for code, text in EXIT_CODES.items())
    table = f"\n## Exit codes\n\n| code | meaning |\n| --- | --- |\n{rows}"
    return made.replace("# `oee`\n", "# The commands\n", 1) + table


def short_names(module):
    """On the page of estimators: those that the command and ``evaluate`` know by name."""
    if module != "estimators":
        return []
    from oee_tabular.estimators.names import NAMED

    rows = (
        (f"``{name}``", f"    {named.meaning}", "") for name, named in NAMED.items()
    )
    return ["Short names", "-----------", "", *(line for row in rows for line in row)]


def write(page, content):
    """The page, which Sphinx reads again only where it has changed."""
    if not page.is_file() or page.read_text() != content:
        page.write_text(content)


def setup(app):
    """Called by Sphinx."""
    app.connect("builder-inited", write_api)
    app.connect("autodoc-process-signature", hide_private_parameters)
    app.connect("doctree-read", describe_pictures)
    app.connect("html-page-context", nest_modules)
    app.add_js_file(None, body=SILENT)
