"""Whether this process is a fork: it has none of its parent's threads, and a thread pool's library that believes it has.

Imported with the package, before anything can fork: it imports nothing itself.
"""

from __future__ import annotations

import os

_forked = False


def forked() -> bool:
    """Whether this process, or one that it comes from, was forked since the package was imported."""
    return _forked


def _in_child() -> None:
    global _forked
    _forked = True


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_in_child)
