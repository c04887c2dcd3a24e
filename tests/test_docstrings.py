"""The docstrings of public names are numpydoc's: every parameter with its type and a
description, Returns, one line of summary.

What the site shows is checked (notebooks/subjects.py): functions, classes, and their
public methods and properties. Of numpydoc's rules PR (parameters), RT (returns), SS
(summary) and YD (yields) are asked. Frozen results, which users do not make, describe
their fields under Attributes in place of Parameters.
"""

import importlib
import inspect
import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
RULES = ("PR", "RT", "SS", "YD")
# a page to read beside the paper: a line is a formula and an arrow
EXEMPT = {"paper"}


@pytest.fixture(scope="module")
def subjects():
    sys.path.insert(0, str(ROOT / "notebooks"))
    yield importlib.import_module("subjects").SUBJECTS
    sys.path.remove(str(ROOT / "notebooks"))
    sys.modules.pop("subjects", None)


def documented(subjects):
    """Path -> object of every public name of the package, with the members of classes."""
    found = {}
    for module, headings in subjects.items():
        if module in EXEMPT:
            continue
        loaded = importlib.import_module(f"oee_tabular.{module}")
        for name in (name for group in headings.values() for name in group):
            value = getattr(loaded, name)
            if not (inspect.isclass(value) or inspect.isroutine(value)):
                continue
            if not value.__module__.startswith("oee_tabular"):
                continue
            path = f"{value.__module__}.{value.__qualname__}"
            found[path] = value
            if inspect.isclass(value):
                found |= members(path, value)
    return found


def members(path, kind):
    """The public methods and properties that a class defines."""
    found = {}
    for name, value in vars(kind).items():
        function = getattr(value, "__func__", value)
        if name.startswith("_") or getattr(function, "__name__", "").startswith("_"):
            continue
        if inspect.isfunction(function) or isinstance(function, property):
            found[f"{path}.{name}"] = function
    return found


def findings(path, value):
    """What numpydoc finds, of the rules that are asked."""
    validate = pytest.importorskip("numpydoc.validate").validate
    is_result = inspect.isclass(value) and "\nAttributes\n" in inspect.cleandoc(
        value.__doc__ or ""
    )
    # a protocol takes what a call gives it
    has_own_parameters = not is_result and not getattr(value, "_is_protocol", False)
    found = []
    for code, text in validate(path)["errors"]:
        is_private = re.fullmatch(r"Parameters \{('_\w+'(, )?)+\} not documented", text)
        if code == "PR01" and (is_private or not has_own_parameters):
            continue
        if code.startswith(RULES):
            found.append(f"{path}: {code} {text}")
    return found


@pytest.mark.filterwarnings("ignore")
def test_public_docstrings_are_numpydoc(subjects):
    public = documented(subjects)
    assert len(public) > 400
    missing = [path for path, value in public.items() if not value.__doc__]
    assert missing == []
    found = []
    for path, value in public.items():
        found += findings(path, value)
    assert found == []


def test_the_check_sees_what_is_missing():
    class Numbers:
        def first(self, count):
            """Return the first numbers

            Parameters
            ----------
            number : int
            """
            return count

    module = sys.modules[__name__]
    module.Numbers = Numbers
    Numbers.__qualname__ = "Numbers"
    Numbers.first.__qualname__ = "Numbers.first"
    try:
        found = findings(f"{__name__}.Numbers.first", Numbers.first)
    finally:
        del module.Numbers
    codes = {text.split()[1] for text in found}
    assert {"SS03", "PR01", "PR02", "PR07", "RT01"} <= codes
