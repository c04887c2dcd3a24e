"""The field's measures of selection: how well estimates rank policies.

Source: T. Voloshin et al., Empirical study of off-policy policy evaluation, 2021; J. Fu et al., Benchmarks for
deep off-policy evaluation, ICLR 2021 (regret@k, rank correlation).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from oee_tabular import _checks


@dataclass(frozen=True)
class Selection:
    """How well estimated values choose among policies whose true values are known.

    Attributes
    ----------
    rank_correlation : Spearman's; 1: the same order
    regret : what the best of the k policies ranked first falls short of the best of all, divided by the range of true
        values if that is not 0
    absolute_error : the mean |estimate - truth|, units of J

    Examples
    --------
    >>> round(selection_measures([3.0, 2.0, 1.0], [2.0, 3.0, 0.0]).regret, 4)  # 2 chosen, 3 is best, of 0 to 3
    0.3333
    """

    rank_correlation: float
    regret: float
    absolute_error: float


def selection_measures(estimates: ArrayLike, truths: ArrayLike, *, k: int = 1) -> Selection:
    """Spearman's rank correlation, regret@k (a share of the range of true values) and mean absolute error.

    Parameters
    ----------
    estimates, truths : of one length, at least 2; finite
    k : positive int, at most their number: of how many ranked first the best is taken

    Examples
    --------
    >>> selection_measures([3.0, 2.0, 1.0], [2.0, 3.0, 0.0])
    Selection(rank_correlation=0.5, regret=0.3333333333333333, absolute_error=1.0)
    """
    guess = _checks.float_array(estimates, "estimates", ndim=1)
    truth = _checks.float_array(truths, "truths", ndim=1)
    if guess.shape != truth.shape or len(guess) < 2:
        raise ValueError(
            f"estimates and truths must have one length of at least 2; they have {len(guess)} and {len(truth)}"
        )
    for array, name in ((guess, "estimates"), (truth, "truths")):
        _checks.require_finite(array, name)
    number = _checks.positive_integer(k, "k")
    if number > len(guess):
        raise ValueError(f"k must be at most the number of policies, {len(guess)}; it is {number}")
    flat = np.ptp(guess) == 0 or np.ptp(truth) == 0
    from scipy import stats  # a quarter of a second

    correlation = float("nan") if flat else float(stats.spearmanr(guess, truth).statistic)
    chosen = np.argsort(-guess, kind="stable")[:number]
    short = float(truth.max() - truth[chosen].max())
    width = float(np.ptp(truth))
    return Selection(correlation, short / width if width > 0 else 0.0, float(np.abs(guess - truth).mean()))
