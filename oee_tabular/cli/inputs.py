"""What the command's words mean: tasks, policies, logs and problems from specifications and files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from oee_tabular import _files
from oee_tabular.estimators.names import names

if TYPE_CHECKING:
    from oee_tabular._checks import Array
    from oee_tabular.continuous.log import ContinuousTransitions
    from oee_tabular.data import TransitionCounts, Transitions
    from oee_tabular.estimators import Problem
    from oee_tabular.mdp import FiniteMDP
    from oee_tabular.report import Report
    from oee_tabular.tasks import NamedTask

SIMULATOR_HELP = (
    "gridworld:10,slip=0.3 | a Gymnasium id with arguments, FrozenLake-v1:map_name=8x8,success_rate=0.6 | "
    "an .npz of a FiniteMDP | a continuous task, cartpole:gravity=10, or a Gymnasium id with physics, Pendulum-v1:g=9"
)
POLICY_HELP = (
    ".npy or .npz of an (S, A) array | uniform | optimal | expert | mix:0.5 (half expert, half uniform); optimal and expert "
    "are the simulator's; expert is optimal where a task has none of its own; a continuous task has expert, uniform and mix, "
    "arrays of its cells, and MODULE:FUNCTION of its states"
)

_ENTRIES = (
    "file of the simulator's transitions, .csv (columns state, action, next_state, ...) or .npy (S, A, S) or (entries,)"
)
FEATURES_HELP = f"Your own features of moves, as a row oee-features: {_ENTRIES}, with a last axis for several."
TIE_HELP = f"Integer keys, moves with one key share one ratio, as a row oee-tied: {_ENTRIES}."
ESTIMATORS_HELP = f"{', '.join(names())}; with --target: {', '.join(names(needs_target=True))}"


def task_of(spec: str, discount: float | None) -> NamedTask:
    """The task that ``spec`` names."""
    from oee_tabular.tasks import named_task

    return named_task(spec, discount=discount)


def policy_of(spec: str, task: NamedTask, name: str) -> Array:
    """The policy that ``spec`` names, in the MDP of ``task``."""
    from oee_tabular.exact import optimal_policy
    from oee_tabular.mdp import check_policy, mix, uniform_policy
    from oee_tabular.mdp.policies import policy_array

    if spec == "uniform":
        return uniform_policy(task.mdp)
    if spec == "optimal":
        return optimal_policy(task.mdp)
    if spec == "expert":
        return check_policy(task.expert(), task.mdp)
    if spec.startswith("mix:"):
        try:
            weight = float(spec.removeprefix("mix:"))
        except ValueError:
            raise ValueError(f"{name} must be like mix:0.5; got {spec!r}") from None
        return mix(check_policy(task.expert(), task.mdp), uniform_policy(task.mdp), weight)
    if Path(spec).suffix.lower() not in (".npy", ".npz"):
        raise ValueError(f"{name} must be uniform, optimal, expert, mix:WEIGHT, or a .npy or .npz file; got {spec!r}")
    return check_policy(policy_array(spec, name), task.mdp, name=f"{name} {spec!r}")


def named_specs(specs: list[str]) -> dict[str, str]:
    """Name -> SPEC from NAME=SPEC, or from SPEC, which is its own name."""
    found: dict[str, str] = {}
    for text in specs:
        name, equals, spec = text.partition("=")
        label, source = (name, spec) if equals else (text, text)
        if label in found:
            raise ValueError(f"--policy names must differ; {label!r} is given twice")
        found[label] = source
    return found


def policies_of(specs: list[str] | None, task: NamedTask) -> dict[str, Any]:
    """Policies from NAME=SPEC or SPEC; optimal where there are none."""
    return {name: policy_of(spec, task, "--policy") for name, spec in named_specs(specs or ["optimal"]).items()}


def write_array(path: Path, array: Array) -> None:
    """A .npy file, which appears whole or not at all."""
    import numpy as np

    from oee_tabular import _files

    with _files.whole_file(path, (".npy",)) as handle:
        np.save(handle, array, allow_pickle=False)


def recorded(
    spec: str,
    policy: str,
    transitions: int | None,
    episodes: int | None,
    horizon: int | None,
    discount: float | None,
    seed: int,
) -> Transitions:
    """A log of the environment that ``spec`` names; Gymnasium's are stepped."""
    from oee_tabular.tasks import record_episodes

    task = task_of(spec, discount)
    pi = policy_of(policy, task, "policy")
    steps = 1000 if horizon is None else horizon
    if task.environment is None:
        return sampled(task.mdp, pi, transitions, episodes, steps, seed)
    env = task.environment()
    log = record_episodes(env, pi, n_transitions=transitions, n_episodes=episodes, max_steps=steps, seed=seed)
    env.close()
    return log


def sampled(
    mdp: FiniteMDP, pi: Array, transitions: int | None, episodes: int | None, horizon: int, seed: int
) -> Transitions:
    """Episodes of our own sampler: as many as asked for, or as many as hold the transitions, the last one cut."""
    from oee_tabular._checks import positive_integer
    from oee_tabular.simulate import sample_episodes

    positive_integer(horizon, "horizon")
    if episodes is not None:
        return sample_episodes(mdp, pi, episodes, horizon, seed=seed)
    assert transitions is not None
    wanted = positive_integer(transitions, "transitions")
    count = 1 + wanted // horizon
    while len(log := sample_episodes(mdp, pi, count, horizon, seed=seed)) < wanted:
        count *= 2
    return log.first(wanted)


def problem_of(task: NamedTask, log: Path, *, horizon: int | None, behavior: str | None, rewards: Any) -> Problem:
    """A problem from a task and the file of a log."""
    from oee_tabular.estimators import Problem

    return Problem(
        task.mdp,
        _log_of(log),
        horizon=horizon,
        behavior_policy=None if behavior is None else policy_of(behavior, task, "--behavior"),
        rewards=rewards,
    )


def _log_of(path: Path) -> Transitions | TransitionCounts:
    """A log, or the counts of one."""
    from oee_tabular.data import TransitionCounts, Transitions
    from oee_tabular.data.streaming import holds_counts

    return TransitionCounts.load(path) if holds_counts(path) else Transitions.load(path)


def from_files(
    simulator: str,
    log: Path,
    policy: list[str] | None,
    behavior: str | None,
    target: str | None,
    options: dict[str, Any],
    normalized: bool,
    common: dict[str, Any],
) -> Report:
    """The report on a simulator, a log and policies from files."""
    from dataclasses import replace

    from oee_tabular.cli.entries import own_rows
    from oee_tabular.estimators.names import default_names, named_estimators
    from oee_tabular.report import evaluate as run

    task = task_of(simulator, options["discount"])
    if options["action_noise"]:
        task = replace(task, mdp=task.mdp.with_action_noise(options["action_noise"]))
    problem = problem_of(task, log, horizon=options["horizon"], behavior=behavior, rewards=options["rewards"])
    truth = None if target is None else task_of(target, task.mdp.discount).mdp
    facts = {"simulator_name": simulator, "log_name": str(log), "action_noise": options["action_noise"]}
    if options["action_noise"]:
        facts["simulator"] = f"{simulator} with action noise {options['action_noise']:g}: {task.mdp!r}"
    own, said = own_rows(options, task.mdp)
    left_out: list[str] = []
    if own:
        names = common["estimators"]
        if names is None:
            names, left_out = default_names(problem)
        common = common | {"estimators": named_estimators(names, truth) | own}
    report = run(problem, policies_of(policy, task), target=truth, normalized=normalized, facts=facts | said, **common)
    return replace(report, warnings=(*report.warnings, *left_out))


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

    given = {"behavior": behavior, "target": target, "action-noise": options["action_noise"]}
    for name, value in (given | {name: options[name] for name in ("features", "tie")}).items():
        if value:
            raise ValueError(f"--{name} needs --simulator and --log")
    settings: dict[str, Any] = {"rewards": options["rewards"]}
    settings |= {name: options[name] for name in ("horizon", "discount") if options[name] is not None}
    default = embedded_default(seed=common["seed"], **settings)
    policies: dict[str, Any] = default.policies
    if policy is not None:
        policies = policies_of(policy, named_task("gridworld:10,slip=0.3", discount=options["discount"]))
    if common["estimators"] is None:
        names = "simulator,oee,oee-product,ratio-of-ratios,model-based,pdis,wpdis,oracle-product"
        common = common | {"estimators": names.split(",")}
    scaled = True if normalized is None else normalized
    return run(default.problem, policies, target=default.target, normalized=scaled, **common)


def described(file: str) -> str:
    """What a file or data set holds."""
    from oee_tabular.continuous.log import ContinuousTransitions
    from oee_tabular.continuous.log_files import holds_states
    from oee_tabular.data import TransitionCounts, Transitions

    path = Path(_files.local(file))
    if path.is_dir() and (path / "report.json").is_file():
        path = path / "report.json"
    if path.suffix.lower() == ".json":
        from oee_tabular.report.files import summary

        return summary(path)
    if holds_states(file):
        return _states(ContinuousTransitions.load(file))
    if path.suffix.lower() not in (".npz", ".npy"):
        return repr(Transitions.load(file))
    arrays = _files.read_npz(file)
    kind = _files.npz_kind(arrays)
    if kind == "finite_mdp":
        return _mdp(file, arrays)
    if kind == "transitions":
        return repr(Transitions.load(file))
    if kind == "transition_counts":
        return _counted(TransitionCounts.load(file))
    return "\n".join(_array(name, array) for name, array in arrays.items())


def _states(log: ContinuousTransitions) -> str:
    lines = [repr(log)]
    for name in ("state", "next_state"):
        values: Array = getattr(log, name)
        ranges = zip(values.min(axis=0), values.max(axis=0), strict=True)
        lines.append(f"{name}: " + ", ".join(f"_{k} {low:.4g} to {high:.4g}" for k, (low, high) in enumerate(ranges)))
    if log.behavior_probability is not None:
        lines.append("with behaviour probabilities")
    return "\n".join(lines)


def _counted(log: TransitionCounts) -> str:
    return "\n".join([repr(log), *(f"dropped: {reason}" for reason in log.recording.reasons)])


def _mdp(file: str, arrays: dict[str, Any]) -> str:
    import json

    from oee_tabular.mdp import FiniteMDP

    mdp = FiniteMDP.load(file)
    over = int(mdp.absorbing().sum())
    text = f"{mdp!r}\nexpected rewards r(s, a) {mdp.rewards.min():g} to {mdp.rewards.max():g}, "
    text += f"{over} state{'s' * (over != 1)} in which an episode is over"
    if "metadata" in arrays:
        with _files.parts_of(file, "a Discretization"):
            facts = dict(json.loads(str(arrays["metadata"])))
        text += "\nmade from a continuous task: " + ", ".join(f"{name} {value}" for name, value in facts.items())
    return text


def _array(name: str, array: Any) -> str:
    policy_like = array.ndim == 2 and array.dtype.kind == "f" and bool((abs(array.sum(axis=1) - 1) < 1e-8).all())
    what = f"policy of {array.shape[0]} states and {array.shape[1]} actions" if policy_like else "array"
    return f"{what} ({name!r}): {array.dtype} of shape {array.shape}"
