"""Classes of functions for the ratio of two densities: tables, linear, kernel.

An object of this file says what g may be in eq. 3.6 and 3.7 (``density_ratio``): one
number an entry, g = Phi w, or an expansion of a kernel. Networks are in ``network``.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular.exceptions import ArgumentError
from oee_tabular.ratio.features import (
    KernelLike,
    check_kernel,
    count_rank,
    kernel_features,
    standard_gaussian,
)
from oee_tabular.typing import Array, RealArrayLike

# Number of points beyond which a kernel is approximated.
N_CENTERS = 200


@dataclass(frozen=True)
class Table:
    """One parameter an entry: g is any function on the entries of p and q.

    See Also
    --------
    Linear : The class g = Phi w.
    Kernel : The expansions of a kernel.
    density_ratio : The program over a class.

    Examples
    --------
    >>> from oee_tabular.ratio import Table, density_ratio
    >>> density_ratio([3, 1], [2, 2], functions=Table()).ratio.tolist()
    [1.5, 0.5]
    """


@suggest_keywords
@dataclass(frozen=True, eq=False)
class Linear:
    """The class g = Phi w, with w in R^d; the ridge is ridge/2 times w . w.

    Parameters
    ----------
    features : array-like of shape (n,) or (n, d)
        Phi, a row for each entry of p and q.

    Raises
    ------
    ValueError
        If features are not finite numbers, or there are none.

    See Also
    --------
    Kernel : Features that are made from a kernel.
    InClass : The same for ratios of transitions.

    Notes
    -----
    Collinear features are solved, with a warning; ``RatioFit.details`` has their rank.

    Examples
    --------
    >>> from oee_tabular.ratio import Linear, density_ratio
    >>> line = Linear([[1.0, 0.0], [1.0, 1.0], [1.0, 2.0]])
    >>> fit = density_ratio([3, 2, 1], [2, 2, 2], functions=line)
    >>> fit.ratio.round(6).tolist(), fit.weights.round(6).tolist()
    ([1.5, 1.0, 0.5], [1.5, -0.5])
    """

    features: RealArrayLike = field(repr=False)

    def __post_init__(self) -> None:
        """Check that features are finite numbers."""
        array = _checks.float_array(self.features, "features", ndim=(1, 2))
        _checks.require_finite(array, "features")
        if array.size == 0:
            raise ArgumentError(
                "features",
                f"must have a row for each entry of p; they have shape {array.shape}",
            )
        object.__setattr__(self, "features", array)


@suggest_keywords
@dataclass(frozen=True, eq=False)
class Kernel:
    """The expansions of a kernel over the entries; the ridge is on the RKHS norm.

    Parameters
    ----------
    coordinates : array-like of shape (n,) or (n, c)
        The points that the entries of p and q stand for.
    kernel : 'gaussian' or callable, default 'gaussian'
        'gaussian' is in standard deviations of the coordinates; a function takes (m, c)
        and (k, c) points and returns an (m, k) array. ``oee.ratio.gaussian`` makes one
        of a given bandwidth.
    n_centers : int, default 200
        Number of points beyond which the kernel is replaced by its pivoted Cholesky
        approximation.

    Raises
    ------
    ValueError
        If coordinates are not finite numbers, or the kernel is neither.

    See Also
    --------
    Linear : The class of given features.
    InClass : The same for ratios of transitions.

    Notes
    -----
    The objective has ridge/2 times the squared norm of g. ``RatioFit.details`` has the
    centres and the part of the Gram matrix that they leave.

    Examples
    --------
    >>> from oee_tabular.ratio import Kernel, density_ratio
    >>> smooth = Kernel([0.0, 1.0, 2.0])
    >>> fit = density_ratio([3, 2, 1], [2, 2, 2], functions=smooth, ridge=0.1)
    >>> fit.ratio.round(2).tolist()
    [1.34, 1.1, 0.57]
    """

    coordinates: RealArrayLike = field(repr=False)
    kernel: KernelLike = "gaussian"
    n_centers: int = N_CENTERS

    def __post_init__(self) -> None:
        """Check the points, the kernel and the centres."""
        points = _checks.float_array(self.coordinates, "coordinates", ndim=(1, 2))
        _checks.require_finite(points, "coordinates")
        if points.size == 0:
            raise ArgumentError(
                "coordinates",
                f"must have a row for each entry of p; they have shape {points.shape}",
            )
        object.__setattr__(self, "coordinates", points)
        check_kernel(self.kernel)
        _checks.positive_integer(self.n_centers, "n_centers")


FunctionClass: TypeAlias = Table | Linear | Kernel


def check_functions(functions: object) -> None:
    """Raise an error unless this is a class of functions on the entries."""
    if not isinstance(functions, Table | Linear | Kernel):
        raise ArgumentError(
            "functions",
            "must be Table(), Linear(features) or Kernel(coordinates); got"
            f" {_checks.show(functions)}",
        )


def class_features(functions: Linear | Kernel, n: int) -> tuple[Array, dict[str, Any]]:
    """Return the features of n entries, (n, d), and their part of a fit's details.

    Those of a kernel are its pivoted Cholesky factor, whose squared w is the norm.
    """
    if isinstance(functions, Linear):
        features = np.asarray(functions.features)
        _require_rows(features, n, "features")
        features = features.reshape(n, -1)
        return features, {"feature_rank": count_rank(features)}
    points = np.asarray(functions.coordinates)
    _require_rows(points, n, "coordinates")
    points = points.reshape(n, -1)
    kernel = functions.kernel
    function = kernel if callable(kernel) else standard_gaussian(points)
    space = kernel_features(points, function, functions.n_centers)
    return space.matrix, {"kernel_residual": space.residual, "centers": space.pivots}


def _require_rows(array: Array, n: int, name: str) -> None:
    """Raise an error unless there is a row for each of n entries."""
    if len(array) != n:
        raise ArgumentError(
            name,
            f"must have {n} rows, one for each entry of p; they have shape"
            f" {array.shape}",
        )
