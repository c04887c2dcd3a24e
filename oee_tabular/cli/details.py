"""Long help of the commands: the forms that values take, and the keys of JSON.

The site's page of commands shows all of it, the terminal what ``IN_TERMINAL`` names.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from oee_tabular.estimators.names import names

IN_TERMINAL = ("SIM", "SPEC", "--estimators")

_NAMES = f"{', '.join(names())}; unrecorded pairs stay in model-based."
_TARGET_NAMES = f"{', '.join(names(needs_target=True))}."
_STATE = (
    "Functions get(env) and set(env, state) of a Gymnasium environment whose state is"
    " not found. The environment's attribute `state_names` names the coordinates, else"
    " they are state_0, state_1, ... in the order of get."
)
_ACTIONS = (
    "Levels of each coordinate of a Gymnasium Box of actions (9, or -2,0,2), or the"
    " commands themselves."
)
_TRANSITION_FILES = {
    "FILE.csv": "Columns state, action, next_state (numbers or names) and the values.",
    "FILE.npy": "Shape (S, A, S), or (entries,) of the simulator's transitions.",
}

_SIMULATORS = {
    "gridworld:10,slip=0.3": "A task of ours, or bus_engines:group=3.",
    "FILE.npz": "A saved FiniteMDP.",
    "FILE.umb": "A model of PRISM or Storm, or a saved FiniteMDP.",
    "FILE.csv": "No simulator yet; `oee export` makes one of it.",
    "FrozenLake-v1:map_name=8x8": "A Gymnasium id with its arguments.",
    "MODULE:OBJECT,key=value": (
        "Your own FiniteMDP or Gymnasium environment with a table P, or what makes one."
    ),
    "MODULE:EnvId-v0": "A Gymnasium id that your module registers.",
    "cartpole:gravity=10": "A continuous task: cartpole, reacher or kinova.",
    "Pendulum-v1:g=9": "A Gymnasium id whose states are continuous.",
    "MODULE:EnvId-v0:key=value": "The same, registered by your module.",
}

# an option or the name of a value -> the forms of the value -> what each means; an
# entry that begins with a command is of that command alone
DETAILS: dict[str, dict[str, str]] = {
    "SIM": _SIMULATORS,
    "export SIM": _SIMULATORS
    | {
        "FILE.csv": (
            "A table with the columns state, action, next_state, probability and"
            " reward, or of samples, without probability."
        ),
        "FILE.parquet": "A table of samples.",
    },
    "SPEC": {
        "uniform": "All actions with the same probability.",
        "optimal": "An optimal policy of the simulator.",
        "expert": "The simulator's own expert; optimal if it has none.",
        "mix:0.5": "Half expert, half uniform.",
        "FILE.npy, FILE.npz": "An array of shape (S, A), or (S,) of actions.",
        "FILE.csv": (
            "Columns state, action (and probability), or state and one column for each"
            " action."
        ),
        "MODULE:FUNCTION": "A function of a state.",
        "continuous task": (
            "Takes uniform, expert, mix, arrays of its cells, and functions of its"
            " states."
        ),
    },
    "--log": {
        "FILE.npz": "A log, or the counts of one.",
        "FILE.csv, FILE.parquet": "A table with one transition in each row.",
        "FOLDER, PATTERN": "Several files of one log.",
        "MINARI": "A Minari folder or id.",
    },
    "--column": {
        "state=pose_before": "The log's column state is the files' pose_before.",
        "state=row,column": "Several columns to a state or an action make a tuple.",
        "state_0=x": "One coordinate of a continuous state.",
        "terminated=": "The files have no such column; nothing else is read as it.",
    },
    "export --column": {
        "state=pose": "The column pose of the table has the states.",
        "next_state=LABEL": "The same of action, next_state, probability and reward.",
        "probability=": "The table has no probabilities; each row is a sample.",
    },
    "TRIALS": {
        "9/12": "9 of 12 trials succeeded; `--success` says in which states.",
        "FILE.csv": (
            "A trial in each row: success (1 or 0) or return, and policy (a name of"
            " `--policy`) and weight where there are such columns."
        ),
        "eval_info.json": "LeRobot's outcomes of episodes.",
    },
    "--history": {
        "0 to 5, or more": "This many last actions are part of the state.",
        "auto": "As many as the held-out error asks for.",
    },
    "--fit": {
        "gravity,length": "Parameters of the task.",
        "body_mass.pole": "A parameter of a MuJoCo model.",
    },
    "--action-noise": {
        "EPS": (
            "Use `simulator.with_action_noise(EPS)`, for a simulator that is too"
            " deterministic for the log."
        ),
    },
    "--impossible": {
        "refuse": "End with an error.",
        "drop": "Leave them out, and let them lead anywhere in the intervals.",
        "allow=EPS": "Use `simulator.with_support_of(log, EPS)`.",
    },
    "--features": _TRANSITION_FILES
    | {"several features": "A last axis, or one column for each."},
    "--tie": _TRANSITION_FILES
    | {"values": "Integer keys; transitions with the same key share one ratio."},
    "--grid": {
        "60x60": "This many vertices along each feature.",
        "3000": "This many cells at observed states.",
        "auto": "The task's own configuration.",
    },
    "evaluate --task-option": {
        "outside=error|drop|nearest": (
            "What to do with states of the log outside the grid; drop leaves out"
            " transitions without support too."
        ),
        "strict=true": (
            "Make actions of the log that are not in the task's set an error, not a"
            " warning."
        ),
        "calibration=ratio|difference|none": "How values on the grid are calibrated.",
        "floor=0.001": "Share of other steps in the simulator on the grid (defensive).",
        "simulations=50000": "Number of Monte Carlo episodes of each policy.",
        "state=MODULE:GET,SET": _STATE,
        "actions=9": _ACTIONS,
        "nothing": "The task's own setting.",
    },
    "--box": {
        "LOWER,UPPER": "Both bounds narrow likelihood and guaranteed intervals.",
        "LOWER,": "Only the lower bound.",
        ",UPPER": "Only the upper bound.",
    },
    "evaluate --estimators": {"NAME": _NAMES, "with --target": _TARGET_NAMES},
    "--rewards": {
        "simulator": "The simulator's rewards.",
        "log": "The log's mean reward where it was observed, else the simulator's.",
    },
    "--guaranteed": {
        "--guaranteed": "Add intervals that are guaranteed at any sample size.",
        "--quick": (
            "Leave out likelihood intervals, which take most of the time of large"
            " problems."
        ),
    },
    "--report": {"TITLE=FILE.html": "The page with a title."},
    "--plan-option": {
        "model=estimate|simulator": "The model at which variances are evaluated.",
        "optimistic=true|false": (
            "Give pairs that the model makes deterministic the largest plausible"
            " variance, or none."
        ),
        "restart=0.01": "Probability that an episode restarts after a transition.",
        "restart_costs_a_move=true|false": (
            "Record one more transition in the state that ended an episode, or not."
        ),
        "solver=auto|CLARABEL": "The solver of the plan.",
    },
    "sample --task-option": {"state=MODULE:GET,SET": _STATE, "actions=9": _ACTIONS},
    "bench --estimators": {
        "evaluate": "What `oee evaluate` prints.",
        "MODULE:OBJECT": "An estimator of your own.",
        "NAME": _NAMES,
        "with the target": _TARGET_NAMES,
    },
}

# exit code -> what it says, of every command
EXIT_CODES = {
    0: "The command did what was asked.",
    1: "The answer is no: `oee check` found a law that does not hold.",
    2: (
        "The command was refused, by one line on stderr: an option, a file, a folder or"
        " the machine does not allow it."
    ),
    3: (
        "The log does not speak for the policy: with `oee compare --expect-best`, the"
        " first one is not found to be the best; `oee improve` has nothing to deploy."
    ),
    130: "Ctrl-C ended it. The next run of `reproduce` and `bench` goes on from there.",
}

# command -> the keys that ``--json`` prints
JSON_KEYS = {
    "evaluate": (
        "version, answer, unit, discount, horizon, normalized, confidence, interval,"
        " seed, facts, results, intervals, best, comparison, trials,"
        " conclusion, warnings"
    ),
    "compare": (
        "version, confidence, best (null if the log cannot say), sentence, policies"
        " (best first), differences (from the best), warnings"
    ),
    "improve": (
        "version, decision (deploy, keep or record), deploy, sentence, policy, gain,"
        " gain_lower, confidence, unrecorded, split, seed, candidates, plan, file,"
        " log_notes"
    ),
    "plan": (
        "version, sampling, n, quantity (value or gain), confidence, status, gap,"
        " policies, most, advice, next, file, log_notes"
    ),
    "sample": "version, file, transitions, episodes",
    "policy": "version, file, states, actions",
    "export": "version, file, states, actions, transitions, discount",
    "counts": "version, file, moves, dropped, invalid",
    "info": "version, file, kind, text",
    "reproduce": "version, lines",
    "bench": "version, lines",
    "check": "version, estimator, passed, seed, conclusion, laws",
}


def details_of(command: str, parameters: Iterable[Any]) -> dict[str, dict[str, str]]:
    """Return the entries of ``DETAILS`` that a command's parameters have.

    Forms of one command alone stand in place of those of all commands.
    """
    found: dict[str, dict[str, str]] = {}
    for parameter in parameters:
        value = (parameter.metavar or "").removeprefix("NAME=")
        option = parameter.opts[0]
        for title, key in (
            (value, f"{command} {value}"),
            (value, value),
            (option, f"{command} {option}"),
            (option, option),
        ):
            if key in DETAILS:
                found.setdefault(title, DETAILS[key])
    return found


def to_markdown(command: str, parameters: Iterable[Any]) -> str:
    """Write the details of a command as lists for the site's page."""
    lines = []
    for title, forms in details_of(command, parameters).items():
        lines += [f"**Values of `{title}`**:", ""]
        lines += [f"* `{form}`: {meaning}" for form, meaning in forms.items()]
        lines.append("")
    if command in JSON_KEYS:
        lines.append(f"**Keys of `--json`**: {JSON_KEYS[command]}.")
    return "\n".join(lines)
