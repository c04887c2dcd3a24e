"""The soft threshold: how far a value moves from the corrected simulator to the log.

J(zeta P) has a small error where its prior fits, and is biased where it does not. Two
values of the log are nearly without bias: the one-step value, which is linear in the
log's frequencies, and the maximum-likelihood value. The value moves towards the nearer
one, or further where that is far away, by what the change exceeds lambda standard
errors [1].

Reference: [1] T. Armstrong, P. Kline and L. Sun, Adapting to misspecification, arXiv
2305.14265.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

# Minimax-regret soft thresholds for x ~ N(b, s^2) beside a second estimate whose bias
# is b: by s^2 over the variance of that estimate, in standard deviations s [1],
# interpolated in the logarithm of the ratio; the first, below 1, is a guess.
VARIANCE_RATIOS = (0.3, 1.0, 5.0, 10.0, 30.0, 100.0)
THRESHOLDS = (0.55, 0.73, 0.98, 1.12, 1.38, 1.70)
# how far the change towards the log goes, in multiples of the smaller of two changes
MAX_LENGTHENING = 2.0


class Move(NamedTuple):
    """A move of a value towards the log.

    ``amount`` is added to the value; ``share`` is the part of the whole change that it
    is, and ``distance`` is the whole change in standard errors of the difference.
    """

    amount: float
    share: float
    distance: float


@dataclass(frozen=True)
class SoftThreshold:
    """The default's third step: move a value towards the log that contradicts it.

    ``OffEnvironment(adjust=SoftThreshold())`` has the value ::

        J(zeta P) + sign(change) max(0, |change| - lambda s),

    with s the standard error of the difference of the log's value and J(zeta P). It has
    no options: lambda follows from the two standard errors.

    See Also
    --------
    Shrinkage : The default's first step, the prior of zeta.
    oee_tabular.estimators.OffEnvironment : The estimator; adjust=None leaves this out.

    Notes
    -----
    lambda is the minimax-regret threshold of Armstrong, Kline and Sun (arXiv
    2305.14265): the largest regret over all biases of the prior is as small as a soft
    threshold can make it. It is a choice and no theorem that the change goes to the
    nearer of two values, and how it is lengthened (``change_to_log``).

    Examples
    --------
    >>> move = SoftThreshold().move(one_step=3.0, likelihood=3.5, s=1.0, se_fit=0.5)
    >>> round(move.amount, 2), round(move.share, 2)
    (2.3, 0.71)
    """

    def move(
        self, *, one_step: float, likelihood: float, s: float, se_fit: float
    ) -> Move:
        """Compute how far the value moves.

        Parameters
        ----------
        one_step : float
            The one-step value less J(zeta P).
        likelihood : float
            The maximum-likelihood value less J(zeta P).
        s : float
            The standard error of the difference of the log's value and J(zeta P).
        se_fit : float
            The standard error of J(zeta P) if its prior fits.

        Returns
        -------
        Move
            The amount in the value's unit, the share of the change, and the change in
            units of ``s``.
        """
        change = change_to_log(one_step, likelihood, s)
        rest = min(abs(change), threshold(s, se_fit) * s)
        share = 1.0 - rest / abs(change) if change else 0.0
        distance = abs(change) / s if s > 0 else 0.0
        return Move(share * change, share, distance)


def threshold(s: float, se_fit: float) -> float:
    """Compute lambda of the soft threshold, in standard errors ``s``.

    ``s`` is the standard error of the difference of the two values, ``se_fit`` that of
    zeta * P if its prior fits; lambda depends on their ratio: the more the prior can
    gain, the more evidence the log needs against it.
    """
    if not se_fit > 0.0:
        return THRESHOLDS[-1]
    logs = np.log(VARIANCE_RATIOS)
    return float(np.interp(2.0 * np.log(max(s / se_fit, 1e-300)), logs, THRESHOLDS))


def change_to_log(one_step: float, likelihood: float, s: float) -> float:
    """Compute the change towards the log, from the changes to two values of it.

    It is the smaller of the two, and 0 if they have different signs. If the smaller is
    2 to 4 times ``s``, the standard error of the difference, the change goes partly to
    the maximum-likelihood value; beyond that, all the way, but never further than
    ``MAX_LENGTHENING`` times the smaller. Where one value is a linearisation of the
    other and they are further apart than that, neither is near the truth: in a log with
    few transitions, the maximum-likelihood model may never leave a state that was
    recorded once.
    """
    if one_step * likelihood <= 0:
        return 0.0
    nearer = min(one_step, likelihood, key=abs)
    distance = abs(nearer) / s if s > 0 else np.inf
    share = float(np.clip((distance - 2.0) / 2.0, 0.0, 1.0))
    change = nearer + share * (likelihood - nearer)
    limit = MAX_LENGTHENING * abs(nearer)
    return float(np.clip(change, -limit, limit))
