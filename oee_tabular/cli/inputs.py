"""Simulators, policies, problems and bounds from the words and files of a command.

Simulators are those of ``tasks.named_task``, or the user's own, MODULE:OBJECT or
MODULE:ENV-ID.
"""

from __future__ import annotations

import difflib
import re
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

import oee_tabular as oee  # whose rooms are imported on use
from oee_tabular import _checks, _files, _progress
from oee_tabular._arguments import (
    arguments,
    is_whole_number,
    literal,
    named_specs,
    own_environment,
    own_modules,
    own_object,
    whole_number,
)
from oee_tabular.cli.options import remark
from oee_tabular.exceptions import ArgumentError, DataWarning
from oee_tabular.typing import Array


def task_of(
    spec: str,
    discount: float | None = None,
    initial: str | None = None,
    samples: int | None = None,
) -> oee.tasks.NamedTask:
    """Make the task that ``spec`` names.

    Parameters
    ----------
    spec : str
        A simulator as the command takes it.
    discount : float, optional
        Replaces the task's discount. None keeps it (0.99 for an own environment).
    initial : str, optional
        First state by name or number. None keeps the task's first states.
    samples : int, optional
        Number of samples of each state-action pair, for an environment that is stepped
        because it has no table.

    Returns
    -------
    NamedTask
        The FiniteMDP and how to make its expert and environment.
    """
    from oee_tabular.cli.simulators import refuse_table

    refuse_table(spec)
    _progress.report_step(f"reading the simulator {spec}")
    if samples is not None:
        _checks.positive_integer(samples, "samples_per_pair")
    is_mdp = Path(spec).suffix.lower() in oee.tasks.MDP_ENDINGS
    is_file = is_mdp and Path(spec).is_file()
    if samples is not None and (is_file or not is_own(spec)):
        _require_stepped(spec, samples, is_file=is_file)
    if (is_own(spec) and not is_file) or samples is not None:
        with own_modules():
            make = _maker(spec)
            made = make()
            mdp = _as_mdp(made, spec, 0.99 if discount is None else discount, samples)
        if discount is not None and made is mdp:
            mdp = mdp.with_discount(discount)
        stepped = None if isinstance(made, oee.FiniteMDP) else make
        task = oee.tasks.NamedTask(spec, mdp, lambda: oee.optimal_policy(mdp), stepped)
    else:
        task = oee.tasks.named_task(spec, discount=discount)
    if initial is None:
        return task
    # no name reads as a number
    is_number = is_whole_number(initial)
    start = whole_number(initial, "--initial") if is_number else initial
    return replace(task, mdp=task.mdp.with_initial(start))


def _require_stepped(spec: str, samples: int, *, is_file: bool) -> None:
    """Refuse a number of samples for what is no environment that can be stepped."""
    from oee_tabular.continuous import is_continuous
    from oee_tabular.tasks import FINITE

    if is_continuous(spec):
        what = "a continuous task, whose cells are sampled by themselves"
    elif is_file or spec.partition(":")[0] in FINITE:
        what = "whose probabilities are known"
    else:
        return
    _refuse_samples(spec, samples, what)


def _refuse_samples(spec: str, samples: int, what: str) -> NoReturn:
    """Raise the ArgumentError for a number of samples that is not used."""
    raise ArgumentError(
        "samples_per_pair",
        f"must be left out for {spec!r}, {what} (it is for an environment that is"
        f" stepped); it is {samples}",
    )


def has_default_discount(
    spec: str, discount: float | None, task: oee.tasks.NamedTask | None
) -> bool:
    """Say whether nobody chose a simulator's discount.

    A table has none (``task`` is None), and neither has an environment; saved MDPs and
    tasks of the package have their own.
    """
    if discount is not None or "discount=" in spec.replace(" ", ""):
        return False
    if task is None:
        return True
    return task.environment is not None or task.continuous is not None


def describe_default_discount(value: float) -> str:
    """Say that a discount is the default."""
    return f"discount {value:g} (the default; --discount sets it)"


def tell_default_discount(
    spec: str, discount: float | None, task: oee.tasks.NamedTask
) -> None:
    """Have it said on stderr which discount a simulator gets that has none."""
    if has_default_discount(spec, discount, task):
        remark(describe_default_discount(task.mdp.discount))


def is_own(spec: str) -> bool:
    """Return whether ``spec`` is MODULE:OBJECT or MODULE:ENV-ID.

    Both sides of the colon are words, and the first one is the name of a module.
    """
    from oee_tabular.tasks import FINITE

    module, colon, rest = spec.partition(":")
    if (
        not colon
        or module in FINITE
        or not all(part.isidentifier() for part in module.split("."))
    ):
        return False
    from oee_tabular.continuous import CONTINUOUS

    first = rest.split(",")[0]
    return (
        module not in CONTINUOUS
        and bool(first)
        and "=" not in first
        and isinstance(arguments(first)[0][0], str)
    )


def _maker(spec: str) -> Callable[[], Any]:
    """Return a function that makes the user's MDP or environment.

    ``spec`` is "module:Object,key=value", "module:Id-v0,key=value" or
    "Id-v0:key=value".
    """
    module, _, rest = spec.partition(":")
    positional, keywords = arguments(rest)
    if not is_own(spec):
        return partial(oee.tasks.make_environment, module, **keywords)
    name, *positional = positional
    if not all(part.isidentifier() for part in name.split(".")):
        own_environment(module, name)  # importing it registers the environment
        return partial(oee.tasks.make_environment, name, **keywords)
    made = own_object(
        f"{module}:{name}", "the simulator", "my_package.mine:MySimulator"
    )

    def make() -> Any:
        """Call the user's class or function; an object is returned as it is."""
        try:
            return made(*positional, **keywords) if callable(made) else made
        except Exception as error:
            raise ValueError(
                f"simulator {spec!r} cannot be made; it raises {type(error).__name__}:"
                f" {error}"
            ) from error

    return make


def _as_mdp(
    made: Any, spec: str, discount: float, samples: int | None
) -> oee.FiniteMDP:
    """Make a FiniteMDP of an environment, from its table or by stepping it."""
    if isinstance(made, oee.FiniteMDP):
        if samples is not None:
            _refuse_samples(spec, samples, "whose probabilities are known")
        return made
    if isinstance(made, oee.tasks.ContinuousTask):
        raise ValueError(
            f"simulator {spec!r} is a ContinuousTask, which Python takes:"
            " report.evaluate_continuous(task, log, policies, horizon=...); a command"
            " takes a registered MODULE:EnvId-v0"
        )
    space = getattr(made, "observation_space", None)
    if space is not None and not hasattr(space, "n") and getattr(space, "shape", None):
        raise ValueError(
            f"simulator {spec!r} has states that are vectors: register the environment"
            " (gymnasium.register) and name it by its id,"
            f" {spec.partition(':')[0]}:EnvId-v0"
        )
    if not hasattr(made, "step") or not hasattr(made, "reset"):
        raise ValueError(
            f"simulator {spec!r} must be a FiniteMDP or a Gymnasium environment, or a"
            f" class or function that makes one; found {type(made).__name__}"
        )
    if samples is not None:
        return oee.FiniteMDP.from_env(
            made, samples_per_pair=samples, seed=0, discount=discount
        )
    if not hasattr(getattr(made, "unwrapped", made), "P"):
        raise ValueError(
            f"simulator {spec!r} has no table P, so that it can only be sampled: oee"
            f" export {spec} --samples-per-pair 100 --output simulator.npz writes it by"
            " its frequencies"
        )
    return oee.FiniteMDP.from_gymnasium(made, discount)


def read_named_policies(given: list[str] | None) -> dict[str, str]:
    """Read the SPECs of policies by their names; without any, the optimal one."""
    return named_specs(given or ["optimal"])


def policies_of(specs: Mapping[str, str], task: oee.tasks.NamedTask) -> dict[str, Any]:
    """Read the policies that the SPECs name, as (S, A) arrays."""
    return {name: policy_of(spec, task, "--policy") for name, spec in specs.items()}


def read_columns(given: list[str] | None, log: list[str] | None) -> dict[str, Any]:
    """Read what ``--column`` says: a log's column and its label in the files.

    Parameters
    ----------
    given : list of str, optional
        The values of the option, COLUMN=LABEL.
    log : list of str, optional
        The files of the log, of which the first one has the labels.

    Returns
    -------
    dict
        The labels by column, several as a tuple, None where the label is empty.
    """
    columns: dict[str, Any] = {}
    for text in given or ():
        column, equals, label = text.partition("=")
        if not equals or not column:
            raise ArgumentError(
                "--column",
                f"must be COLUMN=LABEL, as state=pose_before; got {text!r}",
            )
        if column in columns:
            raise ArgumentError("--column", f"must name {column} once; it does twice")
        columns[column] = _split_label(column, label, log or []) if label else None
    return columns


def _split_label(column: str, label: str, log: list[str]) -> Any:
    """Return a label, or several that commas part, of which the file has none whole."""
    if "," not in label:
        return label
    from oee_tabular.data.files import find_log_files
    from oee_tabular.data.tables import read_labels

    parts = tuple(label.split(","))
    first = find_log_files(log)[0]
    known = read_labels(first.path) if first.suffix in (".csv", ".parquet") else []
    if label not in known:
        return parts
    if set(parts) <= set(known):
        raise ArgumentError(
            "--column",
            f"must be clear; for {column}, {first.path!r} has the column {label!r}, and"
            f" each of {', '.join(map(repr, parts))} as well (rename one of them)",
        )
    return label


def _count_log_files(log: list[str], recorded: Any) -> int:
    """Return how many files hold a log, by its names; of counts, how many did."""
    from oee_tabular.data.files import find_log_files

    if isinstance(recorded, oee.TransitionCounts):
        return recorded.recording.files
    return len(find_log_files(log))


def policy_of(spec: str, task: oee.tasks.NamedTask, name: str) -> Array:
    """Read the policy that ``spec`` names, as an (S, A) array."""
    from oee_tabular.cli.policies import read_policy_table
    from oee_tabular.mdp import check_policy, read_policy_array

    _progress.report_step(f"reading the policy {spec}")
    mdp = task.mdp
    suffix = Path(spec).suffix.lower()
    if spec in ("uniform", "optimal"):
        return oee.uniform_policy(mdp) if spec == "uniform" else oee.optimal_policy(mdp)
    if spec == "expert":
        return check_policy(task.expert(), mdp)
    if spec.startswith("mix:") and suffix not in (".csv", ".npy", ".npz"):
        try:
            weight = float(spec.removeprefix("mix:"))
        except ValueError:
            raise ArgumentError(name, f"must be like mix:0.5; got {spec!r}") from None
        if not 0.0 <= weight <= 1.0:
            raise ArgumentError(
                name, f"must be mix:WEIGHT with a weight in [0, 1]; got {spec!r}"
            )
        return oee.mix(
            check_policy(task.expert(), mdp), oee.uniform_policy(mdp), weight
        )
    label = f"{name} {spec!r}"
    if suffix == ".csv":
        return check_policy(read_policy_table(spec, mdp), mdp, name=label)
    if suffix in (".npy", ".npz"):
        return check_policy(read_policy_array(spec, name), mdp, name=label)
    if is_own(spec):
        with own_modules():
            return check_policy(
                own_object(spec, name, "my_package.mine:policy"), mdp, name=label
            )
    known = ["uniform", "optimal", "expert", "mix:0.5"]
    close = difflib.get_close_matches(spec.lower(), known, n=1)
    hint = f" (did you mean {close[0]!r}?)" if close else ""
    raise ArgumentError(
        name,
        "must be uniform, optimal, expert, mix:WEIGHT, MODULE:FUNCTION, or a .npy, .npz"
        f" or .csv file; got {spec!r}{hint}",
    )


def read_problem(
    simulator: str,
    log: list[str],
    *,
    discount: float | None,
    initial: str | None,
    action_noise: float,
    impossible: str,
    horizon: int | None,
    rewards: Any = "simulator",
    behavior: str | None = None,
    column: list[str] | None = None,
    trials: str | None = None,
    success: list[str] | None = None,
) -> tuple[oee.tasks.NamedTask, oee.Problem, list[str], int]:
    """Read the simulator and the problem with the log's files.

    Parameters
    ----------
    simulator : str
        A simulator as the command takes it.
    log : list of str
        The files of one log.
    discount, initial, action_noise, impossible, horizon, rewards, behavior, column
        The values of the options with these names.
    trials : str, optional
        Successes of trials, or their file.
    success : list of str, optional
        The states whose entering is success.

    Returns
    -------
    task : NamedTask
        The simulator with its discount, first state and action noise.
    problem : Problem
        The simulator, with the log's support where ``impossible`` is allow=EPS, and the
        log.
    notes : list of str
        What the log's reader warned of: rows that count twice, columns that are left
        out, labels that are read as others.
    n_files : int
        The number of files that hold the log.
    """
    task = task_of(simulator, discount, initial)
    if not success:  # whose discount is 1
        tell_default_discount(simulator, discount, task)
    if action_noise:
        task = replace(task, mdp=task.mdp.with_action_noise(action_noise))
    if success:
        task = replace(task, mdp=read_success(success, task.mdp, discount, rewards))
    tried = None if trials is None else read_trials(trials)
    model = task.mdp
    epsilon = _read_impossible(impossible)
    _progress.report_step(f"reading the log {', '.join(log)}")
    with note_warnings() as notes:
        recorded = oee.data.read_log(
            log[0] if len(log) == 1 else log, model, columns=read_columns(column, log)
        )
    if success:
        recorded = _without_rewards(recorded)
    must_refuse: Any = impossible
    if epsilon is not None:
        shape = (model.n_states, model.n_actions)
        if isinstance(recorded, oee.Transitions):
            model = model.with_support_of(recorded, epsilon)
        else:
            model = model.with_support_of(recorded.counts(*shape), epsilon)
        must_refuse = "refuse"
    more: dict[str, Any] = {"rewards": rewards}
    if behavior is not None:
        more["behavior_policy"] = policy_of(behavior, task, "--behavior")
    problem = oee.Problem(
        model,
        recorded,
        horizon=horizon,
        impossible=must_refuse,
        trials=tried,
        **more,
    )
    return task, problem, notes, _count_log_files(log, recorded)


@contextmanager
def note_warnings() -> Iterator[list[str]]:
    """Give a list that gets each warning about data, which is shown as well."""
    notes: list[str] = []
    show = warnings.showwarning

    def note(
        message: Warning | str, category: type[Warning], *rest: Any, **more: Any
    ) -> None:
        """Keep a warning about data once, and show it."""
        if issubclass(category, DataWarning) and str(message) not in notes:
            notes.append(str(message))
        show(message, category, *rest, **more)

    with warnings.catch_warnings():
        warnings.showwarning = note
        yield notes


def _without_rewards(recorded: Any) -> Any:
    """Return a log without rewards, which are of another value than success."""
    if isinstance(recorded, oee.Transitions):
        return replace(recorded, reward=None)
    sums = ("reward_sum", "reward_min", "reward_max", "reward_count")
    return replace(
        recorded,
        sample=None
        if recorded.sample is None
        else replace(recorded.sample, reward=None),
        **dict.fromkeys(sums),
    )


def read_success(
    states: list[str], mdp: oee.FiniteMDP, discount: float | None, rewards: str
) -> oee.FiniteMDP:
    """Make the simulator whose value is the probability to enter one of the states."""
    if discount not in (None, 1.0):
        raise ArgumentError(
            "--discount",
            f"must be 1 or left out with --success; it is {discount:g}",
        )
    if rewards != "simulator":
        raise ArgumentError(
            "--rewards",
            f"must be simulator with --success, which sets them; it is {rewards}",
        )
    named: list[Any] = [
        whole_number(text, "--success") if is_whole_number(text) else text
        for text in states
    ]
    return oee.data.success_simulator(mdp, named)


MAX_COUNT_CHARACTERS = 20  # of 9/12, both counts together


def read_trials(text: str) -> oee.Trials:
    """Read SUCCESSES/TRIALS, or a file of trials."""
    if re.fullmatch(r"\d+/\d+", text):
        if Path(text).exists():
            raise ArgumentError(
                "--trials",
                f"must be clear: {text!r} are counts, and a file has this name (for the"
                f" file: --trials ./{text})",
            )
        if len(text) > MAX_COUNT_CHARACTERS:
            raise ArgumentError("--trials", f"must be smaller numbers; got {text[:40]}")
        successes, number = (int(part) for part in text.split("/"))
        if number == 0 or successes > number:
            raise ArgumentError(
                "--trials",
                f"must be SUCCESSES/TRIALS with at most as many successes; got {text}",
            )
        return oee.Trials.from_successes(successes, number)
    if Path(text).suffix.lower() in (".csv", ".json"):
        _progress.report_step(f"reading the trials {text}")
        return oee.Trials.load(text)
    raise ArgumentError(
        "--trials",
        f"must be SUCCESSES/TRIALS, as 9/12, or a .csv or .json file; got {text!r}",
    )


def _read_impossible(text: str) -> float | None:
    """Return EPS of allow=EPS, None for refuse and drop; refuse other words."""
    if text in ("refuse", "drop"):
        return None
    if text.startswith("allow="):
        epsilon = literal(text.removeprefix("allow="), "--impossible")
        if isinstance(epsilon, float) and 0.0 < epsilon < 1.0:
            return epsilon
    raise ArgumentError(
        "--impossible",
        "must be refuse, drop, or allow=EPS with 0 < EPS < 1, allow=0.01; got"
        f" {text!r}",
    )


def read_box(text: str | None) -> dict[str, float | None]:
    """Read the bounds of --box LOWER,UPPER; one that is left out is None."""
    if text is None:
        return {}
    try:
        lower, upper = (
            float(part) if part.strip() else None for part in text.split(",")
        )
    except ValueError:
        lower = upper = float("nan")
    low = 0.0 if lower is None else lower
    high = 1.0 if upper is None else upper
    # a comparison with nan is false
    if not 0.0 <= low <= 1.0 <= high:
        raise ArgumentError(
            "--box",
            "must be LOWER,UPPER, bounds on P_target / P with 0 <= LOWER <= 1 <="
            f" UPPER, as 0.5,2; got {text!r}",
        )
    return {"lower_ratio": lower, "upper_ratio": upper}


def read_entries(path: Path, name: str, simulator: oee.FiniteMDP) -> tuple[Any, str]:
    """Read features, or keys of a tie, of the simulator's transitions.

    A .csv has one transition in each row: columns state, action, next_state (numbers,
    or the simulator's names), and one column for each feature (0 in transitions that
    are not in the file) or one of keys. A .npy has shape (entries,) or (S, A, S);
    features may have one more axis. A dense array may hold anything where P is 0.

    Parameters
    ----------
    path : Path
        The file.
    name : {"features", "tie"}
        What the file holds; errors begin with the option of this name.
    simulator : FiniteMDP
        The simulator, whose transitions the file describes.

    Returns
    -------
    values : ndarray of shape (entries, K) or (entries,)
        The features, or the keys, in the order of ``simulator.transitions.data``.
    content : str
        What the values are, for the report.
    """
    from oee_tabular.data.frames import eager
    from oee_tabular.data.tables import csv_frame
    from oee_tabular.mdp import Rows
    from oee_tabular.ratio.features import features_of
    from oee_tabular.ratio.ties import keys_of

    is_table = path.suffix.lower() == ".csv"
    file = repr(str(path))
    if not is_table and path.suffix.lower() != ".npy":
        raise ArgumentError(f"--{name}", f"must be a .npy or .csv file; got {file}")
    given = eager(csv_frame(str(path))) if is_table else _files.read_array(path)
    try:
        if name == "tie":
            keys = keys_of(given, Rows.of(simulator), simulator)
            return keys, f"{keys.max() + 1} keys"
        values, labels = features_of(given, simulator)
    except ValueError as error:
        raise ValueError(f"--{name} {file}: {error}") from error
    return values, ", ".join(labels)
