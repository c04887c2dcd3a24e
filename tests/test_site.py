"""The site: every public name by subject, every attribute under its own name, every command and option."""

import dataclasses
import importlib
import inspect
import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def site():
    """The modules that make the site's pages."""
    sys.path.insert(0, str(ROOT / "notebooks"))
    made = {name: importlib.import_module(name) for name in ("docstrings", "subjects")}
    yield made
    sys.path.remove(str(ROOT / "notebooks"))
    for name in made:
        sys.modules.pop(name, None)


def test_every_public_name_is_listed_once_by_subject(site):
    subjects = site["subjects"]
    for module, headings in subjects.SUBJECTS.items():
        names = [name for group in headings.values() for name in group]
        assert len(names) == len(set(names)), module
        assert set(names) >= subjects.public(module), module
        loaded = importlib.import_module(f"oee_tabular.{module}")
        assert all(hasattr(loaded, name) for name in names), module


def shown(site, value):
    """A class's docstring as the site sets it: the fields that napoleon makes of it."""
    napoleon = pytest.importorskip("sphinx.ext.napoleon")
    lines = site["docstrings"].plain(inspect.cleandoc(value.__doc__).splitlines())
    config = napoleon.Config(napoleon_use_ivar=True, napoleon_use_param=False)
    return str(napoleon.NumpyDocstring("\n".join(lines), config, what="class", obj=value, name=value.__name__))


def test_every_attribute_has_an_entry_of_its_own(site):
    checked = 0
    for module, headings in site["subjects"].SUBJECTS.items():
        loaded = importlib.import_module(f"oee_tabular.{module}")
        for name in (name for group in headings.values() for name in group):
            value = getattr(loaded, name)
            if not (inspect.isclass(value) and dataclasses.is_dataclass(value)) or "Attributes\n" not in value.__doc__:
                continue
            text = shown(site, value)
            own = {field.name for field in dataclasses.fields(value) if not field.name.startswith("_")}
            inherited = {field for base in value.__mro__[1:] for field in getattr(base, "__dataclass_fields__", ())}
            told = value.__doc__.split("Attributes\n")[1]
            for field in own - inherited:
                if re.search(rf"\b{field}\b", told):
                    assert f":ivar {field}:" in text or f"**{field}**" in text, (name, field)
                    checked += 1
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
    for module in ("conf", "docstrings", "subjects", "dependencies"):
        sys.modules.pop(module, None)
