"""What commands print: sentences, or with ``--json`` one object whose keys stay (``SHAPES``), on stdout alone.

Values are in the report's unit; what is not known is null. States and actions are named where the simulator has names. Keys may
be added, none is renamed or taken away.
"""

from __future__ import annotations

import json
from collections.abc import Mapping

import typer

SHAPES: Mapping[str, Mapping[str, str]] = {
    "evaluate": {
        "version": "of oee_tabular", "unit": "what a value is", "discount": "", "horizon": "", "normalized": "",
        "confidence": "of the intervals", "interval": "what each kind of interval is", "seed": "", "facts": "inputs",
        "results": "a row each policy and estimator: value, standard_error, lower, upper, interval_method, notes, ...",
        "intervals": "a row each policy and method: lower, upper, confidence, status",
        "conclusion": "sentences", "warnings": "sentences to read before use",
    },
    "compare": {
        "version": "of oee_tabular", "confidence": "of the intervals", "best": "a policy, null where the log cannot say",
        "sentence": "the answer", "policies": "a row each, best first: value, lower, upper, probability_best, unseen_share",
        "differences": "a row each from the best: policy, than, difference, lower, upper", "warnings": "sentences",
    },
    "plan": {
        "version": "of oee_tabular", "sampling": "free or behavior", "n": "moves to record", "confidence": "of the widths",
        "status": "ok, or what is wrong", "gap": "at most so far from the best plan",
        "policies": "a row each: standard_error and width, now and after; inefficiency",
        "most": "a row each (state, action) with the largest shares: state, action, share",
        "advice": "the sentence on what would help most",
        "next": "rows: state, action to record next", "file": "that was written, or null",
    },
    "sample": {"version": "of oee_tabular", "file": "", "transitions": "how many", "episodes": "how many, or null"},
    "policy": {"version": "of oee_tabular", "file": "", "states": "how many", "actions": "how many"},
    "export": {
        "version": "of oee_tabular", "file": "", "states": "how many", "actions": "how many", "transitions": "how many",
        "discount": "",
    },
    "counts": {"version": "of oee_tabular", "file": "", "moves": "how many", "dropped": "sentences on rows left out"},
    "info": {"version": "of oee_tabular", "file": "", "kind": "what it holds", "text": "lines that say what"},
    "reproduce": {"version": "of oee_tabular", "lines": "what was run, or what there is"},
    "bench": {"version": "of oee_tabular", "lines": "the league"},
    "check": {
        "version": "of oee_tabular", "estimator": "", "passed": "whether all laws hold that are owed or claimed", "seed": "",
        "laws": "a row each: law, outcome, text, example",
    },
}  # fmt: skip


def shape_help(command: str) -> str:
    """The help of ``--json``."""
    return f"Print JSON instead, with {', '.join(SHAPES[command])}."


def answer(command: str, text: str, record: Mapping[str, object], as_json: bool) -> None:
    """Print one or the other."""
    if not as_json:
        typer.echo(text)
        return
    from oee_tabular import __version__
    from oee_tabular.report.results import plain

    whole = {"version": __version__} | dict(record)
    assert set(whole) >= set(SHAPES[command]), f"the shape of {command}"
    typer.echo(json.dumps(plain(whole), indent=2, allow_nan=False))
