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
    """V(0) of the motor that always runs slow, discount 0.9."""
    hint = "V(0) = 1 + 0.9 (0.9 V(0) + 0.1 V(1)) and V(1) = 0.9 (0.1 V(0) + 0.9 V(1)); solve the second for V(1) first."
    _judge(answer, 95 / 14, hint, 0.001)


def check_01_b(answer):
    """Smallest T with 0.99^T / 0.01 <= 0.5."""
    hint = "what is left out is at most 0.99^T + 0.99^(T+1) + ... = 0.99^T / 0.01; find the first whole T that makes it 0.5."
    _judge(answer, math.ceil(math.log(0.005) / math.log(0.99)), hint, 0.0)


def check_01_c(answer):
    """Episodes for a standard error of 0.1, at a variance of 278.204."""
    hint = "standard error = sqrt(variance / n); solve for n and round up."
    _judge(answer, 27_821, hint, 0.0002)


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


# ---- 00, and 06 to 10 --------------------------------------------------------------------------------------------------


def check_00_a(answer):
    """0.99^13: the arrival with the 14th move."""
    hint = "the robot needs 7 moves down and 7 to the right; the reward of the k-th move counts 0.99^(k - 1)."
    _judge(answer, 0.99**13, hint)


def check_06_a(answer):
    """Mean |1 - zeta| of an open cell's row: once 9/7, three times 1/3."""
    hint = "zeta is 9/7 for one next state and 1/3 for three; take the mean of the four distances from 1."
    _judge(answer, 4 / 7, hint)


def check_06_b(answer):
    """(1 - 0.99) times 40 rewards."""
    hint = "40 rewards, t = 0 to 39: (1 - 0.99) times the sum of 0.99^t is 1 - 0.99^40."
    _judge(answer, 1 - 0.99**40, hint)


def check_06_c(answer):
    """Theorem 2's two sides at T = 2, no discount, epsilon = 0.1, nu = 0.9."""
    hint = (
        "the weights of t = 1 and 2 are 1.1 and 1.1^2 in place of 1: add both errors, square; the bound has t / 0.9^t."
    )
    _judge(answer, ((0.1 + 0.21) ** 2, 2 * 0.01 * (1 / 0.9 + 2 / 0.81)), hint)


def check_07_a(answer):
    """Both ends of P'(first) of a row (0.7, 0.3) in the box 0.25 to 1.6."""
    hint = "both probabilities have bounds, and they add up to 1: what do those of the second leave for the first?"
    _judge(answer, (0.52, 0.925), hint)


def check_07_b(answer):
    """300 moves over two pairs whose standard deviations are 1 and 2."""
    hint = "n_sa is proportional to the square root of c_sa, that is to the standard deviation: as 1 to 2."
    _judge(answer, (100, 200), hint)


def check_07_c(answer):
    """Moves for a standard error of 0.05 by the uniform design, whose bound is 56.5201."""
    hint = "the variance is bound / n; set its square root to 0.05, with bound['uniform'] of the cell above."
    _judge(answer, 56.5201 / 0.05**2, hint, 0.02)


def check_08_a(answer):
    """The four corners' shares of a point (0.25, 0.5) in its cell."""
    hint = "along each side the nearer vertex gets more: 0.75 and 0.25, 0.5 and 0.5; a corner gets the product."
    _judge(answer, (0.375, 0.375, 0.125, 0.125), hint)


def check_08_b(answer):
    """Moves a row of 80 000, on 10^4 and on 32^4 vertices with two actions."""
    hint = "two actions, so 2 * 10^4 rows, and 2 * 32^4: divide 80 000 by each."
    _judge(answer, (4.0, 80_000 / (2 * 32**4)), hint, 0.02)


def check_08_c(answer):
    """0.45 * 0.51 / 0.50."""
    hint = (
        "the simulator's own value is 0.51 / 0.50 times what the grid says; the estimate is mended by the same factor."
    )
    _judge(answer, 0.459, hint, 0.002)


def check_09_a(answer):
    """The target is one of five lengths in the tenth that is averaged."""
    hint = "at worst 0.1 m never makes the move, and of the five lengths the target's alone does: its share is 0.1 / 5."
    _judge(answer, 50, hint)


def check_09_b(answer):
    """1250 moves over 27 commands."""
    hint = "5 goals, 10 runs to each, 25 commands a run; divide by the number of different commands."
    _judge(answer, 1250 / 27, hint, 0.01)


def check_09_c(answer):
    """zeta of one and of two boxes: 1.4 steps, against the defensive simulator."""
    hint = "1.4 steps are 0.6 and 0.4; the simulator has 0.9 at 1 step, and 0.05 at 0.5 and at 1.5, each shared by two boxes."
    _judge(answer, (0.6 / 0.95, 0.4 / 0.025), hint)


def check_10_a(answer):
    """J and the estimator's limit of the survival chain at T = 3."""
    hint = "J is the sum of 0.9^t 0.7^t; divided by who is alive, 0.7^t drops out. t is 0, 1, 2."
    _judge(answer, (1 + 0.63 + 0.63**2, 1 + 0.9 + 0.81), hint)


def check_10_b(answer):
    """Logs that show a bias of 0.02 beside a standard deviation of 0.1 at four standard errors."""
    hint = "the mean of k logs has a standard error of 0.1 / sqrt(k); make four of them 0.02."
    _judge(answer, 400, hint)


def check_10_c(answer):
    """The statement's two sides: reward 1 while in the state, left with 0.01, discount 0.9."""
    hint = "J' = 1 / (1 - 0.9) and J = 1 / (1 - 0.9 * 0.99); the statement allows 2 * 1 * 0.01 / (1 - 0.9)."
    _judge(answer, (10 - 1 / (1 - 0.9 * 0.99), 0.2), hint)
