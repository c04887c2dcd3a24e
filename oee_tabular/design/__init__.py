"""What to record next: the (s, a), or the behaviour policy, that tell most about the policies' values."""

from oee_tabular.design.collection import plan_data_collection
from oee_tabular.design.plan import Outlook, Plan

__all__ = ["Outlook", "Plan", "plan_data_collection"]
