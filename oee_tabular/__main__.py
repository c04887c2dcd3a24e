"""The command ``oee``, started by ``python -m oee_tabular``."""

from __future__ import annotations

import os
import signal
import sys

# nothing else is imported here, because Ctrl-C during these imports is not caught

INTERRUPTED = 130  # the shell's exit code of a process that Ctrl-C ended


def main() -> None:
    """Run the command; Ctrl-C ends it without a traceback at any time.

    This includes the time in which it imports, and the time after its end.
    """
    # with another handler, whoever started the command wants Ctrl-C ignored
    handled = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if handled:
        signal.signal(signal.SIGINT, _leave)
    from oee_tabular.cli import main as command

    try:
        if handled:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        command()
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
    finally:
        if handled:
            signal.signal(signal.SIGINT, _leave)


def _leave(*_: object) -> None:
    """End the process at once, because there is nothing to clean up."""
    os._exit(INTERRUPTED)


if __name__ == "__main__":
    main()
