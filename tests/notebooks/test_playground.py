"""The playground: its saved results are those of today's code, and the page shows them,
by mouse, keyboard and to a screen reader.
"""

import importlib
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from browsing import axe, browser, opened, violations  # noqa: F401, fixtures
from helpers import wait_until

import oee_tabular as oee

NOTEBOOKS = Path(__file__).parents[2] / "notebooks"
RESULTS = NOTEBOOKS / "static" / "playground_results.js"
PAGE = (NOTEBOOKS / "playground.md").read_text()
MAX_BYTES = 1_000_000
SLIDERS = ("simulator", "target", "transitions", "policy")
SCHEMES = ("light", "dark")
BUTTONS = ("walk", "step", "again", "redraw", "all")
ROUNDING = 1.01e-4  # saved numbers have four decimals


@pytest.fixture(scope="module")
def playground():
    """The module that computes the results."""
    sys.path.insert(0, str(NOTEBOOKS))
    yield importlib.import_module("playground")
    sys.path.remove(str(NOTEBOOKS))
    sys.modules.pop("playground", None)


@pytest.fixture(scope="module")
def results(playground):
    return playground.read_results(RESULTS)


# ---- the file of results


def test_the_file_is_small_and_whole(playground, results):
    assert RESULTS.stat().st_size < MAX_BYTES
    logs = np.array(results["logs"])
    axes = [len(results[name]) for name in ("slips", "slips", "counts", "shares")]
    assert logs.shape == (*axes, playground.N_LOGS, 3)
    assert np.isfinite(logs).all()
    assert (logs[..., 1] <= logs[..., 0]).all()
    assert (logs[..., 0] <= logs[..., 2]).all()
    assert logs[..., 2].max() <= 0  # no reward is above 0
    assert results["confidence"] == 0.95  # as the page's label has it


@pytest.mark.parametrize("cell", [(3, 1, 1, 0), (0, 3, 0, 7), (0, 0, 3, 19)])
def test_a_cell_is_what_the_code_computes(playground, results, cell):
    """One at each end of the simulator's slip, which at 0 needs a remedy."""
    i, j, k, seed = cell
    made = playground.evaluate_log(
        results["slips"][i], results["slips"][j], results["counts"][k], seed
    )
    saved = np.array(results["logs"])[i, j, k, :, seed]
    np.testing.assert_allclose(made, saved, rtol=0, atol=ROUNDING)


def test_the_true_values_are_exact(playground, results):
    np.testing.assert_allclose(
        playground.exact_values(), results["values"], rtol=0, atol=ROUNDING
    )


def test_a_smaller_log_is_the_beginning(playground):
    few, many = (playground.draw_log(0.1, count, seed=3) for count in (300, 1000))
    for name in ("state", "action", "next_state", "reward"):
        np.testing.assert_array_equal(getattr(few, name), getattr(many, name)[:300])


def test_without_its_remedy_slip_0_is_refused(playground):
    log = playground.draw_log(0.3, 300, seed=0)
    with pytest.raises(
        oee.exceptions.ArgumentError, match=r"\(1\) .*with_action_noise"
    ):
        oee.Problem(playground.grid(0.0), log)


def test_the_page_says_what_is_saved(playground, results):
    page = " ".join(PAGE.split()).replace("−", "-")
    found = playground.covered(results)
    logs = np.array(results["logs"])
    values = np.array(results["values"])
    by_count = found.mean(axis=(0, 1, 3, 4))
    by_log = found.mean(axis=(0, 2, 3))  # which settings share
    error = by_log.std(ddof=1) / np.sqrt(by_log.size)
    widths = (logs[3, 1, :, 1, :, 2] - logs[3, 1, :, 1, :, 1]).mean(axis=1)
    errors = abs(logs[:, 1, 1, 1, :, 0] - values[1, 1]).mean(axis=1)
    own_width = (logs[1, 1, 1, 1, :, 2] - logs[1, 1, 1, 1, :, 1]).mean()
    sentences = [
        f"{found.sum()} of {found.size} intervals cover ({found.mean():.1%}), with a"
        f" standard error of {error:.1%}",
        *(
            f"| {count} | {share:.1%} |"
            for count, share in zip(
                ("300", "1000", "3000", "10 000"), by_count, strict=True
            )
        ),
        f"The simulator says {values[3, 1]:.2f}, the truth is {values[1, 1]:.2f}",
        "{:.1f} wide on average with 300 transitions, then {:.1f}, {:.1f} and"
        " {:.1f}".format(*widths),
        f"falls from {errors[3]:.2f} to {errors[1]:.2f}. The intervals stay"
        f" {own_width:.1f} wide",
        f"the value is {values[0, 0]:.1f} in every grid",
        f"The fewest of a setting are {found.sum(axis=-1).min()}",
        f"with_action_noise({playground.ACTION_NOISE})",
        f"gridworld({playground.SIZE}, slip)",
        f"from {playground.N_EPISODES} episodes",
    ]
    assert [sentence for sentence in sentences if sentence not in page] == []
    assert np.ptp(values[:, 0]) == 0
    assert f"{widths[1]:.1f}" == f"{own_width:.1f}"
    (command,) = re.findall(r"^    (PYTHONPATH.*)$", PAGE, re.M)
    assert command in playground.__doc__


def test_the_command_writes_what_it_computes(playground, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(playground, "SLIPS", (0.0, 0.3))
    monkeypatch.setattr(playground, "COUNTS", (300,))
    monkeypatch.setattr(playground, "N_LOGS", 1)
    output = tmp_path / "results.js"
    playground.main(["--output", str(output)])
    made = playground.read_results(output)
    assert np.shape(made["logs"]) == (2, 2, 1, 3, 1, 3)
    assert (
        f"{playground.covered(made).sum()} of 12 intervals" in capsys.readouterr().out
    )


@pytest.mark.parametrize(
    ("name", "error", "message"),
    [
        ("there.js", ValueError, "--output must be a new file"),
        ("results.json", ValueError, r"--output must end in \.js"),
        ("nowhere/results.js", FileNotFoundError, "no such folder"),
    ],
)
def test_the_command_refuses_before_it_computes(
    playground, monkeypatch, tmp_path, name, error, message
):
    monkeypatch.setattr(playground, "compute", lambda: pytest.fail("it ran"))
    (tmp_path / "there.js").write_text("mine")
    with pytest.raises(error, match=message):
        playground.main(["--output", str(tmp_path / name)])
    assert [path.name for path in tmp_path.iterdir()] == ["there.js"]
    assert (tmp_path / "there.js").read_text() == "mine"


# ---- the page in a browser; test_built_site.py has it in the theme


@pytest.fixture(scope="module")
def addresses(tmp_path_factory):
    """The page's own part with the theme's colours, outside of the site."""
    theme = Path(pytest.importorskip("pydata_sphinx_theme").__file__).parent
    style = next(theme.rglob("pydata-sphinx-theme.css"))
    folder = tmp_path_factory.mktemp("playground")
    (folder / "_static").symlink_to(NOTEBOOKS / "static")
    body = re.search(r"^```\{raw\} html\n(.*?)^```", PAGE, re.M | re.S)[1]
    for scheme in SCHEMES:
        (folder / f"{scheme}.html").write_text(
            f'<!doctype html><html lang="en" data-theme="{scheme}"><meta charset="utf-8">'
            '<title>Playground</title><meta name="viewport" content="width=device-width">'
            f'<link rel="stylesheet" href="{style.as_uri()}">'
            f"<main><h1>Playground</h1>{body}</main></html>"
        )
    return {scheme: (folder / f"{scheme}.html").as_uri() for scheme in SCHEMES}


@pytest.fixture
def page(browser, addresses):  # noqa: F811
    page, heard, asked = opened(browser, addresses["light"], 1280, "light")
    yield page
    assert heard == []
    assert [url for url in asked if not url.startswith("file:")] == []
    page.context.close()


def texts(page):
    """Name -> what stands there."""
    names = ("log", "believed", "value", "interval", "truth", "covers", "count")
    return page.evaluate(
        "names => Object.fromEntries(names.map(name =>"
        " [name, document.querySelector(`#play-${name}`).textContent]))",
        names,
    )


def number(text):
    return float(text.replace("−", "-"))


def move(page, **places):
    """Move sliders, as a mouse would."""
    page.evaluate(
        """places => { for (const [name, place] of Object.entries(places)) {
            const slider = document.querySelector(`#play-${name}`);
            slider.value = place; slider.dispatchEvent(new Event("input")); } }""",
        places,
    )


def half_unit(text):
    """Half a unit of a number's last digit, and the rounding of what is saved."""
    return 0.5 * 10.0 ** -len(text.partition(".")[2]) + ROUNDING


def test_every_setting_shows_its_results(page, results):
    """All places of all sliders, the ends among them."""
    values, logs = np.array(results["values"]), np.array(results["logs"])
    for place in np.ndindex(logs.shape[:4]):
        i, j, _, policy = place
        move(page, **dict(zip(SLIDERS, place, strict=True)))
        shown = texts(page)
        ends = shown["interval"].split(" to ")
        pairs = [
            (shown["believed"], values[i, policy]),
            (shown["truth"], values[j, policy]),
            *zip((shown["value"], *ends), logs[place][0], strict=True),
        ]
        for text, value in pairs:
            assert abs(number(text) - value) <= half_unit(text), (place, shown)
        assert shown["log"] == f"Log 1 of {logs.shape[4]}"


def test_redrawing_counts_what_covers(page, playground, results):
    place = (3, 1, 0, 0)
    move(page, **dict(zip(SLIDERS, place, strict=True)))
    found = playground.covered(results)[place]
    assert not found.all()  # or the test would not see a miss
    for k in range(len(found)):
        shown = texts(page)
        assert shown["log"].startswith(f"Log {k + 1} of")
        assert ("covers" in shown["covers"]) == found[k]
        if k + 1 < len(found):
            assert shown["count"] == f"So far {found[: k + 1].sum()} of {k + 1} cover."
        assert (
            page.locator("#play-intervals .play-misses").count()
            == (~found[: k + 1]).sum()
        )
        page.locator("#play-redraw").click()
    all_drawn = f"All {len(found)} logs are drawn: {found.sum()} intervals cover."
    assert texts(page)["count"] == all_drawn
    assert texts(page)["log"].startswith("Log 1 of")  # and round again
    move(page, target=2)
    assert "of 1 cover" in texts(page)["count"]
    move(page, target=1)
    page.locator("#play-all").click()
    assert texts(page)["count"] == all_drawn


def test_it_is_used_by_keyboard(page):
    reached = []
    for _ in (*SLIDERS, *BUTTONS):
        page.keyboard.press("Tab")
        identity, width = page.evaluate(
            """() => { const e = document.activeElement, s = getComputedStyle(e);
            return [e.id, s.outlineStyle === "none" ? 0 : parseFloat(s.outlineWidth)]; }"""
        )
        assert width >= 2, identity
        reached.append(identity)
    assert reached == [f"play-{name}" for name in (*SLIDERS, *BUTTONS)]
    page.keyboard.press("Enter")
    assert texts(page)["count"].startswith("All ")
    slider = page.locator("#play-simulator")
    slider.focus()
    page.keyboard.press("Home")
    assert slider.get_attribute("aria-valuetext") == "0%"
    assert page.locator("#play-simulator-text").inner_text() == "0%"
    page.keyboard.press("ArrowRight")
    assert slider.get_attribute("aria-valuetext") == "10%"
    page.keyboard.press("End")
    page.keyboard.press("ArrowRight")  # there is nothing beyond the end
    assert slider.get_attribute("aria-valuetext") == "30%"


def test_a_screen_reader_hears_the_numbers(page):
    for name in SLIDERS:
        label = page.locator(f'label[for="play-{name}"]')
        assert label.count() == 1
        assert page.locator(f"#play-{name}").get_attribute("aria-valuetext")
    live = page.locator('[aria-live="polite"]')
    assert live.get_attribute("aria-atomic") == "true"
    for name in ("value", "interval", "truth", "count"):
        assert live.locator(f"#play-{name}").count() == 1
    page.locator("#play-walk").click()
    said = page.locator("#play-walks").inner_text()
    assert re.fullmatch(r"simulator: .*Return: .*\. target: .*Return: .*", said)
    for picture in page.locator("svg[role=img]").all():
        assert re.search(r"\d", picture.get_attribute("aria-label"))


def test_nothing_moves_for_who_asks_for_that(page):
    page.locator("#play-walk").click()
    assert page.locator("#play-walk").inner_text() == "Walk"
    for name in ("simulator", "target"):
        assert "after" in page.locator(f"#play-{name}-walk").inner_text()
    style = "getComputedStyle(document.querySelector('.play-robot')).transitionDuration"
    assert page.evaluate(style) == "0s"


def test_robots_walk_and_wait(page):
    page.emulate_media(reduced_motion="no-preference")
    walk, text = page.locator("#play-walk"), page.locator("#play-simulator-walk")
    move(page, policy=0)  # a long way
    assert text.inner_text() == "Step 0"
    walk.click()
    assert walk.inner_text() == "Pause"
    wait_until(lambda: text.inner_text() not in ("Step 0", "Step 1"))
    walk.click()
    assert walk.inner_text() == "Walk"
    here = text.inner_text()
    page.wait_for_timeout(1000)
    assert text.inner_text() == here
    page.locator("#play-step").click()
    assert text.inner_text() == f"Step {int(here.split()[1]) + 1}"
    page.locator("#play-again").click()
    assert text.inner_text() == "Step 0"


def test_equal_slips_walk_alike(page):
    move(page, simulator=2, target=2, policy=1)
    for _ in range(5):
        page.locator("#play-again").click()
        page.locator("#play-walk").click()
        first, second = (
            page.locator(f"#play-{name}-walk").inner_text()
            for name in ("simulator", "target")
        )
        assert first == second


@pytest.mark.parametrize(("slip", "share"), [(0, 1), (0.3, 1), (0.1, 0.5), (0.2, 0)])
def test_robots_walk_as_the_package_s_grid(page, playground, slip, share):
    """The mean return of many walks is the exact value."""
    returns = np.array(
        page.evaluate(
            """([slip, share]) => Array.from({length: 4000}, (_, seed) =>
            playground.walk(window.playgroundResults, slip, share, seed, 1e6).value)""",
            [slip, share],
        )
    )
    policy = oee.tasks.gridworld_policy(playground.SIZE, share)
    value = oee.policy_value(playground.grid(slip), policy)
    error = returns.std() / np.sqrt(len(returns))
    assert abs(returns.mean() - value) <= 4 * error + 1e-9


@pytest.mark.parametrize("scheme", SCHEMES)
def test_it_fits_a_telephone(browser, axe, addresses, scheme):  # noqa: F811
    page, heard, _ = opened(browser, addresses[scheme], 400, scheme, bypass_csp=True)
    page.locator("#play-all").click()
    for width in (400, 320):
        page.set_viewport_size({"width": width, "height": 900})
        assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert heard == []  # axe itself asks for what a file may not
    assert violations(axe, page) == []
    page.context.close()


def test_missing_results_are_said(browser, addresses):  # noqa: F811
    context = browser.new_context()
    context.route("**/playground_results.js", lambda route: route.abort())
    page = context.new_page()
    page.goto(addresses["light"])
    assert "playground_results.js" in page.locator("#playground").inner_text()
    context.close()
