"""A real Chromium for the tests of pages: what a page says on its console, what it asks
for, what axe finds.
"""

import shutil

import pytest
from helpers import GIVE_UP_SECONDS

BROWSERS = ("chromium", "chromium-browser", "google-chrome")


@pytest.fixture(scope="module")
def browser():
    path = next(filter(None, map(shutil.which, BROWSERS)), None)
    if path is None:
        pytest.skip(
            "no Chromium for the tests of pages; install it (Debian: apt-get install"
            " chromium)"
        )
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        pytest.skip(
            "no Playwright for the tests of pages; install it; in a clone: pip install"
            " '.[browser]'"
        )
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(
            executable_path=path, args=["--no-sandbox"]
        )
        yield chromium
        chromium.close()


@pytest.fixture(scope="module")
def axe():
    return pytest.importorskip(
        "axe_playwright_python.sync_playwright",
        reason="no axe; install it; in a clone: pip install '.[browser]'",
    ).Axe()


def opened(browser, address, width, scheme, **options):
    """(page, what its console says, what it asks for)."""
    context = browser.new_context(
        viewport={"width": width, "height": 900},
        color_scheme=scheme,
        reduced_motion="reduce",
        **options,
    )
    # a slow machine is no failure
    context.set_default_timeout(1000.0 * GIVE_UP_SECONDS)
    page = context.new_page()
    heard = []
    asked = []
    page.on("console", lambda message: heard.append(message.text))
    page.on("pageerror", lambda error: heard.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    page.goto(address)
    return page, heard, asked


def violations(axe, page):
    """(rule, where) of what axe finds; it must have looked."""
    result = axe.run(page).response
    assert len(result["passes"]) > 15
    return [
        (found["id"], found["nodes"][0]["html"][:200]) for found in result["violations"]
    ]
