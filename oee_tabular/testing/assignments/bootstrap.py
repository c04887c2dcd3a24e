"""Assignment 5: the bootstrap of whole episodes, and its percentile interval."""

from __future__ import annotations

from functools import partial
from statistics import NormalDist
from typing import Any, NamedTuple

import numpy as np

from oee_tabular.testing.assignments.judging import (
    Arguments,
    Kind,
    Mistake,
    RefusedAnswer,
    Task,
    ask,
)
from oee_tabular.typing import Array, IntArray

N_PLAIN_CASES = 4  # that tell one mistake from another
N_SIGMAS = 6.0  # by which a right answer's mean and spread may be off by chance


def _draw_statistics(
    rng: np.random.Generator,
    *,
    confidence: float = 0.95,
    sign: float = 1.0,
    is_sorted: bool = False,
    n_digits: int = 12,
) -> Arguments:
    statistics = np.sort(rng.gamma(2.0, size=int(rng.integers(400, 900))))
    if not is_sorted:
        statistics = rng.permutation(statistics)
    statistics = np.round(sign * statistics, n_digits)
    return {"statistics": statistics, "confidence": confidence}


_ANY_CONFIDENCE = "the confidence is an argument, and not always 0.95."

PERCENTILE_KINDS = (
    Kind("", _draw_statistics),
    *(
        Kind(
            f"the confidence is {confidence}",
            partial(_draw_statistics, confidence=confidence),
            _ANY_CONFIDENCE,
        )
        for confidence in (0.8, 0.99, 0.5)
    ),
    Kind(
        "the statistics are negative",
        partial(_draw_statistics, confidence=0.9, sign=-1.0),
        "the statistics may be negative; the lower end is the smaller number.",
    ),
    Kind(
        "the statistics are sorted",
        partial(_draw_statistics, confidence=0.9, is_sorted=True),
        "the statistics may be in any order.",
    ),
    Kind(
        "many statistics are equal",
        partial(_draw_statistics, confidence=0.9, n_digits=0),
        "equal statistics count as often as they occur.",
    ),
)


def _percentile(statistics: Array, confidence: float) -> Array:
    rest = (1.0 - confidence) / 2.0
    return np.asarray(np.quantile(statistics, [rest, 1.0 - rest]))


def _bounds(statistics: Array, confidence: float) -> tuple[Array, Array]:
    """Allow every usual rule for a quantile between two of the numbers."""
    rest = (1.0 - confidence) / 2.0
    room = 1.5 / len(statistics)
    levels = np.array([rest, 1.0 - rest])
    return (
        np.quantile(statistics, np.maximum(levels - room, 0.0), method="lower"),
        np.quantile(statistics, np.minimum(levels + room, 1.0), method="higher"),
    )


def _normal(statistics: Array, confidence: float) -> Array:
    z = NormalDist().inv_cdf(0.5 + confidence / 2.0)
    return np.asarray(statistics.mean() + statistics.std() * np.array([-z, z]))


PERCENTILE = Task(
    name="5_percentile",
    call="percentile_interval(statistics, confidence)",
    kinds=PERCENTILE_KINDS,
    solve=_percentile,
    bounds=_bounds,
    hint="the ends are the quantiles (1 - confidence) / 2 and 1 - (1 - confidence) / 2"
    " of the statistics, the lower one first.",
    mistakes=(
        Mistake(
            lambda statistics, confidence: np.quantile(
                statistics, [1 - confidence, confidence]
            ),
            "this leaves 1 - confidence out on each side; it is to be halved.",
        ),
        Mistake(
            lambda statistics, confidence: _percentile(statistics, confidence)[::-1],
            "the lower end comes first.",
        ),
        Mistake(
            lambda statistics, confidence: np.quantile(
                statistics, [confidence / 2, 1 - confidence / 2]
            ),
            "half of 1 - confidence is left out on each side, and not half of the"
            " confidence.",
        ),
        Mistake(
            lambda statistics, confidence: (
                statistics.mean() + 1.96 * statistics.std() * np.array([-1.0, 1.0])
            ),
            "this is the mean -+ 1.96 standard deviations, which is symmetric; the"
            " bootstrap's distribution need not be.",
        ),
        Mistake(
            lambda statistics, confidence: (
                statistics.mean()
                + 1.96
                * statistics.std()
                / np.sqrt(len(statistics))
                * np.array([-1.0, 1.0])
            ),
            "the statistics are means already; their spread is not divided by a root.",
        ),
        Mistake(
            _normal,
            "this is the mean -+ z standard deviations, which is symmetric; the"
            " bootstrap's distribution need not be.",
        ),
        Mistake(
            lambda statistics, confidence: (
                statistics.mean()
                + (_normal(statistics, confidence) - statistics.mean())
                / np.sqrt(len(statistics))
            ),
            "the statistics are means already; their spread is not divided by a root.",
        ),
        Mistake(
            lambda statistics, confidence: np.percentile(
                statistics, [(1 - confidence) / 2, 1 - (1 - confidence) / 2]
            ),
            "np.percentile takes percents, np.quantile shares.",
        ),
        Mistake(
            lambda statistics, confidence: np.array(
                [statistics.min(), statistics.max()]
            ),
            "these are the least and the largest, which widen with every resample.",
        ),
        Mistake(
            lambda statistics, confidence: np.quantile(statistics, [0.025, 0.975]),
            "the confidence is an argument, and not always 0.95.",
        ),
        Mistake(
            lambda statistics, confidence: np.quantile(statistics, [0.0, confidence]),
            "this leaves nothing out below; half of the rest belongs to each side.",
        ),
        Mistake(
            lambda statistics, confidence: statistics[
                [
                    int((1 - confidence) / 2 * len(statistics)),
                    int((1 + confidence) / 2 * len(statistics)),
                ]
            ],
            "the statistics are in no order; sort them first.",
        ),
        Mistake(
            lambda statistics, confidence: (
                2 * statistics.mean() - _percentile(statistics, confidence)[::-1]
            ),
            "this mirrors the quantiles at the mean; the percentile interval is made of"
            " the quantiles themselves.",
        ),
        Mistake(
            lambda statistics, confidence: np.quantile(
                statistics, [(1 - confidence) / 2, confidence]
            ),
            "the upper end is the quantile 1 - (1 - confidence) / 2.",
        ),
    ),
)


def _draw_log(
    rng: np.random.Generator,
    *,
    n_episodes: int | None = None,
    lengths: tuple[int, int] = (2, 6),
    discount: float = 0.9,
    sign: float = 1.0,
    n_resamples: int = 4000,
) -> Arguments:
    n = int(rng.integers(8, 14)) if n_episodes is None else n_episodes
    steps = rng.integers(*lengths, size=n)
    episode = np.repeat(np.arange(n), steps)
    timestep = np.concatenate([np.arange(k) for k in steps])
    return {
        "reward": sign * np.round(rng.gamma(1.0, size=len(episode)), 2),
        "episode": episode,
        "timestep": timestep,
        "discount": discount,
        "n_resamples": n_resamples,
        "seed": int(rng.integers(1000)),
    }


def _draw_successes(rng: np.random.Generator) -> Arguments:
    """Draw successes at the first step: a mean is a whole number by n."""
    drawn = _draw_log(rng)
    is_success = (drawn["timestep"] == 0) & (drawn["episode"] % 3 == 0)
    return drawn | {"reward": is_success * 1.0}


def _draw_outlier(rng: np.random.Generator, *, episode: int) -> Arguments:
    """Draw a log in which one return is far from the others."""
    drawn = _draw_log(rng, n_episodes=10)
    drawn["reward"][drawn["episode"] == episode] += 20.0
    return drawn


_EVERY_EPISODE = "every episode can be drawn, the first and the last one too."

RESAMPLE_KINDS = (
    Kind("", _draw_log),
    Kind("the returns are 0 or 1", _draw_successes),
    Kind(
        "the last return is far from the others",
        partial(_draw_outlier, episode=9),
        _EVERY_EPISODE,
    ),
    Kind(
        "the first return is far from the others",
        partial(_draw_outlier, episode=0),
        _EVERY_EPISODE,
    ),
    Kind("the discount is 1", partial(_draw_log, discount=1.0)),
    Kind(
        "every episode has one step",
        partial(_draw_log, lengths=(1, 2)),
    ),
    Kind(
        "rewards are negative, and 2500 resamples are asked for",
        partial(_draw_log, sign=-1.0, n_resamples=2500),
        "the number of resamples is an argument, and rewards may have any sign.",
    ),
    Kind(
        "there are 60 episodes, of up to 30 steps",
        partial(_draw_log, n_episodes=60, lengths=(1, 31)),
    ),
)


class _Moments(NamedTuple):
    """A mean and a standard deviation of resamples, and the hint that they get."""

    mean: float
    deviation: float
    hint: str


def _wrong_moments(
    reward: Array, episode: IntArray, timestep: IntArray, discount: float
) -> list[_Moments]:
    """Return what mistakes lead to."""
    weighted = discount**timestep * reward
    plain = np.bincount(episode, weights=reward)
    returns = np.bincount(episode, weights=weighted)
    rows, n = len(reward), len(returns)
    m, s = returns.mean(), returns.std() / np.sqrt(n)
    return [
        _Moments(
            m,
            weighted.std() * np.sqrt(rows) / n,
            "rows of one episode belong together; draw whole episodes.",
        ),
        _Moments(
            weighted.mean(),
            weighted.std() / np.sqrt(rows),
            "these are means over rows; the statistic is the mean return of episodes.",
        ),
        _Moments(
            plain.mean(),
            plain.std() / np.sqrt(n),
            "the discount is missing: discount**timestep.",
        ),
        _Moments(
            m,
            returns.std(),
            "a resample has as many episodes as the log, and not one.",
        ),
        _Moments(
            m,
            s * np.sqrt(n / (n // 2)),
            "a resample has as many episodes as the log, and not half of them.",
        ),
        _Moments(
            m,
            s / np.sqrt(2),
            "a resample has as many episodes as the log, and not twice as many.",
        ),
        _Moments(
            m,
            s * np.sqrt(n / rows),
            "a resample has as many episodes as the log has episodes, and not rows.",
        ),
        _Moments(
            weighted.mean(),
            weighted.std() / np.sqrt(n),
            "these are means over rows; the statistic is the mean return of episodes.",
        ),
        _Moments(
            np.delete(returns, -1).mean(),
            np.delete(returns, -1).std() / np.sqrt(n),
            "the last episode is never drawn; rng.integers(n) ends with n - 1.",
        ),
        _Moments(
            np.delete(returns, 0).mean(),
            np.delete(returns, 0).std() / np.sqrt(n),
            "the first episode is never drawn; episodes are numbered from 0 on.",
        ),
        _Moments(
            m * discount,
            s * discount,
            "the first reward is not discounted: t begins at 0.",
        ),
        _Moments(
            m,
            s * np.sqrt(n / (n - 1)),
            "a resample has as many episodes as the log, and not one less.",
        ),
        _Moments(m * n, s * n, "these are sums of returns; the statistic is the mean."),
        _Moments(
            0.0,
            s,
            "these are differences from the estimate; keep the means themselves.",
        ),
    ]


def _recognise(task: Task, answer: Any) -> str:
    """Return the hint of the mistake that fits in several plain cases, or ""."""
    near: list[set[str]] = []
    n_kinds = len(task.kinds)
    for case in range(0, N_PLAIN_CASES * n_kinds, n_kinds):
        drawn = task.draw_case(case)
        try:
            found = ask(task, answer, drawn)
            means = task.read(found, np.zeros(drawn["n_resamples"]))
        except RefusedAnswer:
            return ""
        log = [drawn[name] for name in ("reward", "episode", "timestep", "discount")]
        near.append(
            {
                wrong.hint
                for wrong in _wrong_moments(*log)
                if _is_near(means, wrong.mean, wrong.deviation)
            }
        )
    hints = set.intersection(*near)
    return hints.pop() if len(hints) == 1 else ""


def _judge(task: Task, answer: Any, arguments: Arguments) -> str:
    """Compare mean, spread and range with the exact ones of the bootstrap.

    Of n returns with mean m and standard deviation s (division by n), the mean of a
    resample has the mean m and the standard deviation s / sqrt(n).
    """
    reward, episode, timestep, discount, n_resamples, _ = arguments.values()
    means = task.read(ask(task, answer, arguments), np.zeros(n_resamples))
    if not np.all(np.isfinite(means)):
        return f"a resample's mean is nan or inf. Hint: {task.hint}"
    returns = np.bincount(episode, weights=discount**timestep * reward)
    m, s = returns.mean(), returns.std() / np.sqrt(len(returns))
    said = (
        f"the resampled means have mean {means.mean():.4g} and standard deviation"
        f" {means.std():.4g}; {m:.4g} and {s:.4g} are exact. Hint: "
    )
    if np.ptp(means) < 1e-9 * max(abs(m), 1.0):
        return (
            f"{said}all resamples are equal; draw with replacement, and anew for each"
            " resample."
        )
    if not _is_near(means, m, s):
        return said + (_recognise(task, answer) or task.hint)
    is_outside = (
        means.min() < returns.min() - 1e-9 or means.max() > returns.max() + 1e-9
    )
    whole = means * len(returns)
    is_success = bool(np.isin(returns, [0.0, 1.0]).all())
    if is_outside or (is_success and np.abs(whole - whole.round()).max() > 1e-6):
        return (
            "a mean is no mean of as many returns as the log has episodes. Hint: each"
            " resample has as many episodes as the log, all of the same weight, and"
            " their returns are those of the log, drawn from no normal distribution."
        )
    return _judge_seed(task, answer, arguments, means)


def _judge_seed(task: Task, answer: Any, arguments: Arguments, means: Array) -> str:
    """Refuse resamples that do not follow the seed, or one another's."""
    again = task.read(ask(task, answer, arguments), means)
    if not np.array_equal(means, again):
        return (
            "two calls with one seed differ. Hint: draw from"
            " np.random.default_rng(seed), and from nothing else."
        )
    changed = arguments | {"seed": arguments["seed"] + 1}
    if np.array_equal(means, task.read(ask(task, answer, changed), means)):
        return (
            "another seed gives the same resamples. Hint: draw from"
            " np.random.default_rng(seed)."
        )
    if abs(np.corrcoef(means[1:], means[:-1])[0, 1]) > N_SIGMAS / np.sqrt(len(means)):
        return (
            "neighbouring resamples depend on each other. Hint: draw each anew, and"
            " do not sort them."
        )
    return ""


def _is_near(means: Array, mean: float, deviation: float) -> bool:
    """Return whether means may be drawn with a mean and a standard deviation."""
    if deviation <= 0.0:
        return False
    chance = N_SIGMAS / np.sqrt(len(means))
    return bool(
        abs(means.mean() - mean) <= chance * deviation
        and abs(means.std() / deviation - 1.0) <= chance
    )


RESAMPLE = Task(
    name="5_bootstrap",
    call="bootstrap_means(reward, episode, timestep, discount, n_resamples, seed)",
    kinds=RESAMPLE_KINDS,
    axes=("resample",),
    solve=lambda *_: None,
    judge=_judge,
    hint="compute the discounted return of each episode; each resample draws as many"
    " episodes as the log has, with replacement, and takes the mean of their returns.",
)

TASKS = (PERCENTILE, RESAMPLE)
