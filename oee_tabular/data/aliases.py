"""Labels that other projects give to the columns of a log.

``ALIASES`` mean one thing, ``DOUBTS`` two or more, or one in another form. They are
those of Gym, Gymnasium, Stable-Baselines3, RLlib, D4RL, d3rlpy, Minari, Tianshou,
Spinning Up, TF-Agents, RLDS, LeRobot, robomimic, Acme, Open Bandit and SCOPE-RL, as
``plain`` writes them. Labels that an episode is over are known by their words as well.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple, TypeVar

_T = TypeVar("_T")
NUMBERED = re.compile(r"(state|action|next_state)_(0|[1-9][0-9]{0,8})")

# labels of other projects that mean one thing
ALIASES = {
    "state": (
        "states s current_state cur_state state_id prev_state previous_state old_state"
        " from_state obs observation observations ob obs_t state_t s_t current_obs"
        " current_observation prev_obs previous_obs last_obs observation_state"
    ),
    "action": (
        "actions a act acts action_id action_taken taken_action actions_taken action_t"
        " a_t chosen_action"
    ),
    "next_state": (
        "next_states state_next states_next new_state new_states next_state_id s_next"
        " next_s s_prime sprime s' s2 sp s_ s1 s_tp1 state_prime state_tp1 to_state"
        " successor successor_state next_obs next_ob obs_next new_obs obs_tp1 obs2"
        " obs_prime next_observation next_observations observation_next"
        " observations_next new_observation new_observations next_observation_state"
    ),
    "reward": "rewards r rew rews r_t reward_t rwd",
    "terminated": (
        "terminateds termination terminations terminate terminal terminals is_terminal"
        " is_terminated terminal_flag terminal_flags"
    ),
    "truncated": (
        "trunc truncs truncateds truncation truncations truncate is_truncated timeout"
        " timeouts time_out time_outs is_timeout timed_out timelimit_truncated"
        " time_limit_truncated time_limit_reached truncated_flag"
    ),
    "episode": (
        "episodes episode_id episode_ids episode_index episode_idx episode_number"
        " episode_num episode_no episode_nr episodes_id id_episode ep ep_id ep_index"
        " ep_idx ep_num ep_no eps_id eps_idx traj traj_id traj_ids traj_index traj_idx"
        " traj_num trajectory trajectory_id trajectory_ids trajectory_index"
        " trajectory_idx trajectory_number rollout_id rollout_index demo_id demo_index"
    ),
    "timestep": (
        "timesteps time_step time_steps episode_step episode_steps episode_timestep"
        " step_in_episode ep_step elapsed_steps"
    ),
    "behavior_probability": (
        "action_prob action_probability behavior_prob behavior_probs behaviour_prob"
        " behaviour_probs behavior_action_prob behaviour_action_prob"
        " behavior_policy_prob behaviour_policy_prob behavior_policy_probability"
        " behaviour_policy_probability logging_prob logging_probability"
        " logging_propensity propensity propensities propensity_score pscore"
    ),
}
# words that say that an episode is over, and those that may stand beside them
WORDS_OF_ENDS = {
    "terminated": (
        "terminal terminals terminate terminates terminated termination terminations"
    ),
    "truncated": "trunc truncs truncate truncates truncated truncation truncations",
    "either": "done dones end ends ended finished final over",
    "opposite": "not non",
    "flag": "flag flags is has was",
    "other": (
        "state episode ep trajectory traj rollout game task env environment of the or"
        " and next"
    ),
}
KIND_OF_WORD = {
    word: kind for kind, words in WORDS_OF_ENDS.items() for word in words.split()
}


class _Labels(Mapping[str, _T]):
    """Map labels to what they mean: the listed ones, and others by a rule."""

    def __init__(self, listed: dict[str, _T], rule: Callable[[str], _T | None]) -> None:
        self.listed = listed
        self.rule = rule

    def __getitem__(self, label: str) -> _T:
        found = self.listed.get(label)
        if found is None:
            found = self.rule(label)
        if found is None:
            raise KeyError(label)
        return found

    def __iter__(self) -> Iterator[str]:
        return iter(self.listed)

    def __len__(self) -> int:
        return len(self.listed)


def _kinds_of_end(label: str) -> set[str]:
    """Return the kinds of words of a label that says that an episode is over, or none.

    All its words must have one: end_flag is such a label, end_time is none. The first
    may be the group of a file, data/done.
    """
    words = label.split("_")
    if len(words) > 1 and words[0] == "data":
        del words[0]
    kinds = {KIND_OF_WORD.get(word, "") for word in words}
    is_end = "" not in kinds and not kinds.isdisjoint(
        ("terminated", "truncated", "either")
    )
    return kinds if is_end else set()


def _field_of_end(label: str) -> str | None:
    """Return the column of a label whose words say that one thing ended, or None."""
    kinds = _kinds_of_end(label)
    words = label.split("_")
    # of another row, or terminal_state, which may be a state
    if "next" in words or ("state" in words and "flag" not in kinds):
        return None
    fields = kinds - {"flag", "other"}
    return fields.pop() if fields in ({"terminated"}, {"truncated"}) else None


def _doubt_of_end(label: str) -> Doubt | None:
    """Return the doubt about a label of ends that may mean several things, or None."""
    kinds = _kinds_of_end(label)
    if not kinds or label in FIELDS:
        return None
    return _OPPOSITE if "opposite" in kinds else END


FIELDS: Mapping[str, str] = _Labels(
    {
        alias: field
        for field, aliases in ALIASES.items()
        for alias in (field, *aliases.split())
    },
    _field_of_end,
)


# labels of the probability of a policy's action, in a table of a policy
POLICY_PROBABILITY = {
    "probability",
    "probabilities",
    "prob",
    "probs",
    "p",
    "pi",
    "action_probability",
    "action_probabilities",
    "action_prob",
    "action_probs",
    "policy_probability",
    "policy_probabilities",
    "policy_prob",
    "policy_probs",
}


class Doubt(NamedTuple):
    """Describe a label that may hold several columns, or one in another form.

    ``fields``: the columns that it may hold as it stands. ``settled_by``: columns with
    any set of which a log loses nothing without it.
    """

    fields: tuple[str, ...]
    meaning: str
    settled_by: tuple[frozenset[str], ...]


END = Doubt(
    ("terminated", "truncated"),
    "may say that the task ended (terminated), or that the recording stopped"
    " (truncated), or both",
    (frozenset({"terminated"}),),
)
_OPPOSITE = Doubt(
    (),
    "may be the opposite of terminated, 1 while the task goes on: then write a column"
    " terminated",
    (frozenset({"terminated"}),),
)
_COUNTER = Doubt(
    ("timestep",),
    "may count from 0 in each episode (timestep), or through the whole recording",
    (frozenset({"timestep"}), frozenset({"episode"})),
)
_TIME_OR_END = Doubt(
    ("timestep", "terminated"),
    "may be the time in an episode (timestep), or say that the task ended (terminated)",
    (frozenset({"timestep", "terminated"}), frozenset({"episode", "terminated"})),
)
_START = Doubt(
    (),
    "marks where episodes begin: write a column episode that numbers them, its"
    " cumulative sum",
    (frozenset({"episode"}),),
)
_STEP_TYPE = Doubt(
    (),
    "marks where episodes begin and end: write a column episode that numbers them, and"
    " terminated, true where the task ended",
    (frozenset({"episode", "terminated"}),),
)
_LOGARITHM = Doubt(
    (),
    "is the logarithm of a probability: write a column behavior_probability of its"
    " exponentials",
    (frozenset({"behavior_probability"}),),
)
_PROBABILITY = Doubt(
    ("behavior_probability",),
    "may be the probability with which the recorded action was taken"
    " (behavior_probability), or another one",
    (frozenset({"behavior_probability"}),),
)
# with episodes or times, each row is a step
_COUNT = Doubt(
    (),
    "may say how many transitions a row stands for, and a log has one row for each:"
    " repeat the rows, frame.loc[frame.index.repeat(frame[LABEL])] in pandas",
    (frozenset({"episode"}), frozenset({"timestep"})),
)
_REWARD = Doubt(
    ("reward",),
    "may be the reward of its own row, or that of the next one",
    (frozenset({"reward"}),),
)
_LISTED_DOUBTS = {
    label: doubt
    for doubt, labels in (
        (
            END,
            "done dones d is_done done_flag dones_float next_done next_dones finished"
            " is_finished over is_over game_over gameover end ends ended is_end"
            " episode_end episode_ended episode_ends end_of_episode episode_over"
            " episode_done last is_last is_last_step last_step final is_final"
            " terminated_or_truncated term terms",
        ),
        (
            _OPPOSITE,
            "not_done not_dones nonterminal nonterminals non_terminal non_terminals"
            " not_terminal not_terminated mask masks continue continues cont discounts"
            " discount",
        ),
        (
            _COUNTER,
            "step steps step_id step_index step_idx step_number step_num step_no"
            " step_count frame frame_id frame_index frame_idx frame_number",
        ),
        (_TIME_OR_END, "t"),
        (_START, "is_first first is_first_step first_step is_start is_reset"),
        (_STEP_TYPE, "step_type next_step_type"),
        (
            _LOGARITHM,
            "logp log_p logp_a log_prob logprob log_probs logprobs log_probability"
            " log_probabilities log_pi logpi logp_pi old_logp old_log_prob old_log_probs"
            " action_logp action_log_p action_logprob action_logprobs action_log_prob"
            " action_log_probs action_log_probability log_prob_action log_action_prob"
            " behavior_logp behavior_log_prob behavior_log_probs behavior_logprob"
            " behavior_log_probability behaviour_logp behaviour_log_prob"
            " behaviour_log_probs behaviour_logprob behaviour_log_probability"
            " log_behavior_probability log_behaviour_probability log_propensity",
        ),
        (
            _PROBABILITY,
            "prob probs probability probabilities action_probs action_probabilities"
            " policy_prob policy_probs policy_probability",
        ),
        (
            _COUNT,
            "count counts cnt n n_transitions n_samples n_visits n_rows n_obs num_rows"
            " num_transitions num_samples num_visits number_of_transitions visits"
            " visit_count visit_counts transition_count transition_counts row_count"
            " sample_count sample_size size freq freqs frequency frequencies occurrences"
            " multiplicity repeats 0",
        ),
        (_REWARD, "next_reward next_rewards"),
    )
    for label in labels.split()
}


DOUBTS: Mapping[str, Doubt] = _Labels(_LISTED_DOUBTS, _doubt_of_end)
# what resembles a log's labels and is something else
OTHER_WORDS = {
    "timestamp",
    "timestamps",
    "time_stamp",
    "behavior_policy",
    "behaviour_policy",
    "episodic",
    "forward",
}


# A label with a letter wrong is found among labels of this many letters and more. Among
# shorter ones, too many words are near.
MIN_LETTERS_OF_MISSPELT = 8
WORDS_AFTER_P = {"next", "state", "transition", "s"}
WORDS_OF_PROBABILITY = {"prob", "probs", "proba", "probas", "p"}


def find_near_label(text: str) -> str | None:
    """Return the label of this table that a plain text misspells, or None.

    Texts with other numbers are no misspellings, but columns of a series.
    """
    near = [
        label
        for label in (*FIELDS, *DOUBTS)
        if len(label) >= MIN_LETTERS_OF_MISSPELT
        and abs(len(label) - len(text)) <= 2
        and (label[:3] == text[:3] or label[-3:] == text[-3:])
        and re.findall(r"\d+", label) == re.findall(r"\d+", text)
    ]
    found = difflib.get_close_matches(text, near, n=1, cutoff=0.9)
    return found[0] if found else None


def resembles_probability(label: Any) -> bool:
    """Return whether a word of a label means a probability, or misspells that word.

    >>> resembles_probability("probabilty"), resembles_probability("availability")
    (True, False)
    """
    # p stands for it alone or before what it is of, not in p_id or p_value
    words = plain(label)[:80].split("_")
    if "p" in words[:-1] and words[-1] not in WORDS_AFTER_P:
        words = [word for word in words if word != "p"]
    return any(
        word in WORDS_OF_PROBABILITY
        or difflib.get_close_matches(word, ["probability", "probabilities"], cutoff=0.8)
        for word in words
    )


def stem(field: str) -> str:
    """Return the log's column that a label names, whole or by one coordinate."""
    match = NUMBERED.fullmatch(field)
    return match[1] if match else field


def find_field(label: Any, has_vectors: bool) -> str | None:
    """Return the only column or coordinate that a label can mean, or None."""
    text = plain(label)
    field = FIELDS.get(text)
    if field is not None or not has_vectors:
        return field
    start, _, number = text.rpartition("_")
    vector = FIELDS.get(start)
    numbered = f"{vector}_{number}"
    return numbered if NUMBERED.fullmatch(numbered) else None


def plain(label: Any) -> str:
    """Return a label in lower case, with one underscore for what parts its words.

    The parts of a label that is a tuple are joined.

    >>> plain("Next State"), plain("nextState"), plain("next.state"), plain("state[0]")
    ('next_state', 'next_state', 'next_state', 'state_0')
    """
    if isinstance(label, tuple):
        label = "_".join(part for part in label if isinstance(part, str) and part)
    if not isinstance(label, str):
        return ""
    text = label.strip(" \t\ufeff")
    if len(text) > 1 and text[0] == text[-1] and text[0] in "\"'":
        text = text[1:-1]
    text = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", text).lower()
    if re.fullmatch(r"\w_", text):  # s_, the state after s
        return text
    return re.sub(r"[\s\-./:\[\]()_]+", "_", text).strip("_") or text
