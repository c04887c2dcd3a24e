"""The page in a real Chromium: no errors, no requests, every width, both schemes, the
keyboard, and axe's findings.
"""

import pytest
from browsing import axe, browser, opened, violations  # noqa: F401
from helpers import wait_until

import oee_tabular as oee
from oee_tabular.tasks import embedded_default

WIDTHS = (400, 1400)
SCHEMES = ("light", "dark")


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """The reports on FrozenLake and on the embedded default (a few of its estimators),
    as files.
    """
    folder = tmp_path_factory.mktemp("pages")
    simulator, target = (
        oee.tasks.toy_text("FrozenLake-v1", map_name="8x8", success_rate=rate)
        for rate in (1 / 3, 0.6)
    )
    behavior = oee.mix(oee.optimal_policy(target), oee.uniform_policy(target), 0.49)
    log = oee.sample_episodes(target, behavior, 300, 100, seed=2)
    mine = {
        "mine": oee.mix(oee.optimal_policy(target), oee.uniform_policy(target), 0.7)
    }
    oee.evaluate(oee.Problem(simulator, log), mine, seed=0).to_html(
        folder / "lake.html"
    )
    default = embedded_default(seed=0)
    problem = oee.Problem(
        default.simulator,
        default.log,
        horizon=default.horizon,
        behavior_policy=default.behavior_policy,
        episodes=default.episodes,
    )
    names = ["simulator", "oee", "ratio-of-ratios", "model-based", "pdis"]
    found = oee.evaluate(
        problem,
        default.policies,
        estimators=names,
        target=default.target,
        seed=0,
        normalized=True,
    )
    found.to_html(folder / "default.html")
    taxi = oee.tasks.toy_text("Taxi-v4")
    log = oee.sample_episodes(taxi, oee.uniform_policy(taxi), 5, 50, seed=0)
    names = {"<b>x</b> $ " + "long" * 40: oee.uniform_policy(taxi)}
    oee.evaluate(oee.Problem(taxi, log), names, estimators="oee", seed=0).to_html(
        folder / "generic.html"
    )
    return {path.stem: path.as_uri() for path in folder.iterdir()}


@pytest.mark.parametrize("name", ["lake", "default", "generic"])
def test_it_loads_alone_and_fits(browser, pages, name):  # noqa: F811
    for width in WIDTHS:
        for scheme in SCHEMES:
            page, heard, asked = opened(browser, pages[name], width, scheme)
            assert heard == []
            assert asked == [pages[name]]
            assert page.evaluate("document.documentElement.scrollWidth") <= width
            outside = page.evaluate(
                """() => [...document.querySelectorAll('main p, main dd, h1, h2, h3, svg.plot, li')]
                    .filter(e => e.getClientRects().length)
                    .filter(e => e.getBoundingClientRect().right > innerWidth + 1).map(e => e.outerHTML.slice(0, 80))"""
            )
            assert outside == []
            assert page.locator("svg.plot").count() >= 2
            smallest = page.evaluate(
                "Math.min(...[...document.querySelectorAll('svg.plot')].map(e =>"
                " e.getBoundingClientRect().width))"
            )
            assert smallest > 250
            page.context.close()


@pytest.mark.parametrize("name", ["lake", "default", "generic"])
def test_axe_finds_nothing_serious(browser, axe, pages, name):  # noqa: F811
    # layout and colours do not depend on each other
    for width, scheme in zip(WIDTHS, SCHEMES, strict=True):
        page, _, _ = opened(browser, pages[name], width, scheme, bypass_csp=True)
        page.evaluate(
            "document.querySelectorAll('details').forEach(e => e.open = true)"
        )
        assert violations(axe, page) == []
        page.context.close()


def test_axe_would_find_a_picture_without_a_name(browser, axe):  # noqa: F811
    page = browser.new_page()
    page.set_content('<main><svg role="img" width="9" height="9"></svg></main>')
    assert "svg-img-alt" in [
        found["id"] for found in axe.run(page).response["violations"]
    ]
    page.close()


def test_everything_is_reached_by_keyboard(browser, pages):  # noqa: F811
    page, _, _ = opened(browser, pages["lake"], 400, "light")
    wanted = page.evaluate(
        'document.querySelectorAll(\'a[href], summary, [tabindex="0"],'
        " fieldset.sort').length"
    )
    seen = []
    for _ in range(wanted):
        page.keyboard.press("Tab")
        seen.append(
            page.evaluate(
                """() => { const e = document.activeElement, s = getComputedStyle(e), r = e.getBoundingClientRect();
                return [e.outerHTML.slice(0, 60), s.outlineStyle !== 'none' && parseFloat(s.outlineWidth) >= 2,
                        r.right > 0 && r.left < innerWidth]; }"""
            )
        )
    assert len({html for html, _, _ in seen}) > 10
    assert "skip" in seen[0][0]
    assert all(outlined and visible for _, outlined, visible in seen)
    assert page.evaluate("document.activeElement.tagName") == "SUMMARY"
    page.keyboard.press("Enter")
    assert page.evaluate("document.activeElement.parentElement.open")
    table = page.locator("#changes .scroll")
    table.focus()
    page.keyboard.press("ArrowRight")
    # Playwright's own waiting needs eval, which the page forbids
    wait_until(lambda: table.evaluate("e => e.scrollLeft") > 0)
    page.context.close()


def test_rows_are_sorted_without_a_script(browser, pages):  # noqa: F811
    """Rows change their places when a radio button is chosen, and no script runs."""
    for width in WIDTHS:
        page, heard, _ = opened(browser, pages["lake"], width, "light")
        box = page.locator("#changes .sortable")
        numbers = """e => [...e.querySelectorAll('tbody tr')]
            .sort((a, b) => a.getBoundingClientRect().top - b.getBoundingClientRect().top)
            .map(r => Number(r.lastElementChild.textContent.replace(',', '')))"""
        before = box.evaluate(numbers)
        box.locator('input[value="2"]').check()
        after = box.evaluate(numbers)
        assert after == sorted(before, reverse=True)
        assert after != before
        assert heard == []
        page.context.close()


def test_tooltips_are_under_the_pointer(browser, pages):  # noqa: F811
    page, _, _ = opened(browser, pages["lake"], 1400, "light")
    told = page.evaluate(
        """() => { const e = document.querySelector('[id^="recorded-tip9"]');
        e.scrollIntoView(); const r = e.getBoundingClientRect();
        const hit = document.elementFromPoint(r.x + r.width / 2, r.y + r.height / 2);
        return [hit.closest('g[id^="recorded-tip"]').querySelector('title').textContent,
                r.width > 10]; }"""
    )
    assert told[1]
    assert told[0].startswith("cell (")
    page.context.close()
