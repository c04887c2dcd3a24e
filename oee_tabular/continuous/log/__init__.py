"""Logs of continuous states: the columns, and their numbering for a task.

``transitions`` has the log itself. ``numbered`` makes its actions the numbers of a
task's, in one place for every caller.
"""
