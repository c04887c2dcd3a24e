"""Returns and weights of sampled episodes that are not written down (4.2)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from oee_tabular import _checks, _printing
from oee_tabular.data import Transitions
from oee_tabular.mdp import FiniteMDP, check_policy
from oee_tabular.mdp.horizons import horizon_length
from oee_tabular.simulate.sampler import draw, episode_log
from oee_tabular.typing import Array, IntArray, PolicyLike, Seed

KINDS = ("per_decision", "trajectory")


@dataclass(frozen=True, eq=False, repr=False)
class SampledReturns:
    """The result of ``sample_returns``: a number for each of n episodes.

    Attributes
    ----------
    values : (n,) X, whose mean estimates J; without zeta the returns
    returns : (n,) G = sum_t gamma^t r_t, unweighted
    weights : (n,) W of the whole episode; without zeta 1
    lengths : (n,) steps
    final_state : (n,) the state after the last step
    log : the same episodes written out, where asked for
    kind : what X is

    Examples
    --------
    >>> import oee_tabular as oee
    >>> mdp = oee.tasks.gridworld(3, slip=0.1)
    >>> drawn = oee.sample_returns(mdp, oee.tasks.gridworld_expert(3), 1000, horizon=20, seed=0)
    >>> drawn.lengths.min(), bool((drawn.final_state == 8).all())
    (np.int64(4), True)
    """

    values: Array
    returns: Array
    weights: Array
    lengths: IntArray
    final_state: IntArray
    log: Transitions | None = field(default=None)
    kind: str = "per_decision"

    def __len__(self) -> int:
        return len(self.values)

    def __repr__(self) -> str:
        what = "" if self.values is self.returns else f", weighted {self.kind}"
        return (
            f"SampledReturns({len(self)} episodes, {int(self.lengths.sum())}"
            f" transitions: mean {self.mean:.6g}, standard error"
            f" {self.standard_error:.2g}{what})"
        )

    def _repr_html_(self) -> str:
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
        """Of ``values``."""
        return float(self.values.mean())

    @property
    def standard_error(self) -> float:
        """Standard error of the mean, from the values' spread; nan for a single
        episode. Heavy weights make it too small.
        """
        n = len(self.values)
        return float(self.values.std(ddof=1) / np.sqrt(n)) if n > 1 else float("nan")


def sample_returns(
    mdp: FiniteMDP,
    policy: PolicyLike,
    n_episodes: int,
    horizon: int,
    *,
    seed: Seed,
    zeta: object = None,
    kind: Literal["per_decision", "trajectory"] = "per_decision",
    record: bool = False,
) -> SampledReturns:
    """Sample returns of episodes and, with ``zeta``, their products of ratios, without
    storing the episodes.

    W_t = zeta_1 ... zeta_t. per_decision: X = sum_t gamma^t W_t r_t; trajectory: X =
    W_{T-1} G; where rewards are r(s, a, s'), W_{t+1} and W_T: the X of
    ``weighted_return_moments``. Episodes begin and end as in ``sample_episodes``.

    Parameters
    ----------
    mdp : FiniteMDP; with ``zeta`` the simulator
    policy : (S, A)
    n_episodes, horizon : positive int
    seed : anything that ``numpy.random.default_rng`` takes; a Generator is advanced
    zeta : csr (S*A, S) or an object with such ``values``, on the support of ``mdp``;
        None: no weights
    kind : "per_decision" | "trajectory"
    record : whether the episodes are also given as a log

    Returns
    -------
    SampledReturns

    Raises
    ------
    ValueError
        Bad arguments.

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
    >>> sample_returns(mdp, policy, 20_000, horizon=200, seed=6)
    SampledReturns(20000 episodes, 3684503 transitions: mean -197.777, standard error 0.28)
    >>> round(oee.policy_value(mdp, policy, horizon=200), 3)
    -197.914
    """
    _checks.instance(mdp, FiniteMDP, "mdp")
    _checks.one_of(kind, "kind", KINDS)
    _checks.boolean(record, "record")
    n = _checks.positive_integer(n_episodes, "n_episodes")
    pi = check_policy(policy, mdp)
    drawn = draw(
        mdp, pi, n, horizon_length(horizon, mdp), seed=seed, zeta=zeta, record=record
    )
    values = (
        drawn.returns
        if zeta is None
        else drawn.weighted
        if kind == "per_decision"
        else drawn.whole
    )
    log = episode_log(mdp, drawn, pi) if record else None
    return SampledReturns(
        values,
        drawn.returns,
        drawn.weights,
        drawn.lengths,
        drawn.final_state,
        log,
        kind,
    )
