"""``oee info``: what a file or data set holds."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from oee_tabular import _files

if TYPE_CHECKING:
    from oee_tabular._checks import Array
    from oee_tabular.continuous.log import ContinuousTransitions
    from oee_tabular.data import TransitionCounts


def described(file: str) -> tuple[str, str]:
    """What kind of thing a file or data set holds, and what it is in words."""
    from oee_tabular.continuous.log import ContinuousTransitions
    from oee_tabular.continuous.log_files import holds_states
    from oee_tabular.data import TransitionCounts, Transitions

    path = Path(_files.local(file))
    if path.is_dir() and (path / "report.json").is_file():
        path = path / "report.json"
    if path.suffix.lower() == ".json":
        from oee_tabular.report.files import summary

        return "report", summary(path)
    if holds_states(file):
        return "continuous_transitions", _states(ContinuousTransitions.load(file))
    if path.suffix.lower() not in (".npz", ".npy"):
        return "transitions", repr(Transitions.load(file))
    arrays = _files.read_npz(file)
    kind = _files.npz_kind(arrays)
    if kind == "finite_mdp":
        return kind, _mdp(file, arrays)
    if kind == "transitions":
        return kind, repr(Transitions.load(file))
    if kind == "transition_counts":
        return kind, _counted(TransitionCounts.load(file))
    return "arrays", "\n".join(_array(name, array) for name, array in arrays.items())


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
