"""A benchmark of estimators of a policy's value in a target environment, on families of shift where the truth is exact."""

from oee_tabular.bench.families import families
from oee_tabular.bench.families_garnet import garnet_worse
from oee_tabular.bench.families_stock import tandem
from oee_tabular.bench.family import Family

__all__ = ["Family", "families", "garnet_worse", "tandem"]
