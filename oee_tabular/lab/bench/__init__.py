"""Benchmark of estimators of a policy's value where the truth is exact.

``run`` (and ``oee bench``) measures estimators on families of environment shift. Its
cells are the products of families and sizes of the log; a repetition of a cell is
another seed. They go through the lab's runner. Estimators and families are given by
name, as MODULE:OBJECT or as objects. A ``Family`` is a pair of environments;
``families`` has the package's own by name; ``league_of`` makes the ``League`` of a
run's rows.

==================  ====================================================================
file                what is in it
==================  ====================================================================
``sweep``           ``run``: the plan of a run, its cells, and their league
``command``         ``oee bench``: the same into a folder
``cell``            what is measured on one log
``estimators``      estimators by name, and the two references
``sources``         families by name, as MODULE:OBJECT, mapping or function
``family``          ``Family``, a pair of environments with a policy
``families``        the package's families by name; ``families_...`` make them
``shift``           what most families are: two models that differ in parameters
``laws``            distributions that transitions are made of
``mapping``         ``Families``, which makes a family when it is looked up
``league``          the summary of a run's rows: cells, league, page and pictures
``improvement``     another league: what ``oee.improve`` deploys
==================  ====================================================================
"""

from oee_tabular.lab.bench.families import families
from oee_tabular.lab.bench.families_garnets import garnet_worse
from oee_tabular.lab.bench.families_stocks import tandem
from oee_tabular.lab.bench.family import Family
from oee_tabular.lab.bench.league import League, league_of
from oee_tabular.lab.bench.mapping import Families
from oee_tabular.lab.bench.sweep import run

__all__ = [
    "Families",
    "Family",
    "League",
    "families",
    "garnet_worse",
    "league_of",
    "run",
    "tandem",
]
