"""The prior of a row-by-row fit: what the frequencies of each row are mixed with.

``Conditional`` replaces the frequencies n_x / n of a row by (n_x + kappa m_x) / (n +
kappa): m is a distribution on the simulator's entries, and kappa is the number of
transitions that it is worth. Any object with ``uses`` and ``fit_rows`` can say what m
and kappa are. ``NoPrior``, kappa = 0, is the paper; ``oee_tabular.shrinkage`` has the
prior of the default.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, Protocol, TypeAlias, runtime_checkable

import numpy as np

from oee_tabular import _checks
from oee_tabular._results import checked
from oee_tabular.mdp import Rows
from oee_tabular.typing import Array

if TYPE_CHECKING:
    from oee_tabular.ratio.method import RatioInput

PriorName: TypeAlias = Literal["ridge", "tilt", "simulator", "none"]
Criterion: TypeAlias = Literal["evidence", "loo"]


class FittedRows:
    """Base of rows m that were fitted to the log by parameters theta (A, d), theta_0 +
    theta_a of each action.

    ``gap`` is the certificate of theta, in nats.
    """

    gap: float

    @property
    def is_finite(self) -> bool:
        """Return whether theta and its precision are finite numbers."""
        raise NotImplementedError

    def at(self, rows: Rows) -> Array:
        """Return m on the entries of these rows."""
        raise NotImplementedError

    def pull(self, rows: Rows, values: Array) -> Array:
        """Sum values_x d log m_x / d theta over each action's rows, (A, d)."""
        raise NotImplementedError

    def variance(self, pull: Array) -> float:
        """Compute the variance of a value from its derivative in theta, (A, d)."""
        raise NotImplementedError


@checked(shapes={"kappa": "r"})
@dataclass(frozen=True, eq=False)
class PriorRows:
    """The prior of every row, as ``Conditional`` uses it.

    Attributes
    ----------
    kappa : ndarray of shape (rows,)
        The number of transitions that each row of the prior is worth.
    fitted : FittedRows or None
        The rows m, with the certificate and the variance of their parameters; None
        means the simulator's own.
    details : mapping
        What the prior has to say about its fit, for ``TransitionRatio.details``.

    Examples
    --------
    >>> PriorRows(np.array([3.0, 3.0])).fitted is None
    True
    """

    kappa: Array
    fitted: FittedRows | None = None
    details: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check that each strength is a finite number of at least 0."""
        _checks.require_nonnegative(self.kappa, "kappa")


@runtime_checkable
class Prior(Protocol):
    """What each row's frequencies are mixed with: an object that fits rows and kappa.

    See Also
    --------
    Conditional : The program that uses a prior.
    NoPrior : The paper has none.
    oee_tabular.shrinkage.Shrinkage : The prior of the default.

    Examples
    --------
    A prior of one's own, the simulator's rows worth as much as what was recorded:

    >>> import oee_tabular as oee
    >>> class Even:
    ...     uses = frozenset()
    ...
    ...     def fit_rows(self, given, *, solver):
    ...         return PriorRows(given.rows.sums(given.observed))
    >>> simulator = oee.FiniteMDP([[[0.5, 0.5]]] * 2, [0, 1], [0.5, 0.5], 0.5)
    >>> log = oee.Transitions([0, 0], [0, 0], [1, 1])
    >>> oee.ratio.Conditional(Even()).fit(log, simulator).values.data.tolist()
    [0.5, 1.5, 1.0, 1.0]
    """

    @property
    def uses(self) -> frozenset[str]:
        """Return which of ``values_of`` and ``horizon`` change the rows."""
        ...

    def fit_rows(self, given: RatioInput, *, solver: str) -> PriorRows:
        """Fit the rows and their strengths to checked data.

        Parameters
        ----------
        given : RatioInput
            The counts on the simulator's entries, and the policies that matter.
        solver : str
            'dual', or the name of a cvxpy solver.

        Returns
        -------
        PriorRows
            The rows m, the strengths kappa and what there is to say about them.
        """
        ...


@dataclass(frozen=True)
class NoPrior:
    """No prior, as in the paper: each recorded row has its own frequencies.

    See Also
    --------
    oee_tabular.shrinkage.Shrinkage : The prior of the default.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator = oee.FiniteMDP([[[0.5, 0.5]]] * 2, [0, 1], [0.5, 0.5], 0.5)
    >>> log = oee.Transitions([0, 0], [0, 0], [1, 1])
    >>> oee.ratio.Conditional(NoPrior()).fit(log, simulator).values.data.tolist()
    [0.0, 2.0, 1.0, 1.0]
    """

    @property
    def uses(self) -> frozenset[str]:
        """Return the inputs that change the rows: none."""
        return frozenset()

    def fit_rows(self, given: RatioInput, *, solver: str) -> PriorRows:
        """Return a strength of 0 for each row.

        Parameters
        ----------
        given : RatioInput
            The counts on the simulator's entries.
        solver : str
            Is not used.

        Returns
        -------
        PriorRows
            The simulator's rows with kappa = 0.
        """
        details = {"prior": "none", "strength": 0.0}
        return PriorRows(np.zeros(len(given.rows)), None, details)
