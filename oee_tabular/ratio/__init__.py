"""Convex risk minimisation: density ratios (beta) and transition ratios (zeta), each with a duality gap."""

from oee_tabular.ratio.conditional import Conditional
from oee_tabular.ratio.density import RatioFit, density_ratio
from oee_tabular.ratio.features import action_displacement, gaussian
from oee_tabular.ratio.joint import Joint
from oee_tabular.ratio.linear import InClass
from oee_tabular.ratio.method import Method
from oee_tabular.ratio.network import Network
from oee_tabular.ratio.quotient import Quotient
from oee_tabular.ratio.result import TransitionRatio
from oee_tabular.ratio.sgd import Sgd, SgdTrace
from oee_tabular.ratio.support import Assumptions, check_assumptions, refuse_unsupported, uncovered_share
from oee_tabular.ratio.ties import Tied
from oee_tabular.ratio.transition import transition_ratio, true_ratio

__all__ = [
    "Assumptions",
    "Conditional",
    "InClass",
    "Joint",
    "Method",
    "Network",
    "Quotient",
    "RatioFit",
    "Sgd",
    "SgdTrace",
    "Tied",
    "TransitionRatio",
    "action_displacement",
    "check_assumptions",
    "density_ratio",
    "gaussian",
    "refuse_unsupported",
    "transition_ratio",
    "true_ratio",
    "uncovered_share",
]
