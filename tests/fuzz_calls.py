"""Hostile values for every public function: python tests/fuzz_calls.py [--seed 0]
[--calls 20000] [--rooms mdp,exact].

Functions, classes and their public methods are found by inspection; from a call that
works one argument (sometimes two) is replaced. What is wrong: an exception that is not
raised by the package itself or does not name an argument, a message that is long or
holds control characters, a call of more than five seconds of CPU, the death of the
process, a result with nan and without a warning. The calls are made in a child process;
where it dies or hangs another takes its place. ``--only K`` makes the K-th call here,
with its traceback. Exit code 1 where something is wrong.
"""

import argparse
import dataclasses
import inspect
import os
import re
import reprlib
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter

import numpy as np
from fuzz_child import Child
from fuzz_values import hostile, valid_values
from scipy import sparse

import oee_tabular as oee

LIMIT = 5.0  # seconds of CPU of a call
LONGEST = 1500  # characters of a message
OURS = (ValueError, OSError, ImportError, MemoryError)
PACKAGE = os.path.dirname(oee.__file__) + os.sep
# whose arguments have valid values of their own
CHECKED = ("ContinuousTransitions", "Problem", "Transitions")
INNER = {  # methods that the package calls, after its checks: of objects of these rooms
    "tasks": "all",
    "bench": "all",
    "testing": "all",
    "estimators": ("estimate", "fit", "limit_of", "limit_model"),
    "ratio": ("limit",),
}
ALIASES = {  # words of the command line, which the same errors serve
    "identifier": ("environment",),
    "spec": ("environment", "simulator"),
    "policies": ("policy",),
    "logs": ("log",),
    "log_or_counts": ("counts",),
    "policy_a": ("policy_a and policy_b",),
    "log": ("frame",),
    "episodes": ("frame",),
    "matrix": ("count",),
    "tie": ("frame",),
    "name": ("folder", "path"),
    "folder": ("output",),
}
# nan where a row was never recorded, or from one episode
BLANK = ("row_changes", "monte_carlo_value", "spread")


OF_THE_ARM = {"fit_hand", "record_goals", "hand_log", "load_kinova_log", "KinovaHand"}


def is_called(value):
    """Whether people call it: a function, or a class that is not abstract."""
    return inspect.isfunction(value) or (
        inspect.isclass(value)
        and not inspect.isabstract(value)
        and not getattr(value, "_is_protocol", False)
    )


def functions(known, rooms=None):
    """Name -> function, of the public modules, with classes' methods bound to valid
    objects; none is left out.
    """
    modules = {"top": oee} | {
        name: getattr(oee, name)
        for name in oee.__all__
        if inspect.ismodule(getattr(oee, name)) and name != "exceptions"
    }
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
            if key in known["holders"] and INNER.get(room) != "all":
                every |= methods(key, value, known["holders"][key], INNER.get(room, ()))
    return every


def methods(name, kind, holder, inner):
    """Public methods, class methods and static methods, and calls, bound to a valid
    object of the class.
    """
    bound = {}
    for attribute in dir(kind):
        named = attribute[0] != "_" or (
            attribute == "__call__" and not issubclass(kind, type)
        )
        if named and attribute not in inner and callable(getattr(kind, attribute)):
            static = isinstance(
                inspect.getattr_static(kind, attribute), classmethod | staticmethod
            )
            bound[f"{name}.{attribute}"] = getattr(
                kind if static else holder, attribute
            )
    return {key: value for key, value in bound.items() if callable(value)}


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


def refusal(error, values, replaced):
    """The kind of an exception: "refused" where the package raised it, named an
    argument and was short.
    """
    text = f"{type(error).__name__}: {error}"
    if any(callable(values[name]) for name in replaced):
        return "refused", text  # perhaps the hostile function's own
    last = traceback.extract_tb(error.__traceback__)[-1].filename
    if not isinstance(error, OURS) or not (
        last.startswith(PACKAGE) or isinstance(error, OSError | ImportError)
    ):
        return "raw", text
    if len(text) > LONGEST:
        return "long", f"{len(text)} characters: {text}"
    if re.search(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]", text):
        return "control", ascii(text)
    if isinstance(error, OSError | ImportError) or named(str(error), values):
        return "refused", text
    return "nameless", text


WRONG = (
    "nameless",
    "raw",
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
    return name, values, replaced


def attack(pipe, seed, rooms):
    """Make the calls whose numbers are asked for; say what each was, its kind and its
    text.
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
        kind, text = judged(every[name], values, replaced)
        # the first time it may have been compiled
        if time.process_time() - begun > LIMIT:
            begun = time.process_time()
            judged(every[name], values, replaced)
            kind = "slow" if time.process_time() - begun > LIMIT else kind
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


def fuzz(seed, seconds, calls=None, rooms=None, first=0):
    """Counts by kind, and what was wrong: (kind, call, text). The time of the first
    call, which compiles, is not counted.
    """
    child = Child(90.0, attack, seed, rooms)
    counts = Counter()
    wrong = []
    k = first
    end = float("inf")
    while time.monotonic() < end and (calls is None or k < first + calls):
        answer = child.ask(k)
        said, kind, text = (f"[{k}]", answer, "") if isinstance(answer, str) else answer
        end = min(end, time.monotonic() + seconds)
        counts[kind] += 1
        if kind in WRONG:
            wrong.append((kind, said, text))
        k += 1
    child.end()
    return counts, wrong


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=float("inf"))
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
    counts, wrong = fuzz(given.seed, given.seconds, given.calls, given.rooms)
    for kind, said, text in wrong:
        print(f"{kind:9}{said}\n         {text[:240]}")
    print(f"{sum(counts.values())} calls: {dict(counts)}")
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
