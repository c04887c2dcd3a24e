"""The exact ratio of two models' transition probabilities (eq. 4.3)."""

from __future__ import annotations

from oee_tabular._sparse import align
from oee_tabular.mdp import FiniteMDP, Rows
from oee_tabular.ratio.method import RatioInput
from oee_tabular.ratio.result import TransitionRatio
from oee_tabular.ratio.support import refuse_unsupported, require_pair


def true_ratio(target: FiniteMDP, simulator: FiniteMDP) -> TransitionRatio:
    """Compute zeta = P_target / P_simulator on the simulator's support (eq. 4.3).

    Parameters
    ----------
    target : FiniteMDP
        The model whose transition probabilities stand in the numerator.
    simulator : FiniteMDP
        The model whose transition probabilities stand in the denominator, of the same
        states and actions.

    Returns
    -------
    TransitionRatio
        The exact ratio on the simulator's transitions, with a gap of 0.

    Raises
    ------
    ValueError
        If the target has transitions to which the simulator gives probability 0; the
        most frequent are named.

    See Also
    --------
    transition_ratio : The ratio from a log of the target.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator, target = (
    ...     oee.FiniteMDP([[[1 - p, p]]] * 2, [0, 1], [0.5, 0.5], 0.5)
    ...     for p in (0.5, 0.6)
    ... )
    >>> true_ratio(target, simulator).values.toarray().round(6).tolist()
    [[0.8, 1.2], [0.8, 1.2]]
    """
    require_pair(target, simulator)
    refuse_unsupported(target.transitions, simulator, what="target")
    data, _ = align(target.transitions, simulator.transitions)
    return RatioInput(data, simulator, Rows.of(simulator)).ratio(
        data / simulator.transitions.data, "true", 0.0, {}
    )
