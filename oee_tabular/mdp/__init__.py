"""Finite Markov decision processes (S, A, P, r, mu_0, gamma) and policies.

A model has these arrays (the paper's eq. 3.4), each of which is checked once, on input,
with errors that name argument, place, rule and value; then it is read-only::

    P(s' | s, a)       (S*A, S), row s*A + a: nonnegative, rows sum to 1 to 1e-8
    r(s), r(s, a)      (S, A), of a step in s
    r(s, a, s')        (S*A, S) like P: belongs to the transition; undefined where
                       neither P nor the caller defines it
    mu_0(s), gamma     (S,), a distribution; in [0, 1]
    pi(a | s)          (S, A), rows sum to 1; (T, S, A) where a function has a horizon T

The value of a policy (eq. 3.1) is J(pi) = E[sum_t gamma^t r_t], s_0 ~ mu_0, a_t ~ pi(.
| s_t), s_{t+1} ~ P(. | s_t, a_t). Where rewards depend on s',

    r(s, a) = sum_s' P(s' | s, a) r(s, a, s'),

which has the same J. It does not replace r(s, a, s') where a transition is weighted by
a ratio, E[zeta r(s, a, s')], and it is averaged again when P changes
(``with_transitions``); a new transition whose reward is undefined is an error.

Where an action cannot be taken in a state (``available[s, a]`` is False), its row of P
is empty, r(s, a) = 0, and a policy has pi(a | s) = 0. Means and best actions are then
over the actions that can be taken.

A *terminal* state is closed, P(s | s, a) = 1 for each a, and has reward 0. A transition
that terminates on entering s leads to ``terminal_state[s]``: s itself, or a twin
appended to the environment's S0 states where s is also entered alive. A *layout* (S, c)
gives states coordinates; displacements layout[s'] - layout[s] define which transitions
are alike.

- ``finite_mdp``: ``FiniteMDP``, the model, its constructors, and the MDPs that differ
  from it in one argument
- ``arrays``: rules of its arrays; the csr arrays of P and r(s, a, s')
- ``support``: action noise, P_eps = (1 - eps) P + eps mean_b P(. | s, b); support for
  the transitions of a log
- ``policies``: pi in each form that people have it, as (S, A)
- ``policy_frames``: the calls that make such a form of a DataFrame
- ``naming``: names of states and actions, and their numbers
- ``gymnasium_table``: outcomes of actions as the arrays of an MDP; the P of a toy-text
  environment
- ``logs``: what an MDP reads of a log
- ``empirical``: n(s, a, s') / n(s, a) of a log or of samples, how many there are of
  each pair, and the variance of mean rewards (``tasks.exploring`` draws samples of an
  environment)
- ``environments``: what a Gymnasium environment is, and the numbers that it gives
- ``rows``: sums, means and exponential tilts over the rows of P; displacements
- ``files``: the arrays of an npz file
- ``umb``, ``umb_files``: the .umb files of model checkers
- ``env``: the MDP as a Gymnasium environment
- ``horizons``: how many steps of a horizon a discount leaves visible
"""

from oee_tabular.mdp.arrays import CsrArrays as CsrArrays
from oee_tabular.mdp.arrays import check_layout as check_layout
from oee_tabular.mdp.arrays import csr_from_entries as csr_from_entries
from oee_tabular.mdp.arrays import name_transition as name_transition
from oee_tabular.mdp.empirical import NUMBERS_PER_PAIR as NUMBERS_PER_PAIR
from oee_tabular.mdp.environments import require_environment as require_environment
from oee_tabular.mdp.finite_mdp import KIND as KIND
from oee_tabular.mdp.finite_mdp import FiniteMDP
from oee_tabular.mdp.gymnasium_table import Outcomes as Outcomes
from oee_tabular.mdp.gymnasium_table import build_arguments as build_arguments
from oee_tabular.mdp.horizons import SHORT_HORIZON as SHORT_HORIZON
from oee_tabular.mdp.horizons import horizon_length as horizon_length
from oee_tabular.mdp.horizons import limit_horizon as limit_horizon
from oee_tabular.mdp.horizons import optional_horizon_length as optional_horizon_length
from oee_tabular.mdp.horizons import possible_sums as possible_sums
from oee_tabular.mdp.horizons import total_discount as total_discount
from oee_tabular.mdp.logs import source_of_row as source_of_row
from oee_tabular.mdp.naming import NAMELESS as NAMELESS
from oee_tabular.mdp.naming import Name as Name
from oee_tabular.mdp.naming import Names as Names
from oee_tabular.mdp.naming import NamesLike as NamesLike
from oee_tabular.mdp.naming import check_names as check_names
from oee_tabular.mdp.naming import find_misspelt as find_misspelt
from oee_tabular.mdp.naming import find_misspelt_ends as find_misspelt_ends
from oee_tabular.mdp.naming import from_text as from_text
from oee_tabular.mdp.naming import initial_distribution as initial_distribution
from oee_tabular.mdp.naming import is_name as is_name
from oee_tabular.mdp.naming import is_number_text as is_number_text
from oee_tabular.mdp.naming import name_text as name_text
from oee_tabular.mdp.naming import normalize as normalize
from oee_tabular.mdp.naming import number_of as number_of
from oee_tabular.mdp.naming import numbers_of as numbers_of
from oee_tabular.mdp.naming import renumber as renumber
from oee_tabular.mdp.naming import suggest_name as suggest_name
from oee_tabular.mdp.naming import to_plain as to_plain
from oee_tabular.mdp.naming import to_text as to_text
from oee_tabular.mdp.places import place_names as place_names
from oee_tabular.mdp.policies import check_policies as check_policies
from oee_tabular.mdp.policies import check_policy, mix, uniform_policy
from oee_tabular.mdp.policies import deterministic_policy as deterministic_policy
from oee_tabular.mdp.policies import has_all_actions as has_all_actions
from oee_tabular.mdp.policies import read_policy_array as read_policy_array
from oee_tabular.mdp.policies import require_available as require_available
from oee_tabular.mdp.policies import shape_of as shape_of
from oee_tabular.mdp.policies import split_policies as split_policies
from oee_tabular.mdp.policy_frames import number_actions as number_actions
from oee_tabular.mdp.rows import BLOCK as BLOCK
from oee_tabular.mdp.rows import DIGITS as DIGITS
from oee_tabular.mdp.rows import Rows as Rows
from oee_tabular.mdp.rows import displacements
from oee_tabular.mdp.rows import distinct_rows as distinct_rows
from oee_tabular.mdp.rows import reduce_rows as reduce_rows
from oee_tabular.mdp.rows import round_displacements as round_displacements
from oee_tabular.mdp.support import mean_available as mean_available
from oee_tabular.mdp.support import require_available_rows as require_available_rows
from oee_tabular.mdp.support import require_same_available as require_same_available

# what users find here; what is imported above "as" itself is for other rooms alone
__all__ = ["FiniteMDP", "check_policy", "displacements", "mix", "uniform_policy"]
