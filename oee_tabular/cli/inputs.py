"""What the command's words mean: logs and problems from specifications and files."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from oee_tabular.cli.simulators import policies_of, policy_of, task_of
from oee_tabular.estimators.names import names

if TYPE_CHECKING:
    from oee_tabular._checks import Array
    from oee_tabular.data import TransitionCounts, Transitions
    from oee_tabular.estimators import Problem
    from oee_tabular.mdp import FiniteMDP
    from oee_tabular.report import Report
    from oee_tabular.tasks import NamedTask

_ENTRIES = (
    "file of the simulator's transitions, .csv (columns state, action, next_state, by number or name, ...) or .npy (S, A, S) "
    "or (entries,)"
)
FEATURES_HELP = f"Your own features of moves, as a row oee-features: {_ENTRIES}, with a last axis for several."
TIE_HELP = f"Integer keys, moves with one key share one ratio, as a row oee-tied: {_ENTRIES}."
ESTIMATORS_HELP = f"{', '.join(names())}; with --target: {', '.join(names(needs_target=True))}; fqe is model-based"


def write_array(path: Path, array: Array) -> None:
    """A .npy file, which appears whole or not at all."""
    import numpy as np

    from oee_tabular import _files

    with _files.whole_file(path, (".npy",)) as handle:
        np.save(handle, array, allow_pickle=False)


def refuse_settings(simulator: str | None, settings: dict[str, Any]) -> None:
    """An error where options of continuous tasks are given without one; before that, for a simulator that is not there."""
    if settings:
        if simulator is not None:
            task_of(simulator, None)
        name = next(iter(settings))
        option = "simulations" if name == "episodes" else name
        raise ValueError(f"--{option} needs a continuous task (--simulator cartpole:gravity=10)")


def recorded(
    spec: str,
    policy: str,
    transitions: int | None,
    episodes: int | None,
    horizon: int | None,
    discount: float | None,
    initial: str | None,
    seed: int,
    *,
    by_name: bool,
) -> Transitions:
    """A log of the environment that ``spec`` names; Gymnasium's are stepped. ``by_name``: with its names where it has some."""
    from oee_tabular.data import Transitions
    from oee_tabular.tasks import record_episodes

    task = task_of(spec, discount, initial)
    pi = policy_of(policy, task, "policy")
    steps = 1000 if horizon is None else horizon
    if task.environment is None or initial is not None:  # which no environment's reset() takes
        log = sampled(task.mdp, pi, transitions, episodes, steps, seed)
    else:
        env = task.environment()
        log = record_episodes(env, pi, n_transitions=transitions, n_episodes=episodes, max_steps=steps, seed=seed)
        env.close()
    if not by_name:
        return log
    return Transitions(**log.columns(), state_names=task.mdp.state_names, action_names=task.mdp.action_names)


def sampled(
    mdp: FiniteMDP, pi: Array, transitions: int | None, episodes: int | None, horizon: int, seed: int
) -> Transitions:
    """Episodes of our own sampler: as many as asked for, or as many as hold the transitions, the last one cut."""
    from oee_tabular._checks import positive_integer
    from oee_tabular.simulate import sample_episodes
    from oee_tabular.simulate.logs import episodes_holding

    positive_integer(horizon, "horizon")
    if episodes is not None:
        return sample_episodes(mdp, pi, episodes, horizon, seed=seed)
    assert transitions is not None
    wanted = positive_integer(transitions, "transitions")
    return episodes_holding(mdp, pi, wanted, horizon, seed=seed).first(wanted)


def problem_of(
    task: NamedTask,
    log: list[str],
    *,
    horizon: int | None,
    behavior: str | None,
    rewards: Any,
    impossible: str = "refuse",
) -> Problem:
    """A problem from a task and the files of a log; ``impossible``: refuse, drop or allow=EPS."""
    from oee_tabular import _progress
    from oee_tabular.data import read_log
    from oee_tabular.estimators import Problem

    way, epsilon = impossible_of(impossible)
    _progress.report_step(f"reading the log {', '.join(log)}")
    found, simulator = read_log(log[0] if len(log) == 1 else log, task.mdp), task.mdp
    return Problem(
        simulator if epsilon is None else simulator.with_support_of(_moves(found, simulator), epsilon),
        found,
        horizon=horizon,
        behavior_policy=None if behavior is None else policy_of(behavior, task, "--behavior"),
        rewards=rewards,
        impossible=way,
    )


def impossible_of(text: str) -> tuple[Literal["refuse", "drop"], float | None]:
    """What ``--impossible`` says: refuse, drop, or the EPS of allow=EPS."""
    if text == "refuse":
        return "refuse", None
    if text == "drop":
        return "drop", None
    word, _, number = text.partition("=")
    try:
        epsilon = float(number)
    except ValueError:
        epsilon = -1.0
    if word != "allow" or not 0.0 < epsilon < 1.0:
        raise ValueError(f"--impossible must be refuse, drop, or allow=EPS with 0 < EPS < 1, allow=0.01; got {text!r}")
    return "refuse", epsilon


def box_of(text: str | None) -> dict[str, float | None]:
    """What ``--box`` says: LOWER,UPPER, either left out."""
    if text is None:
        return {}
    ends: list[float | None] = []
    for part in text.split(","):
        try:
            ends.append(float(part) if part.strip() else None)
        except ValueError:
            ends.append(float("nan"))
    if len(ends) != 2 or any(x is not None and math.isnan(x) for x in ends):
        raise ValueError(f"--box must be LOWER,UPPER, bounds on P_target / P, as 0.5,2; got {text!r}")
    return {"lower_ratio": ends[0], "upper_ratio": ends[1]}


def _moves(log: Transitions | TransitionCounts, simulator: FiniteMDP) -> Any:
    """What ``with_support_of`` takes."""
    from oee_tabular.data import Transitions

    return log if isinstance(log, Transitions) else log.counts(simulator.n_states, simulator.n_actions)


def given_problem(
    simulator: str, log: list[str], behavior: str | None, options: dict[str, Any]
) -> tuple[NamedTask, Problem]:
    """The task and the problem of the options that ``evaluate``, ``compare`` and ``plan`` share."""
    from dataclasses import replace

    task = task_of(simulator, options["discount"], options["initial"])
    if options["action_noise"]:
        task = replace(task, mdp=task.mdp.with_action_noise(options["action_noise"]))
    asked = {name: options[name] for name in ("horizon", "rewards", "impossible")}
    return task, problem_of(task, log, behavior=behavior, **asked)


def from_files(
    simulator: str,
    log: list[str],
    policy: list[str] | None,
    behavior: str | None,
    target: str | None,
    options: dict[str, Any],
    normalized: bool,
    common: dict[str, Any],
) -> Report:
    """The report on a simulator, a log and policies from files."""
    from oee_tabular.cli.entries import known_entries
    from oee_tabular.report import evaluate as run
    from oee_tabular.report.page import date_of
    from oee_tabular.tasks.arguments import named_specs

    task, problem = given_problem(simulator, log, behavior, options)
    truth = None if target is None else task_of(target, task.mdp.discount, options["initial"]).mdp
    facts = {
        "simulator_name": simulator,
        "log_name": ", ".join(log),
        "log_files": log,
        "action_noise": options["action_noise"],
    }
    facts |= {name: options[name] for name in ("initial", "impossible") if options[name] not in (None, "refuse")}
    specs = named_specs(policy or ["optimal"])
    facts |= {"policy_names": specs, "date": date_of([simulator, *log, *specs.values()])}
    facts |= {} if options["discount"] is None else {"discount": options["discount"]}
    if options["action_noise"]:
        facts["simulator"] = f"{simulator} with action noise {options['action_noise']:g}: {task.mdp!r}"
    known, said = known_entries(options, task.mdp)
    known |= box_of(options["box"])
    return run(
        problem, policies_of(policy, task), target=truth, normalized=normalized, facts=facts | said, **known, **common
    )


def embedded(
    policy: list[str] | None,
    behavior: str | None,
    target: str | None,
    options: dict[str, Any],
    normalized: bool | None,
    common: dict[str, Any],
) -> Report:
    """The report on the embedded default."""
    from oee_tabular.experiments import embedded_default
    from oee_tabular.report import evaluate as run
    from oee_tabular.tasks import named_task

    given = {
        "behavior": behavior,
        "target": target,
        "action-noise": options["action_noise"],
        "initial": options["initial"],
    }
    given |= {} if options["impossible"] == "refuse" else {"impossible": options["impossible"]}
    for name, value in (given | {name: options[name] for name in ("features", "tie", "box")}).items():
        if value:
            raise ValueError(f"--{name} needs --simulator and --log")
    settings: dict[str, Any] = {"rewards": options["rewards"]}
    settings |= {name: options[name] for name in ("horizon", "discount") if options[name] is not None}
    default = embedded_default(seed=common["seed"], **settings)
    policies: dict[str, Any] = default.policies
    if policy is not None:
        policies = policies_of(policy, named_task("gridworld:10,slip=0.3", discount=options["discount"]))
    scaled = True if normalized is None else normalized
    return run(default.problem, policies, target=default.target, normalized=scaled, **common)
