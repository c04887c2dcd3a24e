"""The benchmark's page says what its saved results hold."""

import benchmark_page
import pytest


@pytest.fixture(scope="module")
def page():
    """Return the page with its lines joined."""
    return " ".join(benchmark_page.PAGE.read_text(encoding="utf-8").split())


@pytest.mark.parametrize("line", benchmark_page.all_lines())
def test_the_page_has_the_saved_numbers(page, line):
    assert " ".join(line.split()) in page
