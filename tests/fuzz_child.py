"""A process that answers questions for the fuzzers; where it dies or hangs another
takes its place.
"""

import multiprocessing
import signal

# ends a child that has set a timer of its own processor time
OUT_OF_TIME = getattr(signal, "SIGPROF", 0)
START = 300.0  # seconds for a child to import and compile


def allow(seconds):
    """End this process after so many seconds of its own processor time; 0 for never."""
    if OUT_OF_TIME:
        signal.setitimer(signal.ITIMER_PROF, seconds)


class Child:
    """``target(pipe, *arguments)`` in a process of its own, which receives questions
    and sends answers.

    limit : seconds for an answer but the first; None waits as long as it takes
    """

    def __init__(self, limit, target, *arguments):
        self.limit = limit
        self.target = target
        self.arguments = arguments
        self.start()

    def start(self):
        context = multiprocessing.get_context("spawn")
        self.pipe, other = context.Pipe()
        self.process = context.Process(
            target=self.target, args=(other, *self.arguments), daemon=True
        )
        self.process.start()
        other.close()
        self.wait = None if self.limit is None else START

    def ask(self, question):
        """The answer, or "death" or "hang"."""
        lost = "death"
        try:
            self.pipe.send(question)
            if self.pipe.poll(self.wait):
                answer = self.pipe.recv()
                self.wait = self.limit
                return answer
            lost = "hang"
        except (EOFError, ConnectionError):
            self.process.join()
            if self.process.exitcode == -OUT_OF_TIME:
                lost = "hang"
        self.end()
        self.start()
        return lost

    def end(self):
        self.process.kill()
        self.process.join()
