"""The prior of a target's rows: a distribution m(s' | s, a) and its strength kappa.

For each state-action pair (s, a) with counts n_x, x = s', the target's row is a priori
Dirichlet(kappa m), and

    zeta P = (n_x + kappa m_x) / (n_sa + kappa)

is its posterior mean: m where the log has nothing, the frequencies where it has much.
kappa is the number of transitions that m is worth.

::

    directions  d functions phi(s, a, s') made from the simulator, the policies and
                the user's features, in groups
    ridge       m proportional to P exp((theta_0 + theta_a) . phi): theta by the KL
                risk of the counts and a Gaussian penalty, one strength lambda a group
                by evidence; the certificate of f, and the posterior variance of theta
    strength    kappa of each kind of rows by the marginal likelihood of its counts, or
                by leave-one-out
    _ridge      the loops of the first two

Everything is convex given lambda and kappa;
both are found by evidence, the simulator's and then the tilt's. Shapes: counts, P, m
(entries,) on the simulator's entries; theta (1 + A, d); kappa (rows,).
"""

from oee_tabular.shrinkage.prior import Shrinkage
from oee_tabular.shrinkage.threshold import SoftThreshold
from oee_tabular.shrinkage.transition import transition_ratio

__all__ = ["Shrinkage", "SoftThreshold", "transition_ratio"]
