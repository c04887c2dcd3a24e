"""Sphinx configuration of the site: the guide, the notebooks with their stored outputs,
commands and public names.

python -m sphinx -W notebooks build/site

OEE_SITE_NETWORK=1 says that there is a network: names of other packages in docstrings
become links to their sites. Without it nothing is asked for.
"""

import importlib
import inspect
import os
import re
import subprocess
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
import books
import dependencies
import drawings
import gallery
import menu
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
    "sphinx_copybutton",
    "sphinx_design",
]
if os.environ.get("OEE_SITE_NETWORK"):
    extensions.append("sphinx.ext.intersphinx")
intersphinx_mapping = {
    "python": ("https://docs.python.org/3", None),
    "numpy": ("https://numpy.org/doc/stable", None),
    "scipy": ("https://docs.scipy.org/doc/scipy", None),
    "pandas": ("https://pandas.pydata.org/docs", None),
    "matplotlib": ("https://matplotlib.org/stable", None),
    "gymnasium": ("https://gymnasium.farama.org", None),
}
root_doc = "index"
exclude_patterns = [
    "site",
    "assignments/source",
    # the gallery has what the list of results has, and the benchmark's page the leagues
    "results/index.md",
    "results/*/league.md",
]
html_static_path = ["site.css", "static"]
myst_enable_extensions = ["dollarmath", "amsmath", "colon_fence"]
# what is copied has no prompts; outputs have no button
copybutton_selector = (
    "div:not(.output, .highlight-text, .highlight-none) > div.highlight > pre"
)
copybutton_prompt_text = r">>> |\.\.\. "
copybutton_prompt_is_regexp = True
# MathJax 3.2.2, which is part of the site: no page needs a network
mathjax_path = "mathjax/tex-svg.js"
html_css_files = ["site.css"]
html_js_files = ["site.js"]
myst_heading_anchors = 2
templates_path = ["templates"]
html_favicon = "static/icon.svg"
html_theme = "pydata_sphinx_theme"
html_title = "oee_tabular"
html_show_sourcelink = False
html_sidebars = {
    "*": [],
    "api/commands": [],
    "api/dependencies": [],
    "assignments/**": [],
    "results/**": [],
}  # the menu has these pages: the room is the code's, and the tables'
html_context = {"default_mode": "auto"}
html_theme_options = {
    "show_prev_next": True,
    "navigation_depth": 3,
    "navbar_center": ["groups"],
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
            picture["alt"] = (
                books.picture_title(code) or "The picture that the code above draws"
            )


def fill_gallery(app, page, source):
    """Put the cards into the gallery's page."""
    if page == "gallery":
        source[0] = gallery.fill(source[0])


def read_again(app, env, added, changed, removed):
    """Name the pages that are read each time: cards follow the notebooks' pictures."""
    return ["gallery"]


def add_facts(app, page, template, context, doctree):
    """Put level, minutes and files of a notebook below its title."""
    if page in app.env.found_docs:
        root = "../" * page.count("/")
        body = context["body"]
        context["body"] = body.replace("</h1>", f"</h1>\n{books.facts(page, root)}", 1)


def add_menu(app, page, template, context, doctree):
    """Give a page the menu, in which its own group is marked."""
    context["menu"] = menu.menu(page, app.env.toctree_includes)


# The home page shows the page that this command writes.
EXAMPLE = "example_report.html"  # oee evaluate --report


def start_example(app):
    """Start the command of the home page, which works while the pages are read."""
    folder = Path(app.outdir)
    folder.mkdir(parents=True, exist_ok=True)
    page = (folder / EXAMPLE).resolve()
    page.unlink(missing_ok=True)
    app.example = subprocess.Popen(
        [sys.executable, "-m", "oee_tabular", "evaluate", "--report", str(page)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def finish_site(app, error):
    """Wait for the example, and write the files that can be downloaded."""
    _, said = app.example.communicate()
    if error is None and app.example.returncode:
        raise RuntimeError(f"oee evaluate --report {EXAMPLE} failed: {said}")
    if error is None:
        for page in app.env.found_docs:
            books.write_files(page, Path(app.outdir))


def mend_lists(app, page, template, context, doctree):
    """Make lists what readers of screens take for lists.

    Sphinx's list of sources has lists between its items; they belong to the item
    before. The entries of docutils' lists of references have a role of books.
    """
    body = context.get("body", "")
    if page == "_modules/index":
        body = body.replace("</li>\n<ul>", "\n<ul>")
        body = body.replace("</ul><li>", "</ul></li>\n<li>")
        body = body.replace("</ul></ul>", "</ul></li></ul>")
    context["body"] = body.replace('role="doc-biblioentry"', 'role="listitem"')


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
    app.connect("builder-inited", start_example)
    app.connect("env-get-outdated", read_again)
    app.connect("source-read", fill_gallery)
    app.connect("doctree-read", drawings.put_into_page)
    app.connect("autodoc-process-signature", hide_private_parameters)
    app.connect("doctree-read", describe_pictures)
    app.connect("html-page-context", mend_lists)
    app.connect("html-page-context", add_facts)
    app.connect("html-page-context", add_menu)
    app.connect("build-finished", finish_site)
    app.add_js_file(None, body=SILENT)
