"""Every public name is explained: by a sentence, its parameters' names, and an example,
which the suite runs.
"""

import dataclasses
import doctest
import importlib
import inspect
import re
from collections import Counter

import pytest

import oee_tabular

PARTS = (
    "mdp",
    "data",
    "exact",
    "simulate",
    "tasks",
    "ratio",
    "estimators",
    "theory",
    "inference",
    "design",
    "testing",
    "report",
    "plots",
    "lab.bench",
)
HEADING = re.compile(r"^(\w[\w ]*)\n-{3,}$", re.MULTILINE)
ENTRY = re.compile(r"^(\*{0,2}\w+(?:, \*{0,2}\w+)*)(?: :|$)", re.MULTILINE)


def public():
    """(module.name, value) of every public function and class, once."""
    seen = set()
    for module in PARTS:
        loaded = importlib.import_module(f"oee_tabular.{module}")
        names = getattr(loaded, "__all__", None) or [
            name
            for name in oee_tabular.__all__
            if getattr(getattr(oee_tabular, name), "__module__", "")
            == f"oee_tabular.{module}"
        ]
        for name in sorted(names):
            value = getattr(loaded, name)
            if (inspect.isclass(value) or inspect.isroutine(value)) and id(
                value
            ) not in seen:
                seen.add(id(value))
                yield f"{module}.{name}", value


PUBLIC = dict(public())


def sections(value):
    """Heading -> text of a docstring's sections; "" has what stands before the first."""
    # its own docstring, none that it inherits
    parts = HEADING.split(inspect.cleandoc(value.__doc__ or ""))
    return {"": parts[0].strip(), **dict(zip(parts[1::2], parts[2::2], strict=True))}


def names_in(section):
    """The names that a section explains: at the beginning of a line that is not
    indented, alone or before a colon.
    """
    return [
        name.lstrip("*")
        for group in ENTRY.findall(section)
        for name in group.split(", ")
    ]


def unexplained(value, found):
    """Parameters, or fields of a dataclass, that its docstring does not name, and those
    that it names too many.
    """
    if inspect.isclass(value) and "Parameters" not in found:
        if not dataclasses.is_dataclass(value):
            return set()
        inherited = {
            name
            for base in value.__mro__[1:]
            for name in getattr(base, "__dataclass_fields__", ())
        }
        fields = {
            field.name
            for field in dataclasses.fields(value)
            if not field.name.startswith("_")
        }
        return fields - inherited - set(names_in(found.get("Attributes", "")))
    wanted = [
        name for name in inspect.signature(value).parameters if not name.startswith("_")
    ]
    given = Counter(names_in(found.get("Parameters", "")))
    return set(given - Counter(wanted)) | set(Counter(wanted) - given)


def lacks(value):
    """What a docstring lacks: kind -> words."""
    found = sections(value)
    lack = {}
    first = found[""].split("\n\n")[0]
    if not first.endswith("."):
        lack["sentence"] = f"its first line must be a sentence; it is {first!r}"
    if ">>>" not in found.get("Examples", ""):
        lack["example"] = "it must have an example (>>>) in a section Examples"
    if wrong := unexplained(value, found):
        lack["parameters"] = (
            "each parameter (field) must be explained, once, and nothing else; not so"
            f" {sorted(wrong)}"
        )
    return lack


@pytest.mark.parametrize("name", sorted(PUBLIC))
def test_public_names_are_explained(name):
    lack = lacks(PUBLIC[name])
    assert not lack, f"{name}: {'; '.join(lack.values())}"


def test_the_suite_collects_the_examples(request):
    """pytest is told to look for them in the package, and its finder sees those of
    every public name, module by module.
    """
    assert "--doctest-modules" in request.config.getini("addopts")
    assert "oee_tabular" in request.config.getini("testpaths")
    expected = {}
    for value in PUBLIC.values():
        expected.setdefault(value.__module__, set()).add(
            f"{value.__module__}.{value.__qualname__}"
        )
    for module, names in expected.items():
        found = doctest.DocTestFinder(exclude_empty=True).find(
            importlib.import_module(module), module
        )
        collected = {test.name for test in found if test.examples}
        assert names <= collected, f"{module}: {sorted(names - collected)}"


@pytest.mark.parametrize(
    ("old", "new", "kind"),
    [
        ("Merge two policies.", "Merge two policies", "sentence"),
        (">>> ", "", "example"),
        ("policy_a, ", "", "parameters"),
        ("policy_a, ", "policy_a, policy_a, ", "parameters"),
        ("weight_of_a :", "weight :", "parameters"),
    ],
)
def test_the_check_sees_what_is_missing(old, new, kind):
    def mix(policy_a, policy_b, weight_of_a):
        pass

    text = inspect.cleandoc(PUBLIC["mdp.mix"].__doc__)
    text = text.replace(text.partition("\n\n")[0], "Merge two policies.")
    assert old in text
    mix.__doc__ = text.replace(old, new)
    assert lacks(mix).keys() == {kind}
