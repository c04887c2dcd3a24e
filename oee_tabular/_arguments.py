"""Parsers of words: ``NAME=SPEC``, ``10,slip=0.3`` and ``MODULE:OBJECT``."""

from __future__ import annotations

import ast
import difflib
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import ModuleType
from typing import Any

from oee_tabular import _checks
from oee_tabular._own_modules import import_own, import_own_environment
from oee_tabular._own_modules import own_modules as own_modules
from oee_tabular.exceptions import ArgumentError

MAX_DIGITS = 4300  # of an integer that Python reads


def whole_number(text: str, name: str) -> int:
    """Read an integer from decimal digits, perhaps with a sign.

    >>> whole_number(" -12", "--initial")
    -12
    """
    digits = text.strip().removeprefix("-")
    # Python reads no more of them
    if not digits.isdecimal() or len(digits) > MAX_DIGITS:
        raise ArgumentError(
            name,
            f"must be an integer of at most {MAX_DIGITS} digits; it is {_checks.show(text)}",
        )
    return int(text)


def is_whole_number(text: str) -> bool:
    """Say whether a text is a sign, or none, and decimal digits."""
    return text.strip().removeprefix("-").isdecimal()


def named_specs(
    given: list[str], option: str = "--policy", known: Sequence[str] = ()
) -> dict[str, str]:
    """Read name -> SPEC from NAME=SPEC, or from SPEC, which is its own name.

    A file whose name has an equals sign is a SPEC, unless it is not clear which is meant.
    Bytes of a name that are no UTF-8 are escaped in the name, and stay in the SPEC.

    Parameters
    ----------
    given : list of str
        The words.
    option : str
        The option that they were given to, for errors.
    known : sequence of str, optional
        The only names allowed; each then needs its value. Empty allows any name.

    Returns
    -------
    dict of str to str
        The specs by name, in the order given.
    """
    specs: dict[str, str] = {}
    for text in given:
        name, equals, spec = text.partition("=")
        if equals and not known and os.path.isfile(text):
            if os.path.isfile(spec):
                raise ArgumentError(
                    option,
                    f"must be clear; {text!r} and {spec!r} are files (write"
                    f" {name}=./{spec}, or NAME={text})",
                )
            name, equals, spec = text, "", ""
        elif equals and not known and _is_in_folder(text) and not _is_in_folder(spec):
            name, equals, spec = text, "", ""  # a file that is not there, named whole
        if known and (not equals or name not in known):
            near = difflib.get_close_matches(name, known, n=1)
            hint = f" (did you mean {near[0]}=VALUE?)" if near else ""
            raise ArgumentError(
                option,
                f"must be NAME=VALUE, NAME one of {', '.join(known)}; got"
                f" {text!r}{hint}",
            )
        if equals and not name:
            raise ArgumentError(
                option, f"must have a name before its '='; got {text!r}"
            )
        # a file's name need not be text, which tables and pages are
        name = name.encode("utf-8", "backslashreplace").decode()
        if name in specs:
            raise ValueError(f"{option} names must differ; {name!r} is given twice")
        specs[name] = spec if equals else text
    return specs


def _is_in_folder(text: str) -> bool:
    """Say whether a text names a place in a folder that is there."""
    folder = os.path.dirname(text)
    return bool(folder) and os.path.isdir(folder)


def parse_spec(spec: str) -> tuple[str, dict[str, Any]]:
    """Split "NAME:key=value,..." into the name and the keywords.

    A value without a key is a ValueError.

    >>> parse_spec("cartpole:gravity=10,form=full")
    ('cartpole', {'gravity': 10, 'form': 'full'})
    """
    name, _, rest = spec.partition(":")
    positional, keywords = arguments(rest)
    if positional:
        raise ValueError(
            f"simulator {spec!r} must give its arguments as key=value; found"
            f" {positional[0]!r}"
        )
    return name, keywords


def arguments(text: str) -> tuple[list[Any], dict[str, Any]]:
    """Split text into positional values and keywords: Python literals or words.

    >>> arguments("10,slip=0.3,pay=next,desc=['SF','FG']")
    ([10], {'slip': 0.3, 'pay': 'next', 'desc': ['SF', 'FG']})
    """
    positional: list[object] = []
    keywords: dict[str, object] = {}
    for part in _split(text):
        key, equals, value = part.partition("=")
        if equals and key.strip().isidentifier():
            if key.strip() in keywords:
                raise ArgumentError(
                    key.strip(), f"must be given once; {text!r} has it twice"
                )
            keywords[key.strip()] = literal(value.strip(), key.strip())
        else:
            positional.append(literal(part.strip()))
    return positional, keywords


def _split(text: str) -> list[str]:
    """Split text at the commas that stand outside brackets and quotes."""
    parts = []
    depth = 0
    quote = ""
    current = ""
    for letter in text:
        if quote:
            quote = "" if letter == quote else quote
        elif letter in "'\"":
            quote = letter
        else:
            depth += (letter in "([{") - (letter in ")]}")
        if letter == "," and depth == 0 and not quote:
            parts.append(current)
            current = ""
        else:
            current += letter
    return [part for part in [*parts, current] if part.strip()]


def literal(text: str, name: str = "an argument") -> Any:
    """Read a Python literal, true, false, none or a fraction, else the word itself."""
    lowered = {"true": True, "false": False, "none": None}
    if text.lower() in lowered:
        return lowered[text.lower()]
    parts = [part.strip() for part in text.split("/", 1)]
    if len(parts) == 2 and all(map(str.isdecimal, parts)):
        top, bottom = (whole_number(part, name) for part in parts)
        if bottom == 0:
            raise ArgumentError(name, f"must be a finite number; {text!r} divides by 0")
        try:
            return top / bottom
        except OverflowError:
            raise ArgumentError(
                name, f"must be a finite number; it is {_checks.show(text)}"
            ) from None
    try:
        return ast.literal_eval(text)
    except (ValueError, SyntaxError, MemoryError, RecursionError):
        return text


def module_and_path(spec: str, what: str, example: str) -> tuple[str, str]:
    """Split "module:object" into its two parts without importing anything."""
    module_name, colon, path = spec.partition(":")
    if not (colon and module_name and path):
        raise ArgumentError(
            what, f"must be given as MODULE:OBJECT, {example}; got {_checks.show(spec)}"
        )
    if module_name.endswith(".py") or os.sep in module_name:
        hint = module_name.removesuffix(".py").replace(os.sep, ".").strip(".")
        raise ArgumentError(
            "MODULE",
            f"must be a module's name, not a file's; got {_checks.show(module_name)}"
            f" (try {hint}:{path})",
        )
    return module_name, path


def own_object(spec: str, what: str, example: str) -> Any:
    """Import the object of "module:object".

    Errors call it ``what`` and give an ``example`` of the form.
    """
    module_name, path = module_and_path(spec, what, example)
    try:
        result: object = own_module(module_name)
    except ValueError as error:
        # the text of an import's failure, without the argument that asked for it
        raise ArgumentError(
            what, f"must name something that can be imported; {error}"
        ) from error.__cause__
    for name in path.split("."):
        if not hasattr(result, name):
            raise ArgumentError(
                what,
                "must name something that its module has;"
                f" {module_name!r} has no object {path!r}{_list_public(result)}",
            )
        result = getattr(result, name)
    return result


def _list_public(holder: object) -> str:
    """Name what an object has to call, as the end of an error."""
    public = [
        key
        for key, value in vars(holder).items()
        if callable(value) and not key.startswith("_")
    ]
    return f" (it has {', '.join(sorted(public)[:8])})" if public else ""


def own_module(module_name: str) -> ModuleType:
    """Import the module of that name; a failure is a ValueError."""
    with _import_errors(module_name):
        return import_own(module_name)


def own_environment(module_name: str, identifier: str) -> None:
    """Import the module that registers this environment; a failure is a ValueError."""
    with _import_errors(module_name):
        import_own_environment(module_name, identifier)


@contextmanager
def _import_errors(module_name: str) -> Iterator[None]:
    """Raise a ValueError in place of what goes wrong while a module is imported."""
    try:
        yield
    except ModuleNotFoundError as error:
        # in other cases the module was found, and imports one that is missing
        if error.name is not None and (
            module_name == error.name or module_name.startswith(f"{error.name}.")
        ):
            raise ValueError(
                f"module {module_name!r} cannot be found, neither in {os.getcwd()} nor"
                " installed"
            ) from None
        raise ValueError(
            f"module {module_name!r} cannot be imported: {type(error).__name__}:"
            f" {error}"
        ) from error
    except (Exception, SystemExit) as error:
        raise ValueError(
            f"module {module_name!r} cannot be imported: {type(error).__name__}:"
            f" {error}"
        ) from error
