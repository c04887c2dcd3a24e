"""Returns and weights of sampled episodes that are not stored (4.2)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np

from oee_tabular import _checks, _printing
from oee_tabular._keywords import suggest_keywords
from oee_tabular._results import checked
from oee_tabular.data import Transitions
from oee_tabular.mdp import FiniteMDP, check_policy, horizon_length
from oee_tabular.simulate.sampler import draw, episode_log
from oee_tabular.typing import Array, IntArray, PolicyLike, Seed

if TYPE_CHECKING:
    from oee_tabular.exact import RatioLike
else:
    RatioLike: TypeAlias = Any  # for ``typing.get_type_hints``

KINDS = ("per_decision", "trajectory")
Kind: TypeAlias = Literal["per_decision", "trajectory"]


@checked(
    shapes=dict.fromkeys(
        ("values", "returns", "weights", "lengths", "final_state"), "n"
    )
)
@dataclass(frozen=True, eq=False, repr=False)
class SampledReturns:
    """Hold the returns and weights of n sampled episodes (``sample_returns``).

    Attributes
    ----------
    values : ndarray of shape (n,)
        X, whose mean estimates J; without zeta the returns.
    returns : ndarray of shape (n,)
        G = sum_t gamma^t r_t, unweighted.
    weights : ndarray of shape (n,)
        W of the whole episode; without zeta 1.
    lengths : ndarray of shape (n,)
        Number of steps.
    final_state : ndarray of shape (n,)
        The state after the last step.
    log : Transitions or None
        The same episodes as a log, where asked for.
    kind : str
        What X is: "per_decision" or "trajectory".

    Examples
    --------
    >>> import oee_tabular as oee
    >>> mdp = oee.tasks.gridworld(3, slip=0.1)
    >>> drawn = oee.sample_returns(
    ...     mdp, oee.tasks.gridworld_expert(3), 1000, horizon=20, seed=0
    ... )
    >>> drawn.lengths.min(), bool((drawn.final_state == 8).all())
    (np.int64(4), True)
    """

    values: Array
    returns: Array
    weights: Array
    lengths: IntArray
    final_state: IntArray
    log: Transitions | None = field(default=None)
    kind: Kind = "per_decision"

    def __len__(self) -> int:
        """Return the number of episodes."""
        return len(self.values)

    def __repr__(self) -> str:
        """Return the size, the mean and its standard error in a line."""
        what = "" if self.values is self.returns else f", weighted {self.kind}"
        return (
            f"SampledReturns({len(self)} episodes, {int(self.lengths.sum())}"
            f" transitions: mean {self.mean:.6g}, standard error"
            f" {self.standard_error:.2g}{what})"
        )

    def _repr_html_(self) -> str:
        """Return a table of the main numbers for notebooks."""
        rows: list[tuple[str, object]] = [
            ("episodes", len(self)),
            ("transitions", int(self.lengths.sum())),
            ("mean", f"{self.mean:.6g}"),
            ("standard error", f"{self.standard_error:.2g}"),
            ("largest weight", f"{self.weights.max():.4g}"),
        ]
        return _printing.facts(f"Sampled returns: {_printing.SUM}", rows)

    @property
    def mean(self) -> float:
        """Return the mean of ``values``."""
        return float(self.values.mean())

    @property
    def standard_error(self) -> float:
        """Return the standard error of the mean, from the spread of the values.

        It is nan for a single episode. Heavy weights make it too small.
        """
        n = len(self.values)
        return float(self.values.std(ddof=1) / np.sqrt(n)) if n > 1 else float("nan")


@suggest_keywords
def sample_returns(
    mdp: FiniteMDP,
    policy: PolicyLike,
    n_episodes: int,
    horizon: int,
    *,
    seed: Seed,
    zeta: RatioLike | None = None,
    kind: Kind = "per_decision",
    record: bool = False,
) -> SampledReturns:
    """Sample returns of episodes and, with ``zeta``, their products of ratios.

    The episodes are not stored. With W_t = zeta_1 ... zeta_t, per decision X = sum_t
    gamma^t W_t r_t, and for the trajectory X = W_{T-1} G; where rewards are r(s, a,
    s'), W_{t+1} and W_T take the places of W_t and W_{T-1}: the X of
    ``weighted_return_moments``. Episodes begin and end as in ``sample_episodes``.

    Parameters
    ----------
    mdp : FiniteMDP
        The model that episodes are drawn from; with ``zeta`` the simulator.
    policy : PolicyLike
        Action probabilities of shape (S, A); other forms as in ``check_policy``.
    n_episodes : int
        Number of episodes n.
    horizon : int
        Largest number of steps T of an episode.
    seed : Seed
        Anything that ``numpy.random.default_rng`` takes. A Generator is advanced.
    zeta : sparse array of shape (S*A, S), or an object with such ``values``, optional
        The ratio of transition probabilities, row s*A + a, on the support of ``mdp``.
        None means no weights.
    kind : {'per_decision', 'trajectory'}, default 'per_decision'
        What is estimated by X.
    record : bool, default False
        Whether the episodes are also returned as a log.

    Returns
    -------
    SampledReturns
        The returns, weights and lengths of the episodes.

    Raises
    ------
    ValueError
        If an argument is bad.

    See Also
    --------
    sample_episodes : Episodes as a log.
    weighted_return_moments : The exact mean and variance of X.

    Notes
    -----
    A step is one alias draw over its state's (a, s'), from one word of 62 bits: its
    probabilities are those of the model to 2^-50, a few roundings of doubles. The
    tables cost O(nnz) before the first step. Runs of more than a million steps are
    shared by threads. A seed draws other episodes than for ``sample_episodes``, but the
    same ones for every zeta, ``kind``, ``record`` and number of threads.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> mdp = oee.tasks.gridworld(10, slip=0.3)
    >>> policy = oee.uniform_policy(mdp)
    >>> drawn = sample_returns(mdp, policy, 20_000, horizon=200, seed=6)
    >>> len(drawn), int(drawn.lengths.sum())
    (20000, 3684503)
    >>> round(drawn.mean, 3), round(drawn.standard_error, 2)
    (-197.777, 0.28)
    >>> round(oee.policy_value(mdp, policy, horizon=200), 3)
    -197.914
    """
    _checks.instance(mdp, FiniteMDP, "mdp")
    _checks.one_of(kind, "kind", KINDS)
    _checks.boolean(record, "record")
    n = _checks.positive_integer(n_episodes, "n_episodes")
    pi = check_policy(policy, mdp)
    steps = horizon_length(horizon, mdp)
    drawn = draw(mdp, pi, n, steps, seed=seed, zeta=zeta, record=record)
    if zeta is None:
        values = drawn.returns
    elif kind == "per_decision":
        values = drawn.weighted
    else:
        values = drawn.whole
    return SampledReturns(
        values=values,
        returns=drawn.returns,
        weights=drawn.weights,
        lengths=drawn.lengths,
        final_state=drawn.final_state,
        log=episode_log(mdp, drawn, pi) if record else None,
        kind=kind,
    )
