"""The site as README's command builds it: formulas and pictures page by page, in a real
Chromium at two widths.
"""

import dataclasses
import functools
import importlib
import inspect
import re
import subprocess
import sys
import threading
from html import unescape
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from posixpath import dirname, join, normpath

import nbformat
import pytest
from browsing import axe, browser, opened, violations  # noqa: F401, fixtures
from helpers import run_command
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
# pages that differ in what they are made of; axe looks at them at both widths
KINDS = (
    "index.html",
    "install.html",
    "gallery.html",
    "syllabus.html",
    "playground.html",
    "example_report.html",
    "how_to.html",
    "own_estimator.html",
    "00_will_my_policy_work.html",
    "04_why_products_explode.html",
    "api/mdp.html",
    "results/fig1a/summary.html",
)
# what Sphinx or the command makes: no page of the site's own
MADE = ("search.html", "genindex.html", "py-modindex.html", "example_report.html")
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


def forget_modules_of_the_site():
    """Leave no module behind whose name another may have."""
    for path in (ROOT / "notebooks").glob("*.py"):
        sys.modules.pop(path.stem, None)


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
        if name not in MADE:
            assert re.search(
                r'class="nav-link[^>]*href="[./]*(syllabus.html|#)"', html
            ), name


def test_every_page_in_a_browser(site, browser, axe):  # noqa: F811
    """Two widths, of most pages in one load (theirs without axe, since a theme's script
    looks at the width of a load). A tab for each scheme goes from page to page, which
    takes half as long as a new one for each.
    """
    loads = [
        (name, widths)
        for name in sorted(site)
        for widths in ([[1280], [400]] if name in KINDS else [[1280, 400]])
    ]
    tabs = [
        opened(browser, "about:blank", 1280, scheme) for scheme in ("light", "dark")
    ]
    for k, (name, widths) in enumerate(loads):
        page, heard, asked = tabs[k % 2]
        heard.clear()
        asked.clear()
        page.set_viewport_size({"width": widths[0], "height": 900})
        page.goto(site[name].as_uri())
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
    for page, _, _ in tabs:
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


def test_the_four_menus_stay_in_the_window(site, browser):  # noqa: F811
    """What a group folds out in the head of a page, at the usual width of a laptop."""
    page, _, _ = opened(browser, site["index.html"].as_uri(), 1280, "light")
    page.set_viewport_size({"width": 1280, "height": 720})
    header = page.locator("header").first.bounding_box()
    assert header["height"] < 90  # in one line
    groups = page.locator("header .navbar-nav .dropdown-toggle")
    assert groups.all_inner_texts() == ["Learn", "Use", "Reference", "About"]
    for group in groups.all():
        group.click()
        menu = page.locator("header .dropdown-menu.show")
        assert menu.count() == 1
        box = menu.bounding_box()
        assert box["x"] >= 0
        assert box["x"] + box["width"] <= 1280
        assert box["y"] + box["height"] <= 720
    page.context.close()


def test_the_menu_is_folded_out_on_a_small_screen(site, browser):  # noqa: F811
    page, _, _ = opened(browser, site["guide.html"].as_uri(), 400, "light")
    page.locator("button.primary-toggle").first.click()
    links = page.locator("#pst-primary-sidebar-modal .dropdown-menu a")
    assert links.count() > 25
    assert all(link.is_visible() for link in links.all())
    for link in links.all():
        box = link.bounding_box()
        assert box["x"] + box["width"] <= 400
    page.context.close()


def test_the_menu_has_every_page_that_stands_alone(site, monkeypatch):
    """A page below none of another's is in the menu, in one group."""
    monkeypatch.syspath_prepend(str(ROOT / "notebooks"))
    groups = importlib.import_module("menu").GROUPS
    sys.modules.pop("menu")
    pages = [page for group in groups.values() for page in group.values()]
    assert len(pages) == len(set(pages))
    assert all(f"{page}.html" in site for page in [*pages, *groups])
    text = (ROOT / "notebooks" / "development.md").read_text()
    below = re.findall(r"^- \[.*?\]\((\w+)\.md\)", text, re.M)
    alone = {path.stem for path in (ROOT / "notebooks").glob("*.md")}
    assert alone == {page for page in [*pages, *below, *groups] if "/" not in page} | {
        "index"
    }


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


# ---- what the site has beside its pages: the report, files, pictures, buttons, a search


def test_the_example_report_is_what_the_command_writes(site, tmp_path):
    assert run_command("evaluate", "--report", str(tmp_path / "page.html")) == 0
    written = (tmp_path / "page.html").read_text()
    shown = site["example_report.html"].read_text()
    days = re.compile(r"\b20\d\d-\d\d-\d\d\b")  # the site may be of yesterday
    assert days.sub("", shown) == days.sub("", written)
    home = site["index.html"].read_text()
    assert re.search(r'<iframe[^>]*src="example_report.html"[^>]*title="[^"]+"', home)
    assert '<a href="example_report.html">' in home


def test_every_notebook_can_be_downloaded(site):
    folder = site["index.html"].parent
    assignments = sorted((ROOT / "notebooks/assignments/release").rglob("*.ipynb"))
    assert len(assignments) == 8
    for source in [*NOTEBOOKS, *assignments]:
        name = source.relative_to(ROOT / "notebooks").with_suffix(".html").as_posix()
        links = re.findall(r'<a href="([^"]+)" download>', site[name].read_text())
        files = [normpath(join(dirname(name), link)) for link in links]
        assert f"downloads/{source.name}" == files[0]
        assert (folder / files[0]).read_bytes() == source.read_bytes()
        if source in NOTEBOOKS:
            script = (folder / files[1]).read_text()
            compile(script, files[1], "exec")
            book = nbformat.read(source, as_version=4)
            cells = sum(cell.cell_type in ("code", "markdown") for cell in book.cells)
            assert len(re.findall(r"^# %%", script, re.M)) == cells
            assert re.search(
                r'notebook-facts">(Beginner|Intermediate|Advanced) · about \d+ minutes',
                site[name].read_text(),
            )


def test_a_result_s_page_links_to_its_table(site):
    """A file to download: every seed behind the table on the page."""
    folder = site["index.html"].parent
    tables = sorted((ROOT / "notebooks" / "results").glob("*/table.csv"))
    tables = [table for table in tables if table.with_name("summary.md").is_file()]
    assert len(tables) > 25
    for table in tables:
        name = f"results/{table.parent.name}/summary.html"
        (link,) = re.findall(
            r'<a class="[^"]*download[^"]*"[^>]*href="([^"]+table\.csv)"',
            site[name].read_text(),
        )
        file = folder / normpath(join(dirname(name), link))
        assert file.read_bytes() == table.read_bytes(), name


def test_the_gallery_has_every_picture_and_every_result(site):
    html = site["gallery.html"].read_text()
    cards = re.findall(r'<div class="sd-card .*?</a>\s*</div>', html, re.S)
    pictures = sum(count(nbformat.read(path, as_version=4))[1] for path in NOTEBOOKS)
    results = sorted((ROOT / "notebooks" / "results").glob("*/figure.png"))
    assert len(cards) == pictures + len(results)
    for card in cards:
        assert re.search(r'<img alt="[^"]{10,}"', card), card
        assert re.search(r'href="[\w/]+\.html"', card), card
    for path in results:
        assert f'href="results/{path.parent.name}/summary.html"' in html


def test_wide_tables_scroll_and_say_so(site, browser):  # noqa: F811
    page, _, _ = opened(browser, site["speed.html"].as_uri(), 400, "light")
    box = page.locator(".pst-scrollable-table-container").first
    hint = page.locator(".scroll-hint").first
    hint.wait_for(state="visible")
    assert "sideways" in hint.inner_text()
    assert box.get_attribute("tabindex") == "0"
    box.focus()
    page.keyboard.press("ArrowRight")
    page.wait_for_function(
        "document.querySelector('.pst-scrollable-table-container').scrollLeft > 0"
    )
    page.set_viewport_size({"width": 1600, "height": 900})
    hint.wait_for(state="hidden")
    page.context.close()


def test_drawings_take_the_page_s_colours(site, browser):  # noqa: F811
    """Words of the drawings of the home page are dark on light and light on dark."""
    inks = """() => [...document.querySelectorAll(".drawing svg text")]
        .map(e => getComputedStyle(e).fill.match(/\\d+/g).slice(0, 3)
        .reduce((sum, part) => sum + Number(part), 0) / 3)"""
    for scheme, is_right in (
        ("light", lambda ink: ink < 128),
        ("dark", lambda ink: ink > 128),
    ):
        page, _, _ = opened(browser, site["index.html"].as_uri(), 1280, scheme)
        found = page.evaluate(inks)
        assert len(found) > 20
        assert all(is_right(ink) for ink in found), scheme
        page.context.close()


def test_code_has_copy_buttons_and_outputs_have_none(site, browser):  # noqa: F811
    page, _, _ = opened(
        browser, site["00_will_my_policy_work.html"].as_uri(), 1280, "light"
    )
    assert page.locator(".cell_input button.copybtn").count() > 5
    assert page.locator(".cell_output button.copybtn").count() == 0
    page.context.close()


@pytest.fixture(scope="module")
def served(site):
    """The address of the site on a server of its own: a search reads its pages."""
    folder = str(site["index.html"].parent)
    handler = functools.partial(Quiet, directory=folder)
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        yield f"http://127.0.0.1:{server.server_address[1]}"
        server.shutdown()
        thread.join()


class Quiet(SimpleHTTPRequestHandler):
    """A server that prints nothing."""

    def log_message(self, *words):
        pass


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("install", "install.html"),
        ("citing", "citing.html"),
        ("delay", "how_to.html"),
        ("CSV", "how_to.html"),
    ],
)
def test_the_search_finds(words, expected, served, browser):  # noqa: F811
    page, heard, _ = opened(browser, f"{served}/search.html?q={words}", 1280, "light")
    page.locator("#search-results ul.search li a").first.wait_for()
    page.wait_for_function(
        "!document.querySelector('#search-progress')?.innerText.includes('Preparing')"
        " && document.querySelector('#search-results p.search-summary')"
        "?.innerText.includes('found')"
    )
    links = page.locator("#search-results ul.search > li > a")
    addresses = [link.get_attribute("href") for link in links.all()]
    pages = [address.partition("?")[0].partition("#")[0] for address in addresses]
    assert expected in pages[:10], pages[:10]
    assert heard == []
    page.context.close()


@pytest.mark.parametrize(("said", "asks"), [("", False), ("1", True)])
def test_other_sites_are_asked_only_where_there_is_a_network(said, asks, monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "notebooks"))
    monkeypatch.setenv("OEE_SITE_NETWORK", said)
    conf = importlib.import_module("conf")
    forget_modules_of_the_site()
    assert ("sphinx.ext.intersphinx" in conf.extensions) == asks


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
    forget_modules_of_the_site()
