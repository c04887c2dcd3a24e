"""Checks of the exercises in these notebooks: ``check_05_a(answer)`` is exercise a of notebook 05."""

import math
import numbers

# ---- 01 to 04 ----------------------------------------------------------------------------------------------------------


def _judge(answer, values, hint, tolerance=0.005):
    """As ``_judge_05``, for a number or a list of numbers, right to within ``tolerance`` of their size (0: exactly)."""
    if answer is None:
        print("Not answered yet: put your answer in place of None and run the cell again.")
        return
    expected = values if isinstance(values, tuple) else (values,)
    try:
        given = tuple(float(x) for x in answer) if isinstance(values, tuple) else (float(answer),)
    except (TypeError, ValueError):
        raise AssertionError(f"{answer!r} is not right. Hint: the answer is {_shape(values)}; {hint}") from None
    right = len(given) == len(expected) and not isinstance(answer, bool)
    right = right and all(abs(x - v) <= tolerance * abs(v) for x, v in zip(given, expected, strict=True))
    assert right, f"{answer!r} is not right. Hint: {hint}"
    print("Right.")


def _shape(values):
    return f"a list of {len(values)} numbers" if isinstance(values, tuple) else "one number"


def check_01_a(answer):
    """V(0) of the machine that always runs slow, discount 0.9."""
    hint = "V(0) = 1 + 0.9 (0.9 V(0) + 0.1 V(1)) and V(1) = 0.9 (0.1 V(0) + 0.9 V(1)); solve the second for V(1) first."
    _judge(answer, 95 / 14, hint, 0.001)


def check_01_b(answer):
    """Smallest T with 0.99^T / 0.01 <= 0.5."""
    hint = "what is left out is at most 0.99^T + 0.99^(T+1) + ... = 0.99^T / 0.01; find the first whole T that makes it 0.5."
    _judge(answer, math.ceil(math.log(0.005) / math.log(0.99)), hint, 0.0)


def check_01_c(answer):
    """Episodes for a standard error of 0.1, at a variance of 57.766."""
    hint = "standard error = sqrt(variance / n); solve for n and round up."
    _judge(answer, 5777, hint, 0.0002)


def check_02_a(answer):
    """p = (0.8, 0.2), q = (0.5, 0.5), g <= 1.2, sum q g = 1."""
    hint = "which of p / q = 1.6, 0.4 breaks its bound? Put it there; the normalisation leaves only one number for the other."
    _judge(answer, (1.2, 0.8), hint)


def check_02_b(answer):
    """The risk of g = 1 less the optimum, in nats."""
    hint = "its risk is sum q - sum p log 1; the best possible risk is fit.objective, which the dual proves."
    _judge(answer, 0.1 * math.log(0.5) + 0.2 * math.log(0.88) + 0.3 * math.log(1.1) + 0.4 * math.log(2), hint, 0.01)


def check_02_c(answer):
    """n with sqrt(38 / n) = 0.1."""
    hint = "the ratio is 1, and (1 - 0.05) / 0.05 = 19 counts twice; set sqrt(38 / n) = 0.1."
    _judge(answer, 3800, hint)


def check_03_a(answer):
    """zeta of staying in a corner under an action into a wall: slips 0.1 and 0.3."""
    hint = "two directions lead to staying: add the probabilities of both, in the target and in the simulator, then divide."
    _judge(answer, 7 / 6, hint)


def check_03_b(answer):
    """Largest simulated slip e with 0.9 / (1 - e) <= 1.2 and 0.1 / e <= 1.2."""
    hint = "intended moves have the ratio 0.9 / (1 - e), slips 0.1 / e; which of the two stops you as e grows?"
    _judge(answer, 0.25, hint)


def check_03_c(answer):
    """1.03^200."""
    hint = "what does the row of zeta * P sum to? That factor comes in with every move."
    _judge(answer, 1.03**200, hint, 0.01)


def check_04_a(answer):
    """E[zeta^2] of a move: simulator 0.3, target 0.1."""
    hint = "sum P'^2 / P over the four directions: one intended, three slips."
    _judge(answer, 0.81 / 0.7 + 0.01 / 0.3, hint, 0.002)


def check_04_b(answer):
    """The other way round: simulator 0.1, target 0.3."""
    hint = "the same sum with the roles exchanged: P = 0.9 and 0.1 / 3, P' = 0.7 and 0.1."
    _judge(answer, 0.49 / 0.9 + 0.09 / 0.1, hint, 0.002)


def check_04_c(answer):
    """The per-decision variance at T = 100: 623.686^2."""
    hint = "variance / n = 1^2; T = 100 is horizons[7]."
    _judge(answer, 623.6864685770274**2, hint, 0.01)


# ---- 05 Little data ----------------------------------------------------------------------------------------------------


def _judge_05(answer, right, tolerance, hint):
    """Says that there is no answer yet, or that it is right; AssertionError with the hint where it is wrong."""
    if answer is None:
        print("Not answered yet: put your answer in place of None and run the cell again.")
        return
    wrong = isinstance(answer, bool) or not isinstance(answer, numbers.Real) or not abs(answer - right) <= tolerance
    assert not wrong, f"{answer!r} is not right. Hint: {hint}"
    print(f"Right: {right:.3f}.")


def check_05_a(answer):
    """zeta of a row shrunk to the simulator's: 10 moves, 9 of them intended, kappa = 30."""
    hint = "add the 30 pretended moves, of which 30 * 0.7 are intended, to the counts; divide by 10 + 30, and then by P = 0.7."
    _judge_05(answer, (9 + 30 * 0.7) / 40 / 0.7, 0.002, hint)


def check_05_b(answer):
    """theta that turns (0.7, 0.1, 0.1, 0.1) into (0.9, 1/30, 1/30, 1/30)."""
    hint = "the odds of the intended next state against another are 7; a tilt makes them 7 ** (1 + theta); the target's are 27."
    _judge_05(answer, math.log(27) / math.log(7) - 1, 0.002, hint)


def check_05_c(answer):
    """Evidence of two moves to the same of two next states: kappa = 1 against infinity, in nats."""
    hint = "the second move has probability (1 + kappa / 2) / (1 + kappa), given the first; take natural logarithms."
    _judge_05(answer, math.log(1.5), 0.002, hint)


def check_05_d(answer):
    """theta that turns (0.7, 0.1, 0.1, 0.1) into (1/2, 1/6, 1/6, 1/6)."""
    hint = "as in exercise b, with odds of 0.5 / (0.5 / 3) in the target; theta is negative where the target is more random."
    _judge_05(answer, math.log(3) / math.log(7) - 1, 0.002, hint)


def check_05_e(answer):
    """Whether a tilt by log P tells two next states of equal probability apart."""
    if answer is None:
        _judge_05(None, 0.0, 0.0, "")
        return
    hint = "within a row the tilt multiplies by P ** theta. What does it do to two equal values of P?"
    assert isinstance(answer, bool), f"{answer!r} is not right. Hint: answer True or False; {hint}"
    assert answer is False, f"{answer!r} is not right. Hint: {hint}"
    print("Right: False.")
