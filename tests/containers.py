"""Containers of numbers as other libraries make them, without these libraries: what
they have that is looked at.
"""

import numpy as np
import pandas as pd


class InUnit(np.ndarray):
    """An array with a unit, like astropy's and unyt's."""

    unit = "m"

    @property
    def value(self):
        return self.view(np.ndarray)


class Quantity:
    """A magnitude with units, like pint's."""

    def __init__(self, magnitude, units="meter"):
        self.magnitude = magnitude
        self.units = units

    def __array__(self, dtype=None, copy=None):
        return np.array(self.magnitude)

    def __float__(self):
        return float(self.magnitude)

    def __len__(self):
        return len(self.magnitude)

    def __iter__(self):
        return (Quantity(part, self.units) for part in self.magnitude)

    def m_as(self, units):
        return self.magnitude


class Named:
    """An array with named dimensions and labels along them, like xarray's."""

    def __init__(self, values, dims, coords=()):
        self.data = np.asarray(values)
        self.dims = dims
        self.coords = dict(coords)
        self.shape = self.data.shape
        self.ndim = self.data.ndim
        self.dtype = self.data.dtype

    def __array__(self, dtype=None, copy=None):
        return np.array(self.data)

    def __len__(self):
        return len(self.data)

    def __iter__(self):
        return iter(self.data)

    def to_dict(self):
        return {"dims": self.dims}


class Lazy:
    """What becomes a masked array when numpy asks for one, like dask's."""

    def __init__(self, masked):
        self.masked = masked

    def __array__(self, dtype=None, copy=None):
        return self.masked


def masked_at_first(array):
    masked = np.ma.array(array, mask=False)
    masked[(0,) * masked.ndim] = np.ma.masked
    return masked


def with_a_loss(value):
    """Name -> the value in a container that says more than position does."""
    if isinstance(value, bool):
        return {}
    if isinstance(value, int | float):
        return {
            "quantity": Quantity(value),
            "masked": np.ma.masked,
            "masked number": np.ma.array(value, mask=True),
        }
    try:
        array = np.array(value)
    except (TypeError, ValueError):
        return {}
    is_array = isinstance(value, np.ndarray | list | tuple)
    if (
        not is_array
        or array.dtype.kind not in "iuf"
        or not array.ndim
        or len(array) < 2
    ):
        return {}
    n = len(array)
    masked = masked_at_first(array)
    dims = tuple("xyzuv"[: array.ndim])
    found = {
        "masked": masked,
        "lazily masked": Lazy(masked),
        "in a unit": array.copy().view(InUnit),
        "quantity": Quantity(array),
        "dimensions": Named(array, dims, {"x": np.arange(n)[::-1]}),
        "list of masked": list(masked) if array.ndim == 1 else [masked[0], *array[1:]],
    }
    if array.ndim == 1:
        found["shuffled"] = pd.Series(array, index=np.arange(n)[::-1])
        found["list of quantities"] = [Quantity(part) for part in array.tolist()]
        found["missing"] = pd.array([*array[:-1].tolist(), None], dtype="Float64")
    if array.ndim == 2:
        found["labelled"] = pd.DataFrame(array, index=[f"r{k}" for k in range(n)])
    return found


def without_a_loss(value):
    """Name -> an array in a container that says no more than position does."""
    array = np.array(value)
    found = {
        "no mask": np.ma.array(array, mask=False),
        "lazy": Lazy(np.ma.array(array)),
        "dimensionless": Quantity(array, "dimensionless"),
        "unnamed dimensions": Named(
            array, tuple(f"dim_{k}" for k in range(array.ndim))
        ),
        "objects": array.astype(object),
    }
    if array.ndim == 1:
        found["series"] = pd.Series(array)
        found["list of quantities"] = [Quantity(part, "") for part in array.tolist()]
    if array.ndim == 2:
        found["frame"] = pd.DataFrame(array)
    return found
