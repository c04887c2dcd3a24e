"""Eq. 4.4: zeta as the quotient of two density ratios, (s, a, s') over (s, a), each by
eq. 3.7.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from oee_tabular import _checks
from oee_tabular.data import Transitions
from oee_tabular.exact import occupancy
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import check_policy
from oee_tabular.ratio.density import RatioFit, density_ratio
from oee_tabular.ratio.dual import check_box
from oee_tabular.ratio.method import Method, RatioInput, SimulatorData
from oee_tabular.ratio.network import Network, check_boxed_network, fit_network
from oee_tabular.ratio.result import TransitionRatio
from oee_tabular.ratio.sgd import Sgd
from oee_tabular.ratio.support import aligned_counts
from oee_tabular.simulate.sampler import episodes_holding
from oee_tabular.typing import Array, IntArray, PolicyLike

# the paper's episodes, where the log does not say how long its own were
_LONGEST_EPISODE = 1000


@dataclass(frozen=True, eq=False)
class Quotient(Method):
    """The paper's zeta: two density ratios, target to simulator, fitted separately, and
    their quotient (eq. 4.4).

        zeta(s, a, s') = beta(s, a, s') / beta(s, a),   each beta = d_te / d_tr by eq. 3.7 (``density_ratio``).

    The rows of zeta * P need not sum to 1; ``row_sum_error`` is the largest difference.

    Parameters
    ----------
    lower, upper : the paper's nu and mu, on each beta (0.01 and 10; ``numpy.inf`` for
        none), so that zeta lies in [lower/upper, upper/lower]
    ridge, toward : lambda_n and its centre, as in ``density_ratio``; toward None is the
        paper's I(g)^2 = sum g^2
    normalized : whether sum beta q = 1 is imposed on each: True (default), or False as
        in the paper
    solver : "dual", a cvxpy solver, or ``Sgd(...)``: Algorithm 1, both tables in turn;
        needs normalized=False
    data : a log of the simulator; None: one of the target log's size is sampled under
        its estimated behaviour policy, with the seed of ``fit``; "exact": the
        simulator's exact occupancy under that policy
    behavior_policy : (S, A), instead of the estimated one
    functions : None (tables: one number a cell), or ``Network(layers, ...)``: each beta
        is a network, trained by Algorithm 1 with the network's own settings; needs
        normalized=False, and solver left out

    Notes
    -----
    Limit: the box-clipped quotient of the exact ratios, whatever the solver or the
    functions. If a transition was recorded on neither side, 0/0, zeta is 1 for tables;
    a network has a value there. ``details["beta"]``: the fits of (s, a, s') and (s, a),
    with the traces of ``Sgd`` or of the network.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator, target = (oee.FiniteMDP([[[1 - p, p]]] * 2, [0, 1], [0.5, 0.5], 0.5) for p in (0.5, 0.6))
    >>> log = oee.sample_transitions(target, [[0.5], [0.5]], 10_000, seed=0)
    >>> fit = Quotient(normalized=False, data="exact").fit(log, simulator)
    >>> fit.values.data.round(1).tolist(), fit.row_sum_error < 0.02
    ([0.8, 1.2, 0.8, 1.2], True)
    """

    lower: float | None = 0.01
    upper: float | None = 10.0
    ridge: float | Callable[[Any], Any] = 0.0
    toward: float | None = 1.0
    normalized: bool = True
    solver: str | Sgd = "dual"
    data: SimulatorData = field(default=None, repr=False)
    behavior_policy: PolicyLike | None = field(default=None, repr=False)
    functions: Network | None = None

    USES: ClassVar = frozenset({"simulator_data", "behavior_policy"})

    @property
    def _name(self) -> str:
        return "ratio_of_ratios"

    def __post_init__(self) -> None:
        _checks.boolean(self.normalized, "normalized")
        if not isinstance(self.solver, str | Sgd):
            raise ArgumentError(
                "solver", f"must be a name or Sgd(...); got {_checks.show(self.solver)}"
            )
        self._refuse_words(self.ridge)
        check_box(self.lower, self.upper, normalized=self.normalized)
        check_simulator_data(self.data)
        if self.functions is not None:
            check_boxed_network(self)

    def _exact(self) -> Quotient:
        solver = "dual" if isinstance(self.solver, Sgd) else self.solver
        return replace(self, solver=solver, data=None, functions=None)

    def _fit(self, given: RatioInput) -> TransitionRatio:
        # one stream: the simulator's data, then the training
        given = replace(given, seed=_checks.generator(given.seed))
        observed = given.observed
        rows = given.rows
        expected = simulator_weights(given, self.data, self.behavior_policy)
        moves = self._beta(
            observed, expected, (rows.spread(rows.number), rows.arrival), given
        )
        pairs = self._beta(
            rows.sums(observed), rows.sums(expected), (rows.number,), given
        )
        below = rows.spread(pairs.ratio)
        undetermined = ((observed == 0) & (expected == 0)) | (below == 0)
        if self.functions is not None:  # a network has a value everywhere
            undetermined[:] = False
        zeta = np.where(
            undetermined, 1.0, moves.ratio / np.where(below > 0, below, 1.0)
        )
        lowest = self.lower or 0.0
        highest = np.inf if self.upper is None else self.upper
        details = {
            "lower": self.lower,
            "upper": self.upper,
            "undetermined_moves": int(undetermined.sum()),
            "share_at_the_box": float(
                np.mean((moves.ratio <= lowest) | (moves.ratio >= highest))
            ),
            "moves_only_in_log": int(((observed > 0) & (expected == 0)).sum()),
            "divergence_moves": moves.divergence,
            "divergence_pairs": pairs.divergence,
            "beta": (moves, pairs),
        }
        gap = max(moves.gap, pairs.gap)
        return given.ratio(zeta, self._name, gap, details)

    def _beta(
        self, p: Array, q: Array, cells: tuple[IntArray, ...], given: RatioInput
    ) -> RatioFit:
        """Eq. 3.7 on the cells, whose columns are the row and, for moves, s'."""
        options: dict[str, Any] = {
            "lower": self.lower,
            "upper": self.upper,
            "ridge": self.ridge,
            "toward": self.toward,
            "seed": given.seed,
        }
        if self.functions is None:
            return density_ratio(
                p, q, normalized=self.normalized, solver=self.solver, **options
            )
        n_actions = given.simulator.n_actions
        columns = (*np.divmod(cells[0], n_actions), *cells[1:])
        return fit_network(
            self.functions,
            p,
            q,
            columns,
            (given.simulator.n_states, n_actions),
            **options,
        )


def check_simulator_data(value: object) -> None:
    """Transitions, "exact" or None."""
    if not (
        value is None
        or isinstance(value, Transitions)
        or (isinstance(value, str) and value == "exact")
    ):
        raise ArgumentError(
            "simulator_data",
            f"must be Transitions, 'exact' or None; got {_checks.show(value)}",
        )


def simulator_weights(
    given: RatioInput, data: SimulatorData, behavior_policy: PolicyLike | None
) -> Array:
    """Counts or probabilities of the simulator's transitions, on its entries; weighted
    by discount^t where one is given.

    ``data`` and ``behavior_policy`` are a method's own; without them those that are
    given, without these the estimates.
    """
    observed = given.observed
    simulator = given.simulator
    discount = given.discount
    simulator_data = given.simulator_data if data is None else data
    check_simulator_data(simulator_data)
    if isinstance(simulator_data, Transitions):
        numbered = simulator_data.numbered(simulator, "simulator_data")
        counts = numbered.counts(
            simulator.n_states, simulator.n_actions, discount=discount
        )
        return aligned_counts(counts, simulator)
    if behavior_policy is not None:
        behavior = check_policy(behavior_policy, simulator, name="behavior_policy")
    elif given.behavior_policy is not None:
        behavior = given.behavior_policy
    else:
        # the share of each action in the counts of its state; uniform in states without
        # counts
        pairs = given.rows.sums(observed).reshape(
            simulator.n_states, simulator.n_actions
        )
        total = pairs.sum(axis=1, keepdims=True)
        behavior = np.where(
            total > 0, pairs / np.maximum(total, 1e-300), 1.0 / simulator.n_actions
        )
    timestep = None if given.log is None else given.log.timestep
    steps = _LONGEST_EPISODE if timestep is None else int(timestep.max()) + 1
    if simulator_data is not None:
        weighted = simulator.with_discount(1.0 if discount is None else discount)
        share = occupancy(weighted, behavior, horizon=steps, of="transition")
        over = given.rows.spread(simulator.absorbing()[given.rows.state])
        # logs stop where an episode is over
        return np.where(over, 0.0, share.data) if not over.all() else share.data
    n = max(round(float(observed.sum())), 1) if given.log is None else len(given.log)
    generator = _checks.generator(given.seed)
    drawn = episodes_holding(simulator, behavior, n, steps, seed=generator).draw(
        n, seed=generator
    )
    return aligned_counts(
        drawn.counts(simulator.n_states, simulator.n_actions, discount=discount),
        simulator,
    )
