"""The report of policies by a continuous simulator and a log of the target.

``evaluate`` takes four steps: ``prepare`` checks the log and numbers its actions,
``correction.choice`` corrects the simulator, ``rows`` says which rows the report has,
and ``assemble`` computes them. A row is computed by ``rollouts`` (Monte Carlo in a
task), ``sampling`` (importance sampling on the log's own episodes) or ``on_cells`` (a
finite problem). ``simulator`` has the configuration of an evaluation, ``policies``
makes commands probabilities.
"""
