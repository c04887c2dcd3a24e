"""Hostile values for every public function: python tests/fuzz_calls.py [--seed 0]
[--calls 20000] [--rooms mdp,exact].

Functions, classes, their public methods and operators (``==``, ``in``, ``[]``) are found
by inspection; from a call that works one argument (sometimes two) is replaced. What is
wrong: an exception that is not raised by the package itself or does not name an
argument, a message that is long or holds control characters, a call of more than five
seconds of CPU, the death of the process, a result with nan and without a warning. A
result that a constructor accepts is used: its texts, ``==``, hash, copies, pickles,
properties and methods without arguments; what raises there is "later". The calls are
made in a child process; where it dies or hangs another takes its place. ``--only K``
makes the K-th call here, with its traceback. Exit code 1 where something is wrong.
"""

import argparse
import contextlib
import copy
import dataclasses
import functools
import inspect
import operator
import os
import pickle
import re
import reprlib
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from pathlib import Path

import numpy as np
from fuzz_child import Child, allow
from fuzz_values import Spite, SpiteOfText, hostile, valid_values
from scipy import sparse

import oee_tabular as oee

LIMIT = 5.0  # seconds of CPU of a call
LONGEST = 1500  # characters of a message
OURS = (ValueError, OSError, ImportError, MemoryError)
# these name a file, a package or a solver and its remedy in place of an argument
OTHER_NAMES = (OSError, ImportError, oee.exceptions.SolverStatusError)
PACKAGE = os.path.dirname(oee.__file__) + os.sep
# whose arguments have valid values of their own
CHECKED = ("ContinuousTransitions", "Problem", "Transitions")
# methods that the package calls, after its checks: of objects of these rooms
INNER = {
    "tasks": (
        *(name for name in vars(oee.tasks.ContinuousTask) if name[0] != "_"),
        *("advance", "beyond", "command", "costs", "distance", "log", "one_by_one"),
        *("own", "places", "play", "policy", "read", "resampled", "tamed", "towards"),
        *("GymnasiumTask.record", "GymnasiumTask.with_environment"),
        "Discretization.displacement_ties",  # has no argument
    ),
    "estimators": (
        *("estimate", "fit", "limit_of", "limit_model"),
        # which always refuse
        *("clear", "pop", "popitem", "setdefault", "update"),
    ),
    "ratio": ("limit", "Method.fit", "fit_rows"),
    "report": ("ContinuousSimulator.policy",),  # of words of the command line
    "shrinkage": ("fit_rows", "move"),
}
# calls of objects that a task makes for each of its steps, after its checks
STEPS = ("cartpole_policy", "kinova_policy", "reacher_policy")
# the paper's formulas, which say themselves that they check nothing
UNCHECKED = ("paper", "typing")
ALIASES = {  # words of the command line, which the same errors serve
    "identifier": ("environment",),
    "spec": ("environment", "simulator", "path"),
    "policies": ("policy",),
    "logs": ("log",),
    "log_or_counts": ("counts",),
    "policy_a": ("policy_a and policy_b",),
    "log": ("frame",),
    "episodes": ("frame",),
    "matrix": ("count",),
    "tie": ("frame",),
    "name": ("folder", "path"),
    "facts": ("diagnostics",),
    "cells": ("shape",),  # of a grid
    "more": ("diagnostics",),
    "folder": ("output",),
}
# nan where a row was never recorded, or from one episode
BLANK = ("row_changes", "monte_carlo_value", "spread")


# which make as many steps in a continuous task as are asked for
STEPPED = {"train_expert", "corrected_value"}
OF_THE_ARM = {"fit_hand", "record_goals", "hand_log", "load_kinova_log", "KinovaHand"}


def is_called(value):
    """Whether people call it: a function, or a class that is not abstract, nor an error
    that has Python's constructor.
    """
    return inspect.isfunction(value) or (
        inspect.isclass(value)
        and not inspect.isabstract(value)
        and not getattr(value, "_is_protocol", False)
        and not (issubclass(value, Exception) and not from_package(value, "__init__"))
    )


def rooms_of_package():
    """Name -> public module, the package itself first."""
    return {"top": oee} | {
        name: getattr(oee, name)
        for name in oee.__all__
        if inspect.ismodule(getattr(oee, name)) and name not in UNCHECKED
    }


def functions(known, rooms=None):
    """Name -> function, of the public modules, with classes' methods bound to valid
    objects; none is left out.
    """
    modules = rooms_of_package()
    every = {}
    for room in rooms or modules:
        for name in filter(
            lambda name: is_called(getattr(modules[room], name)), modules[room].__all__
        ):
            if name in OF_THE_ARM - {*known["own"]}:
                continue  # without MuJoCo
            value = getattr(modules[room], name)
            # two classes of one name
            key = name if every.get(name, value) is value else f"{room}.{name}"
            every[key] = value
            if inspect.isclass(value):
                holder = known["holders"].get(key)
                if holder is None:
                    holder = call(value, arguments_of(key, value, known))
                inner = INNER.get(room, ())
                every |= methods(key, value, holder, inner) | operators(key, holder)
    return every


def methods(name, kind, holder, inner):
    """Public methods, class methods and static methods, and calls, bound to a valid
    object of the class.
    """
    bound = {}
    for attribute in dir(kind):
        # of errors and dicts those of Python are left out
        if not from_package(kind, attribute):
            continue
        named = attribute[0] != "_" or (
            attribute == "__call__" and not issubclass(kind, type) and name not in STEPS
        )
        if {attribute, f"{name}.{attribute}"} & {*inner}:
            continue
        if named and callable(getattr(kind, attribute)):
            static = isinstance(
                inspect.getattr_static(kind, attribute), classmethod | staticmethod
            )
            bound[f"{name}.{attribute}"] = getattr(
                kind if static else holder, attribute
            )
    return {key: value for key, value in bound.items() if callable(value)}


def from_package(kind, attribute):
    """Whether a class of the package defines the attribute, or a function of it does."""
    owner = next(c for c in kind.__mro__ if attribute in vars(c))
    return owner.__module__.startswith("oee_tabular")


def operators(name, holder):
    """``==`` with a valid object, and ``in`` and ``[]`` where there are."""
    bound = {f"{name}.__eq__": lambda operand: holder.__eq__(operand)}
    for attribute, function in (
        ("__contains__", operator.contains),
        ("__getitem__", operator.getitem),
    ):
        kind = type(holder)
        if hasattr(kind, attribute) and from_package(kind, attribute):
            bound[f"{name}.{attribute}"] = functools.partial(at, function, holder)
    return bound


def at(function, holder, operand):
    """The item, or whether there is one; keys that are none are Python's errors."""
    with contextlib.suppress(KeyError, IndexError):
        try:
            return function(holder, operand)
        except TypeError as error:
            if "unhashable" not in str(error):  # no key, which Python says
                raise
    return None


def arguments_of(name, function, known):
    """The arguments of a valid call, by name."""
    own = known["own"].get(name, {})
    values = (
        dict(own)
        if any(
            p.kind is p.VAR_KEYWORD
            for p in inspect.signature(function).parameters.values()
        )
        else {}
    )
    container = (
        dataclasses.is_dataclass(function)
        and inspect.isclass(function)
        and name in known["holders"]
    )
    if container and name not in CHECKED:
        own = {
            f.name: getattr(known["holders"][name], f.name)
            for f in dataclasses.fields(function)
        } | own
    for parameter in inspect.signature(function).parameters.values():
        if parameter.kind in (
            parameter.VAR_POSITIONAL,
            parameter.VAR_KEYWORD,
        ) or parameter.name.startswith("_"):
            continue
        if parameter.name in own:
            values[parameter.name] = own[parameter.name]
        elif parameter.default is not parameter.empty and parameter.name not in (
            "horizon",
            "seed",
        ):
            values[parameter.name] = parameter.default
        else:
            values[parameter.name] = known[parameter.name]
    return values


def call(function, values):
    """The call, positional-only parameters in their place."""
    kinds = inspect.signature(function).parameters
    positional = [
        values[n]
        for n, p in kinds.items()
        if p.kind is p.POSITIONAL_ONLY and n in values
    ]
    first = [n for n, p in kinds.items() if p.kind is p.POSITIONAL_ONLY]
    return function(*positional, **{n: v for n, v in values.items() if n not in first})


def has_nan(value, depth=0):
    """Whether a number of a result is nan."""
    if isinstance(value, float | np.floating):
        return bool(np.isnan(value))
    if sparse.issparse(value):
        return has_nan(value.data)
    if isinstance(value, np.ndarray):
        return value.dtype.kind == "f" and bool(np.isnan(value).any())
    if isinstance(value, tuple | list) and depth < 20:
        return any(has_nan(part, depth + 1) for part in value)
    if dataclasses.is_dataclass(value) and depth < 2:
        names = [
            f.name
            for f in dataclasses.fields(value)
            if f.name not in ("diagnostics", "details") and f.name[0] != "_"
        ]
        return getattr(value, "status", "ok") == "ok" and any(
            has_nan(getattr(value, name), depth + 1) for name in names
        )
    return False


def named(message, arguments):
    """Whether a message names an argument: of two that do not fit it may be the other
    one.

    ``name`` says what it is called, where a function has that.
    """
    if isinstance(arguments.get("name"), str) and message.startswith(arguments["name"]):
        return True
    words = [
        word
        for name in arguments
        for word in (name, *name.split("_or_"), *ALIASES.get(name, ()))
    ]
    return any(
        re.search(rf"(?<![a-z]){word}s?(?![a-z])|{word.replace('_', ' ')}", message)
        for word in words
    )


def judged(function, values, replaced):
    """The kind of outcome, and what is to be shown of it."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            result = call(function, values)
        except Exception as error:
            return refusal(error, values, replaced)
        if replaced and inspect.isclass(function):
            text = used(result)
            if text:
                return "later", text
    silent = not (
        inspect.isclass(function) or getattr(function, "__name__", "") in BLANK
    )  # a class keeps what it is given
    if (
        silent
        and has_nan(result)
        and not any(issubclass(w.category, UserWarning) for w in caught)
    ):
        return "nan", reprlib.repr(result)
    return "accepted", ""


def used(result):
    """What raises where an object is used that a constructor accepted; "" if nothing."""
    kind = type(result)
    for what, use in USES.items():
        try:
            use(result)
        except (Spite, copy.Error, pickle.PicklingError, RecursionError):
            continue  # of what it holds
        except Exception as error:
            # an object that it holds cannot be hashed or copied, which Python says
            if what in ("hash", "copy", "pickle") and isinstance(
                error, TypeError | AttributeError | NotImplementedError
            ):
                continue
            return f"{what}: {type(error).__name__}: {error}"
    skipped = {*SKIPPED, *INNER["estimators"], *INNER["tasks"]}
    for name in dir(kind):
        if name[0] == "_" or not from_package(kind, name) or name in skipped:
            continue
        static = inspect.getattr_static(kind, name)
        try:
            if isinstance(static, property | functools.cached_property):
                getattr(result, name)
            elif inspect.isfunction(static) and not any(
                p.default is p.empty and p.kind is not p.VAR_KEYWORD
                for p in list(inspect.signature(static).parameters.values())[1:]
            ):
                getattr(result, name)()
        except Spite:
            continue
        except Exception as error:
            if isinstance(error, OURS) and raised_here(error):
                continue
            return f"{name}: {type(error).__name__}: {error}"
    return ""


USES = {
    "repr": repr,
    "str": str,
    "html": lambda result: getattr(type(result), "_repr_html_", repr)(result),
    "==": lambda result: bool(result == copy.copy(result)),
    "hash": hash,
    "copy": copy.copy,
    "pickle": lambda result: pickle.loads(pickle.dumps(result)),
}
# methods without arguments that show pictures or take long
SKIPPED = ("plot", "discretize", "closure_error", "mix")


def raised_here(error):
    """Whether the package raised an error itself."""
    last = traceback.extract_tb(error.__traceback__)[-1].filename
    return last.startswith(PACKAGE)


def refusal(error, values, replaced):
    """The kind of an exception: "refused" where the package raised it, named an
    argument and was short.
    """
    text = f"{type(error).__name__}: {error}"
    if isinstance(error, SpiteOfText):
        return "raw", text
    if isinstance(error, Spite) or any(callable(values[name]) for name in replaced):
        return "refused", text  # perhaps the hostile object's own
    if not isinstance(error, OURS + OTHER_NAMES) or not (
        raised_here(error) or isinstance(error, OTHER_NAMES)
    ):
        return "raw", text
    if len(text) > LONGEST:
        return "long", f"{len(text)} characters: {text}"
    if re.search(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]", text):
        return "control", ascii(text)
    files = [values[name] for name in replaced if isinstance(values[name], Path)]
    # a file is called by its name, and so is one in a folder
    if any(str(error).startswith(repr(str(path))[:-1]) for path in files):
        return "refused", text
    if isinstance(error, OTHER_NAMES) or named(str(error), values):
        return "refused", text
    return "nameless", text


WRONG = (
    "nameless",
    "raw",
    "later",
    "long",
    "control",
    "nan",
    "slow",
    "hang",
    "death",
    "invalid",
)


def make_call(seed, k, every, calls):
    """The k-th call, which depends on the seed and k alone: its function, its
    arguments, and which of them are hostile.
    """
    rng = np.random.default_rng((seed, k))
    names = sorted(every)
    name = names[k % len(names)]
    values = dict(calls[name])
    replaced = (
        list(rng.permutation(sorted(values))[: 2 if rng.random() < 0.1 else 1])
        if k >= len(names)
        else []
    )
    for argument in replaced:
        values[argument] = hostile(rng, values[argument])
        # the physics runs for as many steps as are asked for
        if name in OF_THE_ARM | STEPPED and isinstance(values[argument], int):
            values[argument] = min(values[argument], 3)
    return name, values, replaced


def attack(pipe, seed, rooms, limit):
    """Make the calls whose numbers are asked for; say what each was, its kind and its
    text.

    limit : seconds of CPU of a call; 0 for any
    """
    os.chdir(tempfile.mkdtemp())
    known = valid_values()
    every = functions(known, rooms)
    calls = {
        name: arguments_of(name, function, known) for name, function in every.items()
    }
    while True:
        name, values, replaced = make_call(seed, k := pipe.recv(), every, calls)
        begun = time.process_time()
        allow(limit)
        kind, text = judged(every[name], values, replaced)
        # the first time it may have been compiled
        if time.process_time() - begun > LIMIT:
            begun = time.process_time()
            judged(every[name], values, replaced)
            kind = "slow" if time.process_time() - begun > LIMIT else kind
        allow(0)
        if not replaced and kind != "accepted":
            kind = "invalid"
        pipe.send(
            (
                f"[{k}] {name}({', '.join(f'{a}={shown(values[a])}' for a in replaced)})",
                kind,
                text,
            )
        )


def shown(value):
    """A short text of anything."""
    try:
        return (
            ascii(reprlib.repr(value).replace("\n", " ")[:120])[1:-1]
            if np.size(value) < 200
            else type(value).__name__
        )
    except Exception:
        return type(value).__name__


def fuzz(seed, calls, rooms=None, first=0, limit=60.0, found=None):
    """Counts by kind, and what was wrong: (kind, call, text), which ``found`` is told.

    limit : seconds of CPU for a call; 0 waits
    """
    child = Child(None, attack, seed, rooms, limit)
    counts = Counter()
    wrong = []
    for k in range(first, first + calls):
        answer = child.ask(k)
        said, kind, text = (f"[{k}]", answer, "") if isinstance(answer, str) else answer
        counts[kind] += 1
        if kind in WRONG:
            wrong.append((kind, said, text))
            if found is not None:
                found(*wrong[-1])
    child.end()
    return counts, wrong


def tell(kind, said, text):
    """Print what was wrong."""
    print(f"{kind:9}{said}\n         {text[:240]}", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--calls", type=int, default=20_000)
    parser.add_argument("--rooms", type=lambda text: text.split(","), default=None)
    parser.add_argument("--only", type=int)
    given = parser.parse_args()
    if given.only is not None:
        known = valid_values()
        every = functions(known, given.rooms)
        calls = {
            name: arguments_of(name, function, known)
            for name, function in every.items()
        }
        name, values, replaced = make_call(given.seed, given.only, every, calls)
        print(
            name,
            {argument: type(values[argument]) for argument in replaced},
            flush=True,
        )
        print(shown(call(every[name], values)))
        return 0
    counts, wrong = fuzz(given.seed, given.calls, given.rooms, found=tell)
    print(f"{sum(counts.values())} calls: {dict(counts)}")
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
