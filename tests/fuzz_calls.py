"""Hostile values for every public function: python tests/fuzz_calls.py [--seed 0] [--seconds 60] [--show].

Functions are found by inspection of the public modules; from a call that works one argument (sometimes two) is replaced.
What is wrong: an exception that is neither ValueError nor TypeError with the argument's name nor documented, a call of more
than ten seconds, a death of the process, a result with nan and without a word. The calls are made in a child process, which
says what it is about to do; where it dies or hangs another takes its place. Exit code 1 where something is wrong.
"""

import argparse
import dataclasses
import inspect
import multiprocessing
import re
import sys
import time
import warnings
from collections import Counter

import numpy as np
from fuzz_values import hostile, own_values, valid_values
from scipy import sparse

import oee_tabular as oee

LIMIT = 10.0  # seconds of a call
DOCUMENTED = (FileNotFoundError, ImportError)
METHODS = {
    "FiniteMDP": ("with_action_noise", "with_discount", "with_layout", "with_rewards", "with_transitions"),
    "Transitions": ("counts", "draw", "first", "select"),
    "TransitionRatio": ("log_standard_error", "maximum_likelihood_model", "on", "one_step", "target_model"),
    "Problem": ("rewards_of",),
}
CALLED = (
    "DoublyRobust",
    "DualDice",
    "ImportanceSampling",
    "Magic",
    "Marginalized",
    "ModelBased",
    "OffEnvironment",
    "Simulator",
)
ALIASES = {  # words of the command line, which the same errors serve
    "identifier": ("environment",),
    "spec": ("environment", "simulator"),
    "policies": ("policy",),
    "log_or_counts": ("counts",),
}
LEFT_OUT = [
    "Method",
    "SgdTrace",
    "Basis",
    "Estimate",
    "Finding",
    "Interval",
    "Moments",
    "Plan",
    "RatioFit",
    "Report",
    "TransitionRatio",
    "LinearSolution",
    "ReweightedModel",
    "Comparison",
    "Contest",
    "corrected_value",
    "EstimationCounterexample",
    "Outlook",
    "RowChanges",
    "Selection",
    "Sides",
    "SimulationLemma",
    "Families",
    "League",
    "Assumptions",
    "SampleRatio",
    "Result",
    "SampledReturns",
    "ArmCells",
    "Closure",
    "Discretization",
    "KinovaHand",
    "MonteCarlo",
    "Moves",
    "NamedTask",
    "Case",
    "Verdict",
    "Verdicts",
    "Family",
    "Estimator",
    "Model",
    "ContinuousTask",
    "StatePolicy",
    "arm_cells",
    "train_expert",
    "fit_hand",
    "kinova_model",
    "check_estimator",
    "run",
    "league_of",
    "families",
    "garnet_worse",
    "evaluate_continuous",
    "record_goals",
    "hand_log",
    "reacher_log",
    "visited_states",
    "defensive_mixture",
    "logs",
    "mdp_pairs",
    "mdps",
    "policies",
    "horizons",
    "padded_log",
    "relabelled_log",
    "load_kinova_log",
    "make_environment",
    "check_output",
    "check_page",
    "Settings",
    "GymnasiumTask",
    "gymnasium_simulator",
    "ContinuousSimulator",
    "LinearReacher",
    "VisitedCells",
    "GridInterpolation",
    "gaussian",
    "DEFAULT",
    "LAWS",
    "tandem",
]


def functions(known):
    """Name -> function, of every public module but plots, with methods bound to valid objects."""
    found = {}
    parts = (getattr(oee, name) for name in oee.__all__ if name != "plots")
    for module in (oee, *filter(inspect.ismodule, parts)):
        for name in module.__all__:
            if callable(getattr(module, name)) and name not in LEFT_OUT:
                found[name] = getattr(module, name)
    holders = {
        "FiniteMDP": known["mdp"],
        "Transitions": known["log"],
        "TransitionRatio": oee.transition_ratio(known["log"], known["simulator"]),
        "Problem": known["problem"],
    }
    for name in ("Conditional", "InClass", "Joint", "Quotient", "Tied"):
        found[name] = fitted(getattr(oee.ratio, name), known)
    for holder, names in METHODS.items():
        found |= {f"{holder}.{name}": getattr(holders[holder], name) for name in names}
    found |= {f"{name}.__call__": getattr(oee.estimators, name)() for name in CALLED}
    found |= {f"{name}.limit": getattr(oee.estimators, name)().limit for name in CALLED}
    return found


def fitted(method, known):
    """A method's options, and its fit: what they are wrong for may show there alone."""

    def fit(**options):
        return method(**options).fit(known["log"], known["simulator"], seed=0)

    fit.__signature__ = inspect.signature(method)
    return fit


def arguments_of(name, function, known):
    """The arguments of a valid call, by name."""
    own = own_values(known).get(name, {})
    values = {}
    for parameter in inspect.signature(function).parameters.values():
        if parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD) or parameter.name.startswith("_"):
            continue
        if parameter.name in own:
            values[parameter.name] = own[parameter.name]
        elif parameter.default is not parameter.empty and parameter.name not in ("horizon", "seed"):
            values[parameter.name] = parameter.default
        else:
            values[parameter.name] = known[parameter.name]
    return values


def call(function, values):
    """The call, positional-only parameters in their place."""
    kinds = inspect.signature(function).parameters
    positional = [values[n] for n, p in kinds.items() if p.kind is p.POSITIONAL_ONLY and n in values]
    return function(
        *positional, **{n: v for n, v in values.items() if kinds[n].kind is not inspect.Parameter.POSITIONAL_ONLY}
    )


def has_nan(value, depth=0):
    """Whether a number of a result is nan."""
    if isinstance(value, float | np.floating):
        return bool(np.isnan(value))
    if sparse.issparse(value):
        return has_nan(value.data)
    if isinstance(value, np.ndarray):
        return value.dtype.kind == "f" and bool(np.isnan(value).any())
    if isinstance(value, tuple | list):
        return any(has_nan(part, depth + 1) for part in value)
    if dataclasses.is_dataclass(value) and depth < 2:
        names = [
            f.name for f in dataclasses.fields(value) if f.name not in ("diagnostics", "details") and f.name[0] != "_"
        ]
        return getattr(value, "status", "ok") == "ok" and any(
            has_nan(getattr(value, name), depth + 1) for name in names
        )
    return False


def named(message, arguments):
    """Whether a message names an argument: of two that do not fit it may be the other one.

    ``name`` says what it is called, where a function has that.
    """
    if isinstance(arguments.get("name"), str) and message.startswith(arguments["name"]):
        return True
    words = [word for name in arguments for word in (name, *name.split("_or_"), *ALIASES.get(name, ()))]
    return any(re.search(rf"(?<![a-z]){word}s?(?![a-z])|{word.replace('_', ' ')}", message) for word in words)


def judged(function, values, replaced):
    """The kind of outcome, and what is to be shown of it."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        try:
            result = call(function, values)
        except (ValueError, TypeError) as error:
            if any(callable(values[name]) for name in replaced):
                return "refused", str(error)  # perhaps the hostile function's own
            return ("refused" if named(str(error), values) else "nameless"), f"{type(error).__name__}: {error}"
        except DOCUMENTED as error:
            return "refused", str(error)
        except Exception as error:
            return "raw", f"{type(error).__name__}: {error}"
    blank = ("RowChanges", "MonteCarlo")  # nan where a row was never recorded, or from one episode, as they say
    silent = type(result).__name__ not in blank
    if silent and has_nan(result) and not any(issubclass(w.category, UserWarning) for w in said):
        return "nan", repr(result)
    return "accepted", ""


WRONG = ("nameless", "raw", "nan", "slow", "hang", "death", "invalid")


def attack(pipe, seed, start):
    """Calls, one after the other, told before and after; the k-th depends on the seed and k alone."""
    known = valid_values()
    every = functions(known)
    names = sorted(every)
    calls = {name: arguments_of(name, every[name], known) for name in names}
    k = start
    while True:
        rng = np.random.default_rng((seed, k))
        name = names[k % len(names)]
        values = dict(calls[name])
        replaced = list(rng.permutation(sorted(values))[: 2 if rng.random() < 0.1 else 1]) if k >= len(names) else []
        for argument in replaced:
            values[argument] = hostile(rng, values[argument])
        shown = f"{name}({', '.join(f'{a}={values[a]!r:.80}' for a in replaced)})".replace("\n", " ")
        pipe.send(("begun", k, shown))
        begun = time.monotonic()
        kind, text = judged(every[name], values, replaced)
        if time.monotonic() - begun > LIMIT:  # the first time it may have been compiled
            begun = time.monotonic()
            judged(every[name], values, replaced)
            kind = "slow" if time.monotonic() - begun > LIMIT else kind
        if not replaced and kind != "accepted":
            kind = "invalid"
        pipe.send(("done", kind, text))
        k += 1


def fuzz(seed, seconds, calls=None):
    """Counts by kind, and what was wrong: (kind, call, text)."""
    context = multiprocessing.get_context("spawn")
    counts, wrong, k, end = Counter(), [], 0, float("inf")
    child = pipe = None
    lost = 0  # children that died before a call
    while time.monotonic() < end and (calls is None or k < calls):
        if child is None:
            pipe, other = context.Pipe()
            child = context.Process(target=attack, args=(other, seed, k), daemon=True)
            child.start()
            other.close()
        shown, kind, text = "", "death", ""
        try:
            if not pipe.poll(120):
                kind = "hang"
                raise EOFError
            _, k, shown = pipe.recv()
            lost = 0
            end = min(end, time.monotonic() + seconds)  # imports are not counted
            if not pipe.poll(90):
                kind = "hang"
                raise EOFError
            _, kind, text = pipe.recv()
        except (EOFError, ConnectionError):
            child.kill()
            child.join()
            child, lost = None, lost + (not shown)
            if lost == 3:
                raise RuntimeError("three processes died before their first call") from None
        counts[kind] += 1
        if kind in WRONG:
            wrong.append((kind, shown, text))
        k += 1
    if child is not None:
        child.kill()
        child.join()
    return counts, wrong


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--calls", type=int, default=None)
    options = parser.parse_args()
    counts, wrong = fuzz(options.seed, options.seconds, options.calls)
    for kind, shown, text in wrong:
        print(f"{kind:9}{shown}\n         {text[:240]}")
    print(f"{sum(counts.values())} calls: {dict(counts)}")
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
