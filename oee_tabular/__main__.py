"""The command ``oee``, started by ``python -m oee_tabular``."""

# Python has imported these two already, or has them built in
import os
import sys

if __name__ == "__main__":
    # "python -m" puts the current folder first, where a signal.py or a numpy.py would
    # take the place of the installed module
    try:
        _current = os.getcwd()
    except OSError:  # the folder was removed
        _current = ""
    if sys.path[:1] in ([""], [_current]):
        _first = sys.path.pop(0)
        if os.path.dirname(os.path.dirname(os.path.abspath(__file__))) == _current:
            sys.path.append(_first)  # the package itself is there

# nothing else is imported here, because Ctrl-C during these imports is not caught
import atexit
import signal

INTERRUPTED = 130  # the shell's exit code of a process that Ctrl-C ended


def main() -> None:
    """Run the command; Ctrl-C ends it without a traceback at any time.

    This includes the time in which it imports, and the time after its end.
    """
    # with another handler, whoever started the command wants Ctrl-C ignored
    handled = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if handled:
        signal.signal(signal.SIGINT, _leave)
        # The first to be registered is called last. From then on Python takes its own
        # handlers away, and Ctrl-C would end by a signal a command that has done its
        # work.
        atexit.register(signal.signal, signal.SIGINT, signal.SIG_IGN)
    _open_streams()
    from oee_tabular._isolation import ignore_settings
    from oee_tabular._memory import limit_memory

    ignore_settings()
    limit_memory()
    from oee_tabular.cli import main as command

    try:
        if handled:
            signal.signal(signal.SIGINT, _interrupt)
        command()
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
    except SystemExit as end:
        # a library may have made an error of its own of it, as numba does while it
        # compiles
        if _interrupts and end.code:
            sys.exit(INTERRUPTED)
        raise
    finally:
        if handled:
            signal.signal(signal.SIGINT, _leave)
        # Ctrl-C within an exec() of some library makes Python end itself by a signal
        # later on, though it was caught. The next exec() takes that back.
        exec("pass")


_interrupts: list[int] = []  # that came while the command ran


def _interrupt(number: int, _: object) -> None:
    """Note that Ctrl-C came, and raise what Python raises for it."""
    _interrupts.append(number)
    raise KeyboardInterrupt


def _leave(*_: object) -> None:
    """End the process at once, because there is nothing to clean up."""
    os._exit(INTERRUPTED)


def _open_streams() -> None:
    """Open the null device in place of standard streams that are closed.

    Else the next file would get their number, and what libraries print would be written
    into it.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
    if sys.stderr is None:
        sys.stderr = os.fdopen(os.open(os.devnull, os.O_WRONLY), "w")


if __name__ == "__main__":
    main()
