"""The site as README's command builds it: formulas and pictures page by page, in a real Chromium at two widths."""

import re
import subprocess
import sys

import nbformat
import pytest
from browsing import axe, browser, opened, violations  # noqa: F401
from saved_notebook import NOTEBOOKS

CODE = re.compile(r"^```.*?^```|`[^`\n]+`", re.S | re.M)
FORMULA = re.compile(r"\$\$.+?\$\$|\$[^$]+\$", re.S)
SHOWN_AS_IT_IS = re.compile(r"<(pre|code|script|style|title)\b.*?</\1>|<(span|div) class=\"math.*?</\2>", re.S)
FORMULAS = """() => ({
    sources: document.querySelectorAll(".math").length,
    rendered: document.querySelectorAll(".math mjx-container > svg").length,
    wrong: document.querySelectorAll("mjx-merror, [data-mjx-error]").length,
})"""
WIDE_CODE = """() => [...document.querySelectorAll("pre")]
    .filter(e => e.scrollWidth > e.clientWidth + 1 && !e.closest(".cell_output")).map(e => e.innerText.slice(0, 80))"""
OUTSIDE = """() => [...document.querySelectorAll("main p, main li, main dt, main h1, main h2, main img, main pre")]
    .filter(e => e.getClientRects().length && !e.closest("table, .pst-scrollable-table-container"))
    .filter(e => e.getBoundingClientRect().right > innerWidth + 1).map(e => e.outerHTML.slice(0, 80))"""
KINDS = ("index.html", "syllabus.html", "00_will_my_policy_work.html", "04_why_products_explode.html", "api/mdp.html")
EMPTY_PICTURES = "() => [...document.images].filter(e => e.complete && !e.naturalWidth).map(e => e.src)"


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """{address from the root: path} of every page but the sources."""
    folder = tmp_path_factory.mktemp("site")
    notebooks = NOTEBOOKS[0].parent
    subprocess.run([sys.executable, "-m", "sphinx", "-q", "-W", "-E", notebooks, folder], check=True)
    pages = {str(path.relative_to(folder)): path for path in folder.rglob("*.html")}
    return {name: path for name, path in pages.items() if not name.startswith(("_modules", "_static"))}


def count(book):
    """(formulas, pictures) of a notebook."""
    texts = [CODE.sub("", cell.source) for cell in book.cells if cell.cell_type == "markdown"]
    outputs = [output for cell in book.cells for output in cell.get("outputs", [])]
    pictures = sum("image/png" in output.get("data", {}) for output in outputs)
    return sum(len(FORMULA.findall(text)) for text in texts), pictures


def test_every_notebook_s_formulas_and_pictures_are_on_its_page(site):
    counts = {}
    for path in NOTEBOOKS:
        html = site[f"{path.stem}.html"].read_text()
        counts[path.stem] = count(nbformat.read(path, as_version=4))
        assert (html.count('class="math '), html.count('<img alt="')) == counts[path.stem], path.stem
        assert '<img alt="_images' not in html, path.stem
    assert all(formulas >= 5 and pictures >= 1 for formulas, pictures in counts.values())


def test_no_page_shows_a_dollar_or_lacks_its_notebooks_link(site):
    for name, path in site.items():
        html = path.read_text()
        assert "$" not in SHOWN_AS_IT_IS.sub("", html), name
        if name not in ("search.html", "genindex.html", "py-modindex.html"):
            assert re.search(r'class="nav-link[^>]*href="[./]*(syllabus.html|#)"', html), name


@pytest.mark.parametrize("width", [1280, 400])
def test_every_page_in_a_browser(site, browser, axe, width):  # noqa: F811
    for k, (name, path) in enumerate(sorted(site.items())):
        scheme = ("light", "dark")[k % 2]
        page, heard, asked = opened(browser, path.as_uri(), width, scheme)
        page.evaluate("window.MathJax?.startup?.promise")
        found = page.evaluate(FORMULAS)
        assert (found["rendered"], found["wrong"]) == (found["sources"], 0), name
        assert heard == [], name
        assert [url for url in asked if not url.startswith(("file:", "data:"))] == [], name
        assert page.evaluate("document.documentElement.scrollWidth") <= width, name
        assert page.evaluate(WIDE_CODE) == [], name
        assert page.evaluate(OUTSIDE) == [], name
        assert page.evaluate(EMPTY_PICTURES) == [], name
        if name in KINDS:
            assert violations(axe, page) == [], name
        page.context.close()
