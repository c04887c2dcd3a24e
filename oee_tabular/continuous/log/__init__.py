"""Logs of continuous states: the columns, their files, and their numbering for a task.

``transitions`` has the log itself, and ``lists`` reads vectors in list columns of
parquet. ``numbering`` makes a log's actions the numbers of a task's, in one place for
every caller.
"""
