"""Tasks with continuous states, and episodes of them.

``base`` says what a task is. ``cartpole`` and ``reacher`` have their dynamics and their
experts; ``kinova`` has the arm and its fitted hand, ``gen3`` what both of them share.
``gymnasium_task`` steps any environment whose state can be set, ``gymnasium_named``
finds one by its name. ``episodes`` records logs and estimates values by Monte Carlo.
"""
