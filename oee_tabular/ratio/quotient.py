"""The paper's ratio: a quotient of two density ratios (eq. 4.4), each by eq. 3.7."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular.data import Transitions
from oee_tabular.exact import occupancy
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import check_policy, uniform_policy
from oee_tabular.ratio.density import RatioFit, density_ratio
from oee_tabular.ratio.dual import check_box, check_ridge
from oee_tabular.ratio.method import Method, RatioInput, SimulatorData
from oee_tabular.ratio.network import Network, check_boxed_network, fit_network
from oee_tabular.ratio.result import TransitionRatio
from oee_tabular.ratio.sgd import Sgd
from oee_tabular.ratio.support import aligned_counts
from oee_tabular.simulate import episodes_holding
from oee_tabular.typing import Array, IntArray, PolicyLike

# The number of steps of the paper's episodes, for logs that do not say how long theirs
# were.
_DEFAULT_EPISODE_STEPS = 1000


@suggest_keywords
@dataclass(frozen=True, eq=False)
class Quotient(Method):
    """The paper's ratio: two density ratios, fitted separately, and their quotient.

        zeta(s, a, s') = beta(s, a, s') / beta(s, a)     (eq. 4.4),

    each beta = d_te / d_tr by eq. 3.7 (``density_ratio``). The rows of zeta * P need
    not sum to 1; ``row_sum_error`` is the largest difference.

    Parameters
    ----------
    lower : float, default 0.01
        The paper's nu, on each beta, so that zeta is at least lower/upper. None means
        0.
    upper : float, default 10.0
        The paper's mu, on each beta, so that zeta is at most upper/lower. None or
        ``numpy.inf`` means no bound.
    ridge : float or callable, default 0.0
        The ridge lambda_n, as in ``density_ratio``.
    toward : float or None, default 1.0
        The number that the ridge pulls each beta to, as in ``density_ratio``. None
        means the paper's I(g)^2 = sum g^2.
    normalized : bool, default True
        Whether sum beta q = 1 is imposed on each; False as in the paper.
    solver : str or Sgd, default 'dual'
        'dual' (exact), the name of a cvxpy solver, or ``Sgd(...)``: Algorithm 1 on
        one table, then on the other, which needs normalized=False.
    data : Transitions or 'exact', optional
        Data of the simulator. None samples a log of the target log's size under its
        estimated behaviour policy, with the seed of ``fit``; 'exact' is the simulator's
        exact occupancy under that policy.
    behavior_policy : (S, A) policy, optional
        Behaviour policy of the simulator's data, instead of the estimated one.
    functions : Network, optional
        The class of functions. None means tables: one number a cell.
        ``Network(layers, ...)``: each beta is a network, trained by Algorithm 1 with
        the network's own settings; it needs normalized=False, and solver left out.

    See Also
    --------
    Joint : Both ratios in one program, whose rows sum to 1.

    Notes
    -----
    Limit: the box-clipped quotient of the exact ratios, whatever the solver or the
    functions. If a transition was recorded on neither side, 0/0, zeta is 1 for tables;
    a network has a value there. ``details["beta"]``: the fits of (s, a, s') and (s, a),
    with the traces of ``Sgd`` or of the network.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator, target = (
    ...     oee.FiniteMDP([[[1 - p, p]]] * 2, [0, 1], [0.5, 0.5], 0.5)
    ...     for p in (0.5, 0.6)
    ... )
    >>> log = oee.sample_transitions(target, [[0.5], [0.5]], 10_000, seed=0)
    >>> fit = Quotient(normalized=False, data="exact").fit(log, simulator)
    >>> fit.values.data.round(1).tolist(), fit.row_sum_error < 0.02
    ([0.8, 1.2, 0.8, 1.2], True)
    """

    lower: float | None = 0.01
    upper: float | None = 10.0
    ridge: float | Callable[[float], float] = 0.0
    toward: float | None = 1.0
    normalized: bool = True
    solver: str | Sgd = "dual"
    data: SimulatorData = field(default=None, repr=False)
    behavior_policy: PolicyLike | None = field(default=None, repr=False)
    functions: Network | None = None

    USES: ClassVar = frozenset({"simulator_data", "behavior_policy"})

    @property
    def _name(self) -> str:
        """Return the method's name in errors and results."""
        return "ratio_of_ratios"

    def __post_init__(self) -> None:
        """Check the method's options."""
        _checks.boolean(self.normalized, "normalized")
        if not isinstance(self.solver, str | Sgd):
            raise ArgumentError(
                "solver", f"must be a name or Sgd(...); got {_checks.show(self.solver)}"
            )
        self._refuse_words(self.ridge)
        if not callable(self.ridge):
            check_ridge(self.ridge, 1.0)
        check_box(self.lower, self.upper, normalized=self.normalized)
        check_simulator_data(self.data)
        if self.functions is not None:
            check_boxed_network(self)

    def _exact(self) -> Quotient:
        """Return this method with the simulator's exact data and without training."""
        solver = "dual" if isinstance(self.solver, Sgd) else self.solver
        return replace(self, solver=solver, data=None, functions=None)

    def _fit(self, given: RatioInput) -> TransitionRatio:
        """Fit both density ratios and take their quotient."""
        # One stream of random numbers: the simulator's data, then the training.
        given = replace(given, seed=_checks.generator(given.seed))
        observed = given.observed
        rows = given.rows
        expected = simulator_weights(given, self.data, self.behavior_policy)
        cells = (rows.spread(rows.number), rows.arrival)
        transitions = self._beta(observed, expected, cells, given)
        observed_pairs = rows.sums(observed)
        expected_pairs = rows.sums(expected)
        pairs = self._beta(observed_pairs, expected_pairs, (rows.number,), given)
        below = rows.spread(pairs.ratio)
        undetermined = ((observed == 0) & (expected == 0)) | (below == 0)
        if self.functions is not None:
            # A network has a value everywhere.
            undetermined[:] = False
        quotient = transitions.ratio / np.where(below > 0, below, 1.0)
        zeta = np.where(undetermined, 1.0, quotient)
        lowest = self.lower or 0.0
        highest = np.inf if self.upper is None else self.upper
        at_the_box = (transitions.ratio <= lowest) | (transitions.ratio >= highest)
        details = {
            "lower": self.lower,
            "upper": self.upper,
            "undetermined_moves": int(undetermined.sum()),
            "share_at_the_box": float(np.mean(at_the_box)),
            "moves_only_in_log": int(((observed > 0) & (expected == 0)).sum()),
            "divergence_moves": transitions.divergence,
            "divergence_pairs": pairs.divergence,
            "beta": (transitions, pairs),
        }
        gap = max(transitions.gap, pairs.gap)
        return given.ratio(zeta, self._name, gap, details)

    def _beta(
        self, p: Array, q: Array, cells: tuple[IntArray, ...], given: RatioInput
    ) -> RatioFit:
        """Solve eq. 3.7 on cells whose columns are the row and, of transitions, s'."""
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
        sizes = (given.simulator.n_states, n_actions)
        return fit_network(self.functions, p, q, columns, sizes, **options)


def check_simulator_data(value: object) -> None:
    """Raise an error unless the value is Transitions, "exact" or None."""
    is_word = isinstance(value, str) and value == "exact"
    if value is not None and not isinstance(value, Transitions) and not is_word:
        raise ArgumentError(
            "simulator_data",
            f"must be Transitions, 'exact' or None; got {_checks.show(value)}",
        )


def simulator_weights(
    given: RatioInput, data: SimulatorData, behavior_policy: PolicyLike | None
) -> Array:
    """Return counts or probabilities of the simulator's transitions, on its entries.

    They are weighted by discount^t where a discount is given. ``data`` and
    ``behavior_policy`` are a method's own; without them the inputs of ``fit`` are used,
    and without these the estimates.
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
        # The share of each action in the counts of its state; uniform in states without
        # counts.
        pairs = given.rows.sums(observed).reshape(
            simulator.n_states, simulator.n_actions
        )
        total = pairs.sum(axis=1, keepdims=True)
        behavior = np.where(
            total > 0, pairs / np.maximum(total, 1e-300), uniform_policy(simulator)
        )
    timestep = None if given.log is None else given.log.timestep
    steps = _DEFAULT_EPISODE_STEPS if timestep is None else int(timestep.max()) + 1
    if simulator_data is not None:
        weighted = simulator.with_discount(1.0 if discount is None else discount)
        share = occupancy(weighted, behavior, horizon=steps, of="transition")
        terminal = given.rows.spread(simulator.absorbing()[given.rows.state])
        # Logs stop in terminal states, unless all episodes start there.
        going = np.where(terminal, 0.0, share.data)
        return going if going.any() else share.data
    n = max(round(float(observed.sum())), 1) if given.log is None else len(given.log)
    generator = _checks.generator(given.seed)
    drawn = episodes_holding(simulator, behavior, n, steps, seed=generator).draw(
        n, seed=generator
    )
    return aligned_counts(
        drawn.counts(simulator.n_states, simulator.n_actions, discount=discount),
        simulator,
    )
