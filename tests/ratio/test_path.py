"""How far it is from the front door to the program of eq. 3.7."""

import os
import sys

import oee_tabular as oee

HOUSE = os.path.dirname(oee.__file__)
ASIDE = (
    "_checks.py",
    "_threads.py",
    os.path.join("data", "columns.py"),
    os.path.join("data", "transitions.py"),
    os.path.join("data", "sums.py"),
    "_sparse.py",
    os.path.join("ratio", "arguments.py"),
)  # checks; from the third to the sixth: of Transitions.counts


def passed_through(call):
    """The package's own functions that a call passes: (file, name). Compiled kernels and comprehensions are none."""
    found = set()

    def note(frame, event, argument):
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(HOUSE):
            file = os.path.relpath(code.co_filename, HOUSE)
            made = file not in ASIDE and not os.path.basename(file).startswith("_") and code.co_name[0] != "<"
            if made and code.co_qualname != "TransitionRatio.finite":  # a check
                found.add((file, code.co_qualname))

    sys.setprofile(note)
    try:
        call()
    finally:
        sys.setprofile(None)
    return found


def test_the_conditional_program_is_fifteen_functions_in_six_files_away():
    simulator, target = oee.tasks.gridworld(6, 0.3), oee.tasks.gridworld(6, 0.1)
    log = oee.sample_episodes(target, oee.uniform_policy(target), 50, 20, seed=0)
    oee.transition_ratio(log, simulator, prior="none")  # what is made once is made
    found = passed_through(lambda: oee.transition_ratio(log, simulator, prior="none"))
    assert len(found) <= 15, sorted(found)
    assert len({file for file, _ in found}) <= 6, sorted(found)
