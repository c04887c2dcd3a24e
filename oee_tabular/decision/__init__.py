"""Which policy to deploy: a certified gain over the one that runs, or what to record.

Given a simulator, a log of the target and the policy that runs there, ``improve`` makes
candidates (``candidates``) and bounds the gain of each from below
(``inference.gain``). What it finds is an ``Improvement`` (``improvement``), whose
tables, page and JSON are views of it (``views``). A log in two parts (``splitting``)
certifies also policies that were made from its own counts.
"""

from __future__ import annotations

from oee_tabular.decision.deciding import improve
from oee_tabular.decision.improvement import Candidate, Improvement
from oee_tabular.decision.views import render_page as render_page

__all__ = ["Candidate", "Improvement", "improve"]
