"""A benchmark of estimators of a policy's value in a target environment, on families of shift where the truth is exact."""

from oee_tabular.lab.bench.families import Families, families, garnet_worse
from oee_tabular.lab.bench.families_chains import tandem
from oee_tabular.lab.bench.family import Family
from oee_tabular.lab.bench.league import League, league_of
from oee_tabular.lab.bench.run import run

__all__ = ["Families", "Family", "League", "families", "garnet_worse", "league_of", "run", "tandem"]
