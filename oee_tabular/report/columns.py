"""The columns of a report's tables: titles, cells and meanings, in one list each.

Terminal, notebook and page choose columns by name. A cell is the same text in each;
the page and the notebook lay it out otherwise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from operator import itemgetter
from typing import TYPE_CHECKING, Any

from oee_tabular import _printing
from oee_tabular.report import text

if TYPE_CHECKING:
    from oee_tabular.report.content import Content

Row = Mapping[str, Any]

POLICY = "policy"
ESTIMATOR = "estimator"
VALUE = "value"
INTERVAL = "interval"
BASIS = "what it rests on"
STANDARD_ERROR = "std. error"
ERROR = "error"
NOTE = "note"
P_BEST = "P(best)"
SIMULATOR = "simulator says"
EXACT = "exact value"
DIAGNOSTICS = (
    STANDARD_ERROR,
    ERROR,
    "eff. n",
    "coverage",
    "max weight",
    "row-sum err.",
)
# the columns of a table with a row for each policy and estimator
SHORT = (POLICY, ESTIMATOR, VALUE, INTERVAL, ERROR, NOTE, BASIS)
FULL = (POLICY, ESTIMATOR, VALUE, INTERVAL, *DIAGNOSTICS, NOTE)


@dataclass(frozen=True)
class Column:
    """Hold one column of a table.

    Attributes
    ----------
    title : str
        What stands above it.
    write : callable
        The function that writes the cell of a row; "" where the row has nothing.
    meaning : str
        What it is, for a reader who does not know; "" where the title says it.
    is_text : bool
        Whether its cells are texts, which align left.
    """

    title: str
    write: Callable[[Row], str]
    meaning: str = ""
    is_text: bool = False


def estimator_columns(content: Content, names: Iterable[str]) -> list[Column]:
    """Return the named columns of the table with a row for each policy and estimator.

    The column of errors is left out where no exact value is known.
    """
    columns = {
        POLICY: Column(POLICY, itemgetter("policy"), is_text=True),
        ESTIMATOR: Column(ESTIMATOR, itemgetter("estimator"), is_text=True),
        **value_columns(content),
        STANDARD_ERROR: Column(
            STANDARD_ERROR,
            number_cell("standard_error", "{:.2g}".format),
            "Standard error, in the unit of the value.",
        ),
        ERROR: Column(ERROR, number_cell("error", "{:+.2g}".format)),
        "eff. n": Column(
            "eff. n",
            number_cell("effective_sample_size", "{:.0f}".format),
            "Effective sample size: how many equally informative transitions (or"
            " episodes) the value rests on.",
        ),
        "coverage": Column(
            "coverage",
            number_cell("coverage", _printing.share),
            "Share of the policy's discounted time, in the estimator's model, in"
            " recorded state-action pairs.",
        ),
        "max weight": Column(
            "max weight",
            number_cell("largest_weight", "{:.3g}".format),
            "The largest ratio, target over simulator or policy over behaviour.",
        ),
        "row-sum err.": Column(
            "row-sum err.",
            number_cell("row_sum_error", _write_row_sum_error),
            "How far rows of corrected probabilities are from summing to 1.",
        ),
        NOTE: Column(NOTE, write_citations),
        BASIS: Column(BASIS, basis_writer(content), is_text=True),
    }
    return [columns[name] for name in names if content.truth or name != ERROR]


def comparison_columns(content: Content) -> list[Column]:
    """Return the columns of the table with a row for each policy, best first.

    A column is left out where no policy has anything in it.
    """
    simulated = {
        answer.policy: text.format_value(answer.simulator, answer.lower, answer.upper)
        for answer in content.answers
        if answer.simulator is not None and answer.is_from_log
    }

    def write_simulated(row: Row) -> str:
        """Write the value of a policy in the simulator."""
        return simulated.get(row["policy"], "").replace("−", "-")

    def write_exact(row: Row) -> str:
        """Write the exact value of a policy."""
        return write_value(content.truth[row["policy"]], row["lower"], row["upper"])

    columns = [
        Column(POLICY, itemgetter("policy"), is_text=True),
        *value_columns(content).values(),
    ]
    if simulated:
        columns.append(Column(SIMULATOR, write_simulated))
    if any(row["probability_best"] is not None for row in content.comparison):
        columns.append(P_BEST_COLUMN)
    columns.append(Column("below the top row by", write_difference))
    if content.truth:
        columns.append(Column(EXACT, write_exact))
    return columns


def value_columns(content: Content) -> dict[str, Column]:
    """Return the columns of a value and its interval.

    A value without an interval has no more digits than the policy's answer.
    """
    quoted = {answer.policy: (answer.lower, answer.upper) for answer in content.answers}

    def write(row: Row) -> str:
        """Write a value with as many digits as an interval allows."""
        ends = row["lower"], row["upper"]
        shown = text.format_estimate(row["value"], ends, quoted[row["policy"]])
        return shown.replace("−", "-")

    def write_ends(row: Row) -> str:
        """Write the interval of a row."""
        return write_interval(row["lower"], row["upper"])

    title = f"{content.confidence:.0%} interval"
    return {VALUE: Column(VALUE, write), INTERVAL: Column(title, write_ends)}


def basis_writer(content: Content) -> Callable[[Row], str]:
    """Return a function that writes what the value of a row rests on.

    Where the corrected simulator cannot be relied on, the simulator's own value stands
    without a warning, and must not look like the answer.
    """
    doubted = {
        row["policy"]
        for row in content.records
        if row["status"] != "ok" and text.is_of_correction(row["estimator"])
    }

    def write(row: Row) -> str:
        """Write what the value of a row rests on."""
        basis = write_basis(row)
        if basis == text.OF_SIMULATOR and row["policy"] in doubted:
            return text.NOT_OF_TARGET
        return basis

    return write


def write_basis(row: Row) -> str:
    """Write what an estimator's value rests on; "" for estimators of one's own.

    Where the log covers less than half of what the policy does, the text says how much.
    Where the value is not to be used, it says so instead.
    """
    if row["status"] != "ok":
        return text.NOT_USABLE
    basis = text.write_basis(row["estimator"])
    coverage = row.get("coverage")
    if basis and coverage is not None and coverage < text.MIN_COVERAGE:
        basis += f", which covers {_printing.share(coverage)}"
    return basis


def write_citations(row: Row) -> str:
    """Write the numbers of a row's notes."""
    return "".join(f"[{k}]" for k in row["notes"])


def write_value(value: float, lower: float | None, upper: float | None) -> str:
    """Write a value with as many digits as its interval has."""
    if lower is None or upper is None:
        return text.format_number(value).replace("−", "-")
    return f"{value:{_printing.spec(lower, upper)}}"


def write_interval(lower: float | None, upper: float | None) -> str:
    """Write an interval; "" without one."""
    return "" if lower is None or upper is None else _printing.interval(lower, upper)


def write_difference(row: Row) -> str:
    """Write by how much a policy is worth less than the best; "" for the best."""
    less = row["less_by"]
    if less is None:
        return ""
    ends = (row["less_by_lower"], row["less_by_upper"])
    return f"{write_value(less, *ends)} {write_interval(*ends)}".strip()


def write_p_best(row: Row) -> str:
    """Write the probability that a policy is best; a dash where the log cannot say."""
    probability = row["probability_best"]
    return "-" if probability is None else _printing.probability(probability)


def number_cell(key: str, form: Callable[[float], str]) -> Callable[[Row], str]:
    """Return the function that writes a row's number; "" where the row has none."""
    return lambda row: "" if row.get(key) is None else form(row[key])


def _write_row_sum_error(error: float) -> str:
    """Write how far rows are from summing to 1; rounding is 0."""
    return "0" if error < 1e-9 else f"{error:.2g}"


P_BEST_COLUMN = Column(
    P_BEST,
    write_p_best,
    "The probability that this policy is worth most, given the sampling noise alone.",
)
