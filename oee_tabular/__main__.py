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
REPEATS = hasattr(signal, "setitimer")  # which Windows lacks
REPEAT_SECONDS = 2.0


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
            if REPEATS:
                signal.signal(signal.SIGALRM, _interrupt_again)
        command()
    except (KeyboardInterrupt, SystemExit) as end:
        _stop_repeating()
        is_interrupted = isinstance(end, KeyboardInterrupt)
        # a library may have made an error of its own of it, as numba does while it
        # compiles
        is_interrupted |= bool(_interrupts) and bool(end.args and end.args[0])
        if not is_interrupted:
            raise
        if not _interrupts:
            sys.exit(INTERRUPTED)
        _end()
    finally:
        _stop_repeating()
        if handled:
            signal.signal(signal.SIGINT, _leave)
        # Ctrl-C within an exec() of some library makes Python end itself by a signal
        # later on, though it was caught. The next exec() takes that back.
        exec("pass")


_interrupts: list[int] = []  # that came while the command ran


def _interrupt(number: int, _: object) -> None:
    """Note that Ctrl-C came, and raise what Python raises for it."""
    _interrupts.append(number)
    if REPEATS:
        signal.setitimer(signal.ITIMER_REAL, REPEAT_SECONDS, REPEAT_SECONDS)
    raise KeyboardInterrupt


def _interrupt_again(*_: object) -> None:
    """Raise it again where it was dropped, and the command went on.

    Python drops what is raised in a ``__del__``, of which numba's compiler calls many.
    While Ctrl-C is handled, as by what removes a file that is not whole, nothing is
    raised.
    """
    error = sys.exc_info()[1]
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return
        error = error.__context__
    raise KeyboardInterrupt


def _stop_repeating() -> None:
    """Raise Ctrl-C no more."""
    if REPEATS and _interrupts:
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def _end() -> None:
    """End a command that Ctrl-C ended, without taking Python's modules down.

    Objects of libraries that were cut in two may crash there, as those of compilers.
    """
    signal.signal(signal.SIGINT, _leave)
    from contextlib import suppress

    # What is registered waits for worker processes. Those that were starting when
    # Ctrl-C came have nobody to end them.
    processes = sys.modules.get("multiprocessing")
    for child in processes.active_children() if processes else ():
        with suppress(OSError, TypeError):  # it has ended, or was never started
            os.kill(child.pid, signal.SIGTERM)
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with suppress(AttributeError, OSError, ValueError):  # none, full, or closed
            stream.flush()
    os._exit(INTERRUPTED)


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
