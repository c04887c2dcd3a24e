"""``python -m oee_tabular`` is the command ``oee``."""

from __future__ import annotations

import os
import signal
import sys

# nothing else is imported here: what comes before main is not caught

INTERRUPTED = 130  # the exit code of what Ctrl-C ended


def main() -> None:
    """The command; Ctrl-C ends it without a traceback, while it is still importing and
    when it has already ended as well.
    """
    # else whoever started it wants it ignored
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
    """Nothing is to be tidied up."""
    os._exit(INTERRUPTED)


if __name__ == "__main__":
    main()
