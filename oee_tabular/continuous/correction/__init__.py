"""A simulator corrected by a log of the target.

``choice`` chooses among the corrections by their error on held-out episodes:

- ``residual`` adds to the simulator's step what the log's residuals show, a smooth
  function (``regression``) and a scatter (``scatter``), between the ``stops``;
- ``parameters`` fits numbers of the simulator first, such as gravity;
- ``history`` keeps the last actions in the state, where ``hidden_state`` finds that
  they matter.

``units`` finds columns in other units, ``linear_model`` is a model learned from the log
alone, ``sentences`` says in a report what was found.
"""
