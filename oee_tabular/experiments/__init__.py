"""The paper's experiments and more as data: ids with settings, a runner, tables and figures (``oee reproduce``)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from oee_tabular.experiments.common import Embedded, embedded_default
from oee_tabular.experiments.paper import curve as published

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["Embedded", "embedded_default", "published", "table"]


def table(name: str, *, repetitions: int = 1, seed: int = 0, **axes: object) -> pd.DataFrame:
    """Some cells of an experiment, computed here and now: the rows that ``oee reproduce`` gives for them.

    Parameters
    ----------
    name : the experiment's id, as ``oee reproduce --list`` has it
    repetitions : logs of each cell, numbered from 0
    seed : of all random numbers
    axes : settings by name, a value or several; those not named in full

    Raises
    ------
    ValueError
        An id or an axis that is not there.

    Examples
    --------
    >>> table("estimands", delta=0.5).quantity.tolist()[:2]
    ['true, r(s_t+1)', "OEE's, r(s_t)"]
    """
    from oee_tabular.experiments.catalogue import EXPERIMENTS

    return EXPERIMENTS[name].table(repetitions=repetitions, seed=seed, **axes)
