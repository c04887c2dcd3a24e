"""The default, apart from the paper: a prior for zeta, and a move towards the log.

``oee_tabular.ratio`` has the paper's programs. With few transitions their solution, the
log's frequencies, has a large variance. What this package does about it by default is
on this page, and only here. ``OffEnvironment()`` has the prior and the move,
``OffEnvironment(adjust=None)`` the prior alone, ``OffEnvironment.paper()`` neither.

The model
---------
For each state-action pair (s, a) with counts n_x, x = s', the target's row is a priori
Dirichlet(kappa m), and

    zeta P = (n_x + kappa m_x) / (n_sa + kappa)

is its posterior mean: m where the log has nothing, the frequencies where it has much.
kappa is the number of transitions that m is worth. m is the simulator's row, tilted:

    m proportional to P exp((theta_0 + theta_a) . phi(s, a, x)),
    theta_gj s_gj ~ N(0, 1 / lambda_g),

phi the directions in which targets differ from simulators, theta shared by all rows,
and one strength lambda_g a group of directions.

The estimator
-------------
::

    1. prior     theta at the least KL risk of the counts with the Gaussian penalty;
                 lambda_g by evidence; then kappa by evidence, one for each kind of rows
    2. zeta      the paper's program in each row (``ratio.Conditional``), whose
                 frequencies are mixed with kappa m
    3. value     J(zeta P), moved towards the log where the log contradicts it by more
                 than a threshold, in standard errors of the difference
    4. interval  the likelihood interval around the rows zeta P, which
                 ``report.uncertainty`` chooses; the estimator's own interval is the
                 one-step value's

Everything is convex given the strengths lambda_g and kappa.

Where to find it
----------------
::

    prior       Shrinkage: m and kappa of each row; an object for ``Conditional``
    directions  phi, made from the simulator, the policies and the user's features
    ridge       the tilt: theta, its certificate and its posterior variance
    newton      the least of the tilt's risk, and the strengths lambda_g
    strength    kappa by the marginal likelihood of the counts, or by leave-one-out
    threshold   SoftThreshold: how far the value moves
    transition  transition_ratio, whose default shrinks
    _ridge      the loops over entries

Shapes: counts, P, m (entries,) on the simulator's entries; theta (1 + A, d), theta_0
first; kappa (rows,).

What each part buys
-------------------
::

                                        simulator wrong            simulator right
                                        error   worst   covers     error   covers
    no prior (maximum likelihood)       1.06    3.0     94%        1.21    83%
    the simulator as prior, kappa = 10  1.79    6.7     72%        1.03    92%
    the simulator as prior              3.54    35.3    50%        0.08    100%
    tilt along log P                    2.72    34.9    62%        0.27    100%
    tilt along all directions           0.97    6.4     93%        0.66    96%
    the simulator as prior, moved       1.10    2.1     89%        0.16    100%
    the default                         0.88    1.6     96%        0.74    96%

Root mean square error in efficient standard errors (mean over families, and the worst
of them), and the share of 95% intervals that contain the target's value; 57 and 4
families, 30 transitions per stochastic pair. ``python tests/benchmarks/ablation.py``
makes the table; ``notebooks/results/ablation`` has it with standard errors and for 3
transitions. The simulator alone as prior is the best where it is right, and 35
efficient standard errors off in the worst family where it is wrong. The directions
carry what is wrong over from pair to pair. The move costs little and bounds the worst
family.

References
----------
Dirichlet strengths by evidence: T. P. Minka, Estimating a Dirichlet distribution, 2000.
The tilt: B. Efron and R. Tibshirani, Using specially designed exponential families for
density estimation, Annals of Statistics 24(6), 1996. Its strengths: D. J. C. MacKay,
Bayesian interpolation, Neural Computation 4(3), 1992. The threshold: T. Armstrong, P.
Kline and L. Sun, Adapting to misspecification, arXiv 2305.14265.

Choices and theorems
--------------------
These are theorems: as the log grows, zeta P is the target's row wherever the log has
data, whatever the prior; the penalised risk is convex, and its gap is certified; of all
soft thresholds the tabulated lambda has the least largest regret, for two normal
estimates of which one is unbiased (below a variance ratio of 1 it is a guess). These
are choices, measured on the families of the
bench: which directions there are, that kappa is shared by rows with equal simulator
probabilities and is at least 1, the hyperprior of lambda_g, to which of two values of
the log the value moves and how it is lengthened. No choice can keep up with a simulator
that is right by luck: the gain of step 1 comes from targets along the directions, and
step 3 bounds what it costs elsewhere.
"""

from oee_tabular.shrinkage.prior import Shrinkage
from oee_tabular.shrinkage.threshold import SoftThreshold
from oee_tabular.shrinkage.transition import transition_ratio

__all__ = ["Shrinkage", "SoftThreshold", "transition_ratio"]
