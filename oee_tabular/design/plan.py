"""The result of ``plan_data_collection``: a plan and the precision it predicts."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from scipy import special

from oee_tabular import _checks, _printing
from oee_tabular._results import checked
from oee_tabular.design.advice import advice_sentence, describe_pair
from oee_tabular.design.programs import sum_variances
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import NAMELESS, Names, name_text
from oee_tabular.typing import Array, BoolArray, IntArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@checked(levels=("confidence",))
@dataclass(frozen=True)
class Outlook:
    """The precision that a plan predicts for one policy.

    Attributes
    ----------
    name : str
        The name of the policy.
    variance_now : float
        The asymptotic variance of J with the log, in squared units of J; inf if a
        state-action pair that matters has no data.
    variance_after : float
        The asymptotic variance of J after the plan; inf if a pair that matters has no
        data then.
    inefficiency : float
        ``variance_after`` divided by the smallest that a plan for this policy alone
        reaches; 1 at best.
    free_inefficiency : float
        The same relative to a plan in which any pair could be recorded.
    confidence : float
        The level of ``width``, in (0, 1).

    See Also
    --------
    Plan : The plan with the outlooks of all policies.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> pair = oee.testing.case("ragged")
    >>> plan = oee.plan_data_collection(pair.problem(1000, seed=0), pair.policy, n=1000)
    >>> now, after = plan.policies[0].standard_error
    >>> (
    ...     round(now, 3),
    ...     round(after, 3),
    ...     round(plan.after(4000)["policy"].standard_error[1], 3),
    ... )
    (0.169, 0.142, 0.112)
    """

    name: str
    variance_now: float
    variance_after: float
    inefficiency: float
    free_inefficiency: float
    confidence: float

    @property
    def standard_error(self) -> tuple[float, float]:
        """Return the standard error now and after the plan, in the unit of J."""
        return float(np.sqrt(self.variance_now)), float(np.sqrt(self.variance_after))

    @property
    def width(self) -> tuple[float, float]:
        """Return the width of J -+ z standard errors, now and after the plan."""
        z = float(special.ndtri(0.5 + self.confidence / 2.0))
        return 2.0 * z * self.standard_error[0], 2.0 * z * self.standard_error[1]


@checked(
    shapes=dict.fromkeys(
        ("distribution", "behavior_policy", "counts", "costs", "optimistic"), "S A"
    ),
    levels=("confidence",),
    counts=("n",),
)
@dataclass(frozen=True, eq=False)
class Plan:
    """A plan: where to record the next ``n`` transitions.

    Attributes
    ----------
    sampling : {'free', 'behavior'}
        Whether any pair can be recorded, or a behaviour policy records.
    n : int
        The number of transitions that are planned.
    confidence : float
        The level of the predicted widths, in (0, 1).
    distribution : ndarray of shape (S, A)
        The share of the n transitions that each pair gets ("behavior": on average); it
        sums to 1.
    behavior_policy : ndarray of shape (S, A)
        The distribution divided by its sum over actions; uniform in states that it
        never visits.
    policies : tuple of Outlook
        The predicted precision for each policy.
    gap : float
        The certificate: relative optimality gap of the criterion, the largest
        inefficiency.
    next_pairs : tuple of (int, int)
        The best next single pairs (s, a), one after another, at most 10. They most
        reduce the summed interval widths 2 z se: by z c_x / (n_x (n_x + 1)) / se each,
        and a pair never recorded by 2 z sqrt(c_x).
    counts : ndarray of shape (S, A)
        The counts of the log.
    costs : dict of str to ndarray of shape (S, A)
        The costs c_x of each policy, in squared units of J.
    optimistic : ndarray of shape (S, A)
        Whether the model is deterministic and c_x is the largest plausible variance.
    restart : float or None
        The probability of a restart after each transition; None for free sampling.
    model : str
        The model at which variances are evaluated, in words.
    solver : str
        How the plan was found.
    status : str
        "ok", or why the plan is not the best.
    names : Names
        The names of states and actions.
    is_gain : bool
        Whether variances, errors and costs are those of gains J(policy) - J(minus), the
        differences from a policy that was subtracted, and not of values J(policy).

    See Also
    --------
    plan_data_collection : Make a plan.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> pair = oee.testing.case("ragged")
    >>> plan = oee.plan_data_collection(pair.problem(1000, seed=0), pair.policy, n=1000)
    >>> plan.allocation.tolist(), plan.status
    ([[631, 0], [5, 244], [37, 83], [0, 0]], 'ok')
    >>> [round(width, 2) for width in plan.expected_width]
    [0.66, 0.56]
    """

    sampling: Literal["free", "behavior"]
    n: int
    confidence: float
    distribution: Array
    behavior_policy: Array
    policies: tuple[Outlook, ...]
    gap: float
    next_pairs: tuple[tuple[int, int], ...]
    counts: Array
    costs: dict[str, Array]
    optimistic: BoolArray
    restart: float | None
    model: str
    solver: str
    status: str = "ok"
    names: Names = NAMELESS
    is_gain: bool = False

    def __post_init__(self) -> None:
        for name, some in (("policies", self.policies), ("costs", self.costs)):
            if not some:
                raise ArgumentError(name, "must have a policy; it is empty")
        with np.errstate(over="ignore"):
            total = float(self.distribution.sum())
        if self.distribution.min() < 0.0 or abs(total - 1.0) > _checks.SUM_TOLERANCE:
            raise ArgumentError(
                "distribution",
                "must have nonnegative shares that sum to 1; the smallest is"
                f" {self.distribution.min():g} and their sum {total:g}",
            )
        n_states, n_actions = self.counts.shape
        for k, (s, a) in enumerate(self.next_pairs):
            if not (0 <= s < n_states and 0 <= a < n_actions):
                raise ArgumentError(
                    f"next_pairs[{k}]",
                    f"must be a pair of {n_states} states and {n_actions} actions; it"
                    f" is {(s, a)}",
                )

    @property
    def inefficiency(self) -> float:
        """Return the largest inefficiency of the policies.

        It is the variance over the smallest that a plan for that policy alone reaches.
        """
        return max(outlook.inefficiency for outlook in self.policies)

    @property
    def free_inefficiency(self) -> float:
        """Return the largest inefficiency relative to recording any pairs."""
        return max(outlook.free_inefficiency for outlook in self.policies)

    @property
    def expected_standard_error(self) -> tuple[float, float]:
        """Return the largest standard error of the policies, now and after the plan."""
        errors = [outlook.standard_error for outlook in self.policies]
        return max(now for now, _ in errors), max(after for _, after in errors)

    @property
    def expected_width(self) -> tuple[float, float]:
        """Return the largest interval width of the policies, now and after the plan."""
        widths = [outlook.width for outlook in self.policies]
        return max(now for now, _ in widths), max(after for _, after in widths)

    @property
    def unrecorded(self) -> int:
        """Return how many pairs that matter to a policy were never recorded."""
        matters = np.max(list(self.costs.values()), axis=0) > 0
        return int(np.sum((self.counts == 0) & matters))

    @property
    def allocation(self) -> IntArray:
        """Return whole numbers of transitions (S, A) that sum to n.

        They are n * distribution, with the largest remainders rounded up.
        """
        exact = self.n * self.distribution.reshape(-1)
        whole = np.floor(exact)
        missing = self.n - int(whole.sum())
        largest_remainders = np.argsort(-(exact - whole), kind="stable")[:missing]
        whole[largest_remainders] += 1.0
        return whole.reshape(self.distribution.shape).astype(np.int64)

    @property
    def advice(self) -> str:
        """Return the first of ``next_pairs`` in a sentence, as a report does."""
        costs = np.array(list(self.costs.values()))
        return advice_sentence(
            self.next_pairs,
            costs,
            self.counts,
            self.optimistic,
            self.names,
            of="gain" if self.is_gain else "value",
        )

    def after(self, m: int) -> dict[str, Outlook]:
        """Return the outlook after m transitions of the same distribution.

        Parameters
        ----------
        m : int
            The number of transitions in place of n, at least 1.

        Returns
        -------
        dict of str to Outlook
            The outlook of each policy. The inefficiencies are the plan's own (for n).
        """
        number = _checks.positive_integer(m, "m")
        total = (self.counts + number * self.distribution).reshape(-1)
        costs = np.array([cost.reshape(-1) for cost in self.costs.values()])
        variances = sum_variances(costs, total, np.zeros_like(total))
        return {
            o.name: replace(o, variance_after=float(v))
            for o, v in zip(self.policies, variances, strict=True)
        }

    def to_dict(self) -> dict[str, Any]:
        """Return what the plan prints, as plain values.

        Returns
        -------
        dict
            Numbers, texts, lists and dicts; states and actions by name if they have
            names.
        """

        def pair(s: int, a: int) -> dict[str, Any]:
            """Return a state and an action by number, or by name."""
            numbers = {
                "state": (self.names.states, s),
                "action": (self.names.actions, a),
            }
            return {
                key: int(k) if names is None else name_text(names, k)
                for key, (names, k) in numbers.items()
            }

        return {
            "sampling": self.sampling,
            "n": self.n,
            "quantity": "gain" if self.is_gain else "value",
            "confidence": self.confidence,
            "status": self.status,
            "gap": self.gap,
            "policies": [
                {
                    "policy": o.name,
                    "standard_error": list(o.standard_error),
                    "width": list(o.width),
                    "inefficiency": o.inefficiency,
                    "free_inefficiency": o.free_inefficiency,
                }
                for o in self.policies
            ],
            "most": [
                pair(s, a) | {"share": float(self.distribution[s, a])}
                for s, a in self._largest_shares()
            ],
            "advice": self.advice,
            "next": [pair(s, a) for s, a in self.next_pairs],
        }

    def _largest_shares(self) -> list[tuple[int, int]]:
        """Return the five pairs with the largest shares of the transitions."""
        order = np.argsort(-self.distribution, axis=None, kind="stable")[:5]
        return [divmod(int(row), self.distribution.shape[1]) for row in order]

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the states where the plan records most, with their counts in the log.

        Parameters
        ----------
        ax : matplotlib Axes, optional
            The axes to draw on. None makes new ones.

        Returns
        -------
        matplotlib Axes
            The axes with the picture.
        """
        from oee_tabular.plots import plot_states  # a room above, on use

        numbers = range(len(self.counts))
        if self.names.states is None:
            names = [f"state {s}" for s in numbers]
        else:
            names = [self.names.state(s) for s in numbers]
        return plot_states(
            self.distribution,
            self.counts,
            ax,
            names=names,
            xlabel="share of the planned transitions (%)",
        )

    def __repr__(self) -> str:
        return str(self)

    def __str__(self) -> str:
        how = "any state-action pair"
        if self.sampling == "behavior":
            how = f"by a behaviour policy, restart probability {self.restart:.3g}"
        size = max(6, *(len(o.name) for o in self.policies))
        level = f"{100 * self.confidence:.4g}% width"
        lines = [
            (
                f"Plan for {self.n} transitions, {how}; variances at {self.model};"
                f" {self._quantity}"
            ),
            (
                f"{'policy':<{size}}  {'std. error':>10} -> {'after':<9}  {level:>10}"
                f" -> {'after':<9}  inefficiency  vs. free"
            ),
        ]
        for o in self.policies:
            error = _write_change(o.standard_error)
            width = _write_change(o.width)
            lines.append(
                f"{o.name:<{size}}  {error}  {width}  {o.inefficiency:>12.3f} "
                f" {o.free_inefficiency:>8.3f}"
            )
        return "\n".join([*lines, *self._notes()])

    @property
    def _quantity(self) -> str:
        """Return what the errors and widths are of."""
        if self.is_gain:
            return f"gains over the policy that is subtracted: {_printing.SUM}"
        return f"values: {_printing.SUM}"

    def _notes(self) -> list[str]:
        """Return the lines below the table."""
        lines = [
            (
                "std. errors, widths: for maximum likelihood, without the prior of oee"
                " (inf: a pair that matters has no data)"
            ),
            (
                f"inefficiency: variance ÷ the smallest that {self.n} transitions"
                " planned for this policy alone could reach"
            ),
            "vs. free: the same if any state-action pair could be recorded",
        ]
        describe = partial(describe_pair, self.names)
        shares = [
            f"{describe(s, a)} {100 * self.distribution[s, a]:.1f}%"
            for s, a in self._largest_shares()
        ]
        lines += ["largest shares: " + ", ".join(shares), self.advice]
        if len(self.next_pairs) > 1:
            # in the order in which each comes first
            times = Counter(self.next_pairs[1:])
            following = ", ".join(
                describe(s, a) + (f" ({number} times)" if number > 1 else "")
                for (s, a), number in times.items()
            )
            n_next = len(self.next_pairs) - 1
            lines.append(f"then the next {n_next}: {following}")
        if self.unrecorded:
            lines.append(
                "state-action pairs that matter and were never recorded:"
                f" {self.unrecorded}"
            )
        if self.optimistic.any():
            lines.append(
                "pairs that the model makes deterministic (worst variance assumed):"
                f" {self.optimistic.sum()}"
            )
        close = (
            f"solver: {self.solver}; at most {100 * self.gap:.2g}% from the best plan"
        )
        return [*lines, close if self.status == "ok" else self.status]

    def _repr_html_(self) -> str:
        def change(ends: tuple[float, float]) -> str:
            """Write a number now and after the plan."""
            return f"{ends[0]:.3g} → {ends[1]:.3g}"

        level = f"{100 * self.confidence:.4g}% width"
        rows = [
            (
                o.name,
                change(o.standard_error),
                change(o.width),
                f"{o.inefficiency:.3f}",
                f"{o.free_inefficiency:.3f}",
            )
            for o in self.policies
        ]
        header = [
            "policy",
            "std. error, now → after",
            f"{level}, now → after",
            "inefficiency",
            "vs. free",
        ]
        caption = f"Plan for {self.n} transitions; {self._quantity}"
        return _printing.table(header, rows, caption=caption, below=self._notes())


def _write_change(ends: tuple[float, float]) -> str:
    """Write a number now and after the plan, in columns of the table."""
    now, after = ends
    return f"{now:>10.3g} -> {after:<9.3g}"
