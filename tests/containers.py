"""Containers of numbers as other libraries make them, without these libraries: what
they have that is looked at.
"""

import narwhals as nw
import numpy as np
import pandas as pd
from pandas.api.extensions import ExtensionArray, ExtensionDtype


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


class Planned:
    """What is computed when it is asked to, like dask's, and to numpy is plain."""

    def __init__(self, result):
        self.result = result

    def __dask_graph__(self):
        return {}

    def compute(self):
        return self.result

    def __array__(self, dtype=None, copy=None):
        return np.array(self.result)

    def __len__(self):
        return len(self.result)


class TypeWithUnit(ExtensionDtype):
    """A type of values with a unit, like that of pint in pandas."""

    type = float
    kind = "f"

    def __init__(self, units="meter", part="units"):
        setattr(self, part, units)

    @property
    def name(self):
        return "with_unit"

    @classmethod
    def construct_array_type(cls):
        return ArrayWithUnit


class ArrayWithUnit(ExtensionArray):
    """An array of pandas whose type has a unit."""

    def __init__(self, values, dtype=None):
        self.values = np.asarray(values, dtype=float)
        self._dtype = dtype or TypeWithUnit()

    dtype = property(lambda self: self._dtype)
    nbytes = property(lambda self: self.values.nbytes)

    @classmethod
    def _from_sequence(cls, scalars, dtype=None, copy=False):
        return cls(scalars, dtype)

    def __len__(self):
        return len(self.values)

    def __getitem__(self, item):
        found = self.values[item]
        return found if np.isscalar(found) else ArrayWithUnit(found, self._dtype)

    def __array__(self, dtype=None, copy=None):
        return np.array(self.values)

    def isna(self):
        return np.isnan(self.values)

    def copy(self):
        return ArrayWithUnit(self.values.copy(), self._dtype)

    def take(self, indices, allow_fill=False, fill_value=None):
        return ArrayWithUnit(self.values.take(indices), self._dtype)


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
        "masked when computed": Planned(masked),
        "list of masked": list(masked) if array.ndim == 1 else [masked[0], *array[1:]],
    }
    if array.ndim == 1:
        found["shuffled"] = pd.Series(array, index=np.arange(n)[::-1])
        found["shuffled when computed"] = Planned(found["shuffled"])
        found["shuffled inside"] = nw.from_native(found["shuffled"], series_only=True)
        found["labels of numbers"] = Named(array, (0,), {0: np.arange(n)[::-1]})
        found["in a type with a unit"] = ArrayWithUnit(array)
        found["series with a unit"] = pd.Series(ArrayWithUnit(array))
        found["list of quantities"] = [Quantity(part) for part in array.tolist()]
        found["missing"] = pd.array([*array[:-1].tolist(), None], dtype="Float64")
    if array.ndim == 2:
        found["dimensions by numbers"] = Named(array, (1, 0))
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
        found["computed"] = Planned(pd.Series(array))
        found["inside"] = nw.from_native(pd.Series(array), series_only=True)
        found["one dimension by a number"] = Named(array, (0,))
        found["list of quantities"] = [Quantity(part, "") for part in array.tolist()]
    if array.ndim == 2:
        found["frame"] = pd.DataFrame(array)
    return found
