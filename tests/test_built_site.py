"""The site as README's command builds it: formulas and pictures page by page, in a real
Chromium at two widths.
"""

import dataclasses
import importlib
import inspect
import re
import subprocess
import sys
from html import unescape
from pathlib import Path
from posixpath import dirname, join, normpath

import nbformat
import pytest
from browsing import axe, browser, opened, violations  # noqa: F401, fixtures
from saved_notebook import NOTEBOOKS

ROOT = Path(__file__).parents[1]
CODE = re.compile(r"^```.*?^```|`[^`\n]+`", re.S | re.M)
FORMULA = re.compile(r"\$\$.+?\$\$|\$[^$]+\$", re.S)
SHOWN_AS_IT_IS = re.compile(
    r"<(pre|code|script|style|title)\b.*?</\1>|<(span|div) class=\"math.*?</\2>", re.S
)
FORMULAS = """() => ({
    sources: document.querySelectorAll(".math").length,
    rendered: document.querySelectorAll(".math mjx-container > svg").length,
    wrong: document.querySelectorAll("mjx-merror, [data-mjx-error]").length,
})"""
WIDE_CODE = """() => [...document.querySelectorAll("pre")]
    .filter(e => e.scrollWidth > e.clientWidth + 1 && !e.closest(".cell_output")).map(e => e.innerText.slice(0, 80))"""
OUTSIDE = """() => [...document.querySelectorAll("main p, main li, main dt, main h1, main h2, main img, main pre")]
    .filter(e => e.getClientRects().length && !e.closest("table, .pst-scrollable-table-container, .bd-sidebar-secondary"))
    .filter(e => e.getBoundingClientRect().right > innerWidth + 1).map(e => e.outerHTML.slice(0, 80))"""
KINDS = (
    "index.html",
    "syllabus.html",
    "playground.html",
    "00_will_my_policy_work.html",
    "04_why_products_explode.html",
    "api/mdp.html",
)
EMPTY_PICTURES = (
    "() => [...document.images].filter(e => e.complete && !e.naturalWidth).map(e =>"
    " e.src)"
)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """{address from the root: path} of every page but the sources, as the README's
    command makes them.
    """
    folder = tmp_path_factory.mktemp("site")
    words = re.search(
        r"python (-m sphinx -W notebooks) build/site$",
        (ROOT / "README.md").read_text(),
        re.M,
    )[1].split()
    subprocess.run([sys.executable, *words, folder, "-q", "-E"], check=True, cwd=ROOT)
    pages = {str(path.relative_to(folder)): path for path in folder.rglob("*.html")}
    return {
        name: path
        for name, path in pages.items()
        if not name.startswith(("_modules", "_static"))
    }


def count(book):
    """(formulas, pictures) of a notebook."""
    texts = [
        CODE.sub("", cell.source) for cell in book.cells if cell.cell_type == "markdown"
    ]
    outputs = [output for cell in book.cells for output in cell.get("outputs", [])]
    pictures = sum("image/png" in output.get("data", {}) for output in outputs)
    return sum(len(FORMULA.findall(text)) for text in texts), pictures


def test_every_notebook_s_formulas_and_pictures_are_on_its_page(site):
    counts = {}
    for path in NOTEBOOKS:
        html = site[f"{path.stem}.html"].read_text()
        counts[path.stem] = count(nbformat.read(path, as_version=4))
        assert (html.count('class="math '), html.count('<img alt="')) == counts[
            path.stem
        ], path.stem
        assert '<img alt="_images' not in html, path.stem
    assert all(
        formulas >= 5 and pictures >= 1 for formulas, pictures in counts.values()
    )


def test_no_page_shows_a_dollar_or_lacks_its_notebooks_link(site):
    for name, path in site.items():
        html = path.read_text()
        assert "$" not in SHOWN_AS_IT_IS.sub("", html), name
        if name not in ("search.html", "genindex.html", "py-modindex.html"):
            assert re.search(
                r'class="nav-link[^>]*href="[./]*(syllabus.html|#)"', html
            ), name


def test_every_page_in_a_browser(site, browser, axe):  # noqa: F811
    """Two widths, of most pages in one load (theirs without axe, since a theme's script
    looks at the width of a load).
    """
    loads = [
        (name, widths)
        for name in sorted(site)
        for widths in ([[1280], [400]] if name in KINDS else [[1280, 400]])
    ]
    for k, (name, widths) in enumerate(loads):
        page, heard, asked = opened(
            browser, site[name].as_uri(), widths[0], ("light", "dark")[k % 2]
        )
        page.evaluate("window.MathJax?.startup?.promise")
        found = page.evaluate(FORMULAS)
        assert (found["rendered"], found["wrong"]) == (found["sources"], 0), name
        for width in widths:
            page.set_viewport_size({"width": width, "height": 900})
            assert page.evaluate("document.documentElement.scrollWidth") <= width, name
            assert page.evaluate(WIDE_CODE) == [], name
            assert page.evaluate(OUTSIDE) == [], name
            assert page.evaluate(EMPTY_PICTURES) == [], name
        assert heard == [], name
        assert [url for url in asked if not url.startswith(("file:", "data:"))] == [], (
            name
        )
        if name in KINDS:
            assert violations(axe, page) == [], name
        page.context.close()


def anchors(html):
    """The names of the places on a page that a link can lead to."""
    return set(re.findall(r'\b(?:id|name)="([^"]+)"', html))


def test_every_link_to_a_place_on_a_page_leads_there(site):
    pages = {name: path.read_text() for name, path in site.items()}
    sources = next(iter(site.values())).parents[0] / "_modules"
    for path in sources.rglob("*.html"):
        pages[path.relative_to(sources.parent).as_posix()] = path.read_text()
    places = {name: anchors(html) for name, html in pages.items()}
    checked = 0
    for name, html in pages.items():
        for link in re.findall(r'<a\b[^>]*\bhref="([^"]+)"', html):
            page, _, place = unescape(link).partition("#")
            if not place or re.match(r"\w+:", page):
                continue
            target = normpath(join(dirname(name), page)) if page else name
            assert place in places[target], (name, link)
            checked += 1
    assert checked > 1000


def test_the_menu_stays_in_the_window(site, browser):  # noqa: F811
    """What "More" folds out in the head of a page, at the usual width of a laptop."""
    page, _, _ = opened(browser, site["index.html"].as_uri(), 1280, "light")
    page.set_viewport_size({"width": 1280, "height": 720})
    header = page.locator("header").first.bounding_box()
    assert header["height"] < 90  # in one line
    page.locator("header .dropdown-toggle", has_text="More").first.click()
    menu = page.locator("header .dropdown-menu.show").first.bounding_box()
    assert menu["y"] + menu["height"] <= 720
    page.context.close()


def test_no_page_has_an_empty_sidebar(site):
    for name, path in site.items():
        html = path.read_text()
        sidebar = re.search(
            r'<(?:div|dialog)[^>]*class="bd-sidebar-primary([^"]*)".*?<main', html, re.S
        )
        if sidebar is None or "hide-on-wide" in sidebar[1]:
            continue
        links = re.findall(r'class="reference internal', sidebar[0])
        assert links, name


# ---- the site: every public name by subject, every attribute under its own name, every
# command and option


@pytest.fixture
def subjects(monkeypatch):
    """The module that lists the public names by subject."""
    monkeypatch.syspath_prepend(str(ROOT / "notebooks"))
    yield importlib.import_module("subjects")
    sys.modules.pop("subjects", None)


def test_every_public_name_is_listed_once_by_subject(subjects):
    for module, headings in subjects.SUBJECTS.items():
        names = [name for group in headings.values() for name in group]
        assert len(names) == len(set(names)), module
        assert set(names) >= subjects.public(module), module
        loaded = importlib.import_module(f"oee_tabular.{module}")
        assert all(hasattr(loaded, name) for name in names), module


def test_every_attribute_has_an_entry_of_its_own(subjects):
    """Fields of results that a docstring mentions in its list of attributes."""
    docscrape = pytest.importorskip("numpydoc.docscrape")
    checked = 0
    for module, headings in subjects.SUBJECTS.items():
        loaded = importlib.import_module(f"oee_tabular.{module}")
        for name in (name for group in headings.values() for name in group):
            value = getattr(loaded, name)
            if (
                not (inspect.isclass(value) and dataclasses.is_dataclass(value))
                or "Attributes\n" not in value.__doc__
            ):
                continue
            sections = docscrape.NumpyDocString(inspect.cleandoc(value.__doc__))
            entries = {
                field.strip()
                for entry in (*sections["Attributes"], *sections["Parameters"])
                for field in entry.name.split(",")
            }
            own = {
                field.name
                for field in dataclasses.fields(value)
                if not field.name.startswith("_")
            }
            inherited = {
                field
                for base in value.__mro__[1:]
                for field in getattr(base, "__dataclass_fields__", ())
            }
            assert own - inherited <= entries, name
            checked += len(own - inherited)
    assert checked > 150


def test_the_reference_of_commands_has_every_option(monkeypatch):
    pytest.importorskip("sphinx")
    monkeypatch.syspath_prepend(str(ROOT / "notebooks"))
    import typer

    from oee_tabular.cli import app

    conf = importlib.import_module("conf")
    text = conf.commands()
    assert text.startswith("# The commands\n")
    for name, command in typer.main.get_command(app).commands.items():
        part = text.split(f"## `oee {name}`\n")[1].split("\n## ")[0]
        for option in command.params:
            if option.opts[0].startswith("-"):
                assert f"`{option.opts[0]}" in part, (name, option.name)
    for module in ("conf", "subjects", "dependencies"):
        sys.modules.pop(module, None)
