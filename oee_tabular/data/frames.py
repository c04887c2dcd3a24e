"""Logs from data frames of any library, lists of steps, names, and Minari data sets."""

from __future__ import annotations

import decimal
import errno
import importlib.util
import itertools
import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from oee_tabular import _checks, _files, _writing
from oee_tabular.data.labels import (
    ColumnsLike,
    check_columns,
    is_label,
    join_parts,
    match_labels,
    show_labels,
    suggest_columns,
    suggest_label,
    warn_left_out,
    warn_read_as,
)
from oee_tabular.data.rules import (
    COLUMNS,
    MOVE,
    NO_NAMES,
    check_table,
    for_each,
    is_missing,
    settle_episodes,
)
from oee_tabular.exceptions import ArgumentError, DataWarning
from oee_tabular.mdp import (
    Name,
    check_names,
    is_name,
    is_number_text,
    normalize,
    to_plain,
)
from oee_tabular.typing import Column, IntArray

STEP = (
    "(state, action, reward), and after these next_state, terminated and truncated"
    " where they are known"
)


# methods by which frames of other libraries give their rows (dask, Spark, DuckDB)
READ_ROWS = ("compute", "toPandas", "to_pandas", "df")


def is_frame(value: object) -> bool:
    """Return whether ``value`` is an eager or lazy data frame that narwhals knows."""
    if isinstance(value, np.ndarray | Sequence | Mapping):
        return False
    import narwhals as nw

    return bool(
        isinstance(value, nw.DataFrame | nw.LazyFrame)
        or nw.dependencies.is_into_dataframe(value)
        or nw.dependencies.is_polars_lazyframe(value)
    )


def frame_columns(
    frame: object,
    column_names: Mapping[str, object],
    columns: ColumnsLike | None,
    known_names: Mapping[str, tuple[Name, ...] | None] = NO_NAMES,
) -> dict[str, Any]:
    """Return the columns of a log, by the constructor's names, of a data frame.

    ``column_names``: what the frame calls them, by keyword; ``columns``: the same as a
    mapping. ``known_names``: by a log's columns, the simulator's, where it is known.
    Raises an ArgumentError for what is no frame, for columns that it has not, and for
    the first value that is none of a log's.
    """
    labels, series = _read_series(frame)
    named = check_columns(columns)
    for field, names in column_names.items():
        if names is None:
            continue
        group = _find_labels(field, names, labels)
        if field in named and _as_group(named[field], labels) != group:
            raise ArgumentError(
                field,
                f"must be the column that columns names, {_checks.show(named[field])};"
                f" it is {_checks.show(names)}",
            )
        named[field] = group[0] if len(group) == 1 else group

    def require(given: list[Any], taken: Mapping[str, object]) -> None:
        """Raise an ArgumentError where a column of a transition is missing."""
        missing = [field for field in MOVE if field not in taken]
        if not missing:
            return
        hint = "" if len(given) == 1 else suggest_columns(missing, given)
        raise ArgumentError(
            "frame",
            f"must have the columns {', '.join(MOVE)}; it has"
            f" {show_labels(given)}{hint} (say which it is:"
            f" Transitions.from_frame(frame, {missing[0]}='its name', ...))",
        )

    found = match_labels(labels, "frame", named, require, has_capitals=True)
    warn_read_as("the frame", found.renamed)
    raw = {
        field: _join_columns(
            [series(labels.index(label)) for label in group], f"frame: {field}"
        )
        for field, group in found.taken.items()
    }
    values = check_table(
        {field: raw[field] for field in COLUMNS if field in raw},
        "frame",
        names=known_names,
    )
    if "episode" in values:
        values["episode"] = settle_episodes(values["episode"])
    warn_left_out("the frame", found.left_out)
    return values


def _read_series(frame: object) -> tuple[list[Any], Callable[[int], Any]]:
    """Return the labels of a frame, and what returns the column of each place.

    Labels of pandas need be no texts, and need not differ. The levels of its index that
    have names are columns, unless a column has the same name.
    """
    import narwhals as nw

    table: Any = nw.to_native(frame, pass_through=True)
    if nw.dependencies.is_pyarrow_table(table):
        columns = table.columns
        return table.column_names, lambda k: nw.from_native(
            columns[k], series_only=True
        )
    if nw.dependencies.is_pandas_like_dataframe(table):
        labels = table.columns.tolist()
        index = [name for name in table.index.names if name is not None]
        levels = [name for name in index if name not in labels]

        def one(k: int) -> Any:
            """Return the column, or the level of the index, of the k-th label."""
            if k < len(labels):
                return nw.from_native(table.iloc[:, k], series_only=True)
            level = table.index.get_level_values(levels[k - len(labels)])
            return nw.from_native(level.to_series(), series_only=True)

        return [*labels, *levels], one
    narwhal = eager(frame)
    texts = list(narwhal.columns)
    return texts, lambda k: narwhal[texts[k]]


def _join_columns(series: Sequence[Any], place: str) -> Column:
    """Return a column's values, or the tuples of several columns' values."""
    columns = [_column_values(one, place) for one in series]
    if len(columns) == 1:
        return columns[0]
    return join_parts([column.tolist() for column in columns])


def _column_values(column: Any, place: str) -> Column:
    """Return the values of one column of a frame, nan where one is missing.

    Errors call the column ``place``.
    """
    _checks.require_no_unit_of(column.to_native(), place)
    try:
        values = np.asarray(column.to_numpy())
    except Exception as error:  # whatever another library says of its own types
        raise ArgumentError(
            place,
            f"must hold numbers, texts or truth values; it holds {column.dtype}"
            f" ({_checks.first_line(error)})",
        ) from None
    if values.ndim != 1:  # polars makes a table of a column of structs or arrays
        raise ArgumentError(
            place,
            f"must hold numbers, texts or truth values; it holds {column.dtype} (make a"
            " column of each part, and name them: columns={'state': ['x', 'y'], ...})",
        )
    if values.dtype.kind in "Mm":  # which have a sign of their own for a missing one
        return values
    if values.dtype.kind in "UT":
        # names are objects: polars makes texts of one width of a column without gaps
        values = values.astype(object)
    try:
        is_absent = column.is_null().to_numpy()
    except decimal.InvalidOperation:  # a signaling nan, which no library may compare
        is_absent = np.array([is_missing(item) for item in values.tolist()])
    if not is_absent.any():
        return values
    if values.dtype.kind not in "biuf":
        values = values.astype(object)
    return np.where(is_absent, np.nan, values)


def eager(frame: Any) -> Any:
    """Return a frame as narwhals has it, its rows read.

    Raises an ArgumentError for what is no frame, or has a column twice.
    """
    import narwhals as nw

    if not is_frame(frame):
        hint = ""
        if isinstance(frame, str | os.PathLike):
            hint = " (a file: Transitions.load)"
        elif isinstance(frame, Mapping):
            hint = " (columns by their names: pandas.DataFrame(columns))"
        elif (
            isinstance(frame, list | tuple) and frame and isinstance(frame[0], Mapping)
        ):
            hint = " (rows by their names: pandas.DataFrame(rows))"
        way = next((way for way in READ_ROWS if hasattr(type(frame), way)), None)
        if way is not None and not hint:
            hint = f" (whose rows are not read yet: frame.{way}())"
        library = type(frame).__module__.partition(".")[0]
        article = "" if library == "builtins" else f"{library}'s "
        raise ArgumentError(
            "frame",
            "must be a data frame (pandas, polars, arrow); got"
            f" {article}{type(frame).__name__}{hint}",
        )
    try:
        table = nw.from_native(frame)
    except (nw.exceptions.NarwhalsError, ValueError) as error:
        raise ArgumentError(
            "frame", f"must have columns that differ; {_checks.first_line(error)}"
        ) from None
    if not isinstance(table, nw.LazyFrame):
        return table
    try:
        return table.collect()
    except MemoryError:
        raise
    except Exception as error:  # whatever the library says of the query
        raise ArgumentError(
            "frame",
            "must be a lazy frame whose query can be run; it raises"
            f" {type(error).__name__}: {_checks.first_line(error)}",
        ) from None


def _find_labels(field: str, given: object, labels: list[Any]) -> tuple[Any, ...]:
    """Return the frame's labels of one field, several where they make a name."""
    group = _as_group(given, labels)
    for label in group:
        if not is_label(label, labels):
            raise ArgumentError(
                field,
                f"must be the name of a column of the frame, {show_labels(labels)};"
                f" it is {_checks.show(label)}{suggest_label(label, labels)}",
            )
    if not group or (len(group) > 1 and field not in MOVE):
        raise ArgumentError(
            field, f"must be the name of one column; it is {_checks.show(given)}"
        )
    return group


def _as_group(given: object, labels: list[Any]) -> tuple[Any, ...]:
    """Return one label, or several in a list or tuple, as a tuple of them."""
    is_whole = is_label(given, labels)
    if isinstance(given, list | tuple) and not is_whole:
        return tuple(given)
    return (given,)


def episode_columns(episodes: object) -> dict[str, Any]:
    """Return the columns of a log from a list of episodes, each a list of steps.

    ``Transitions.from_episodes`` has the forms.
    """
    given = _checks.collection(
        episodes, "episodes", "a list of episodes, each a list of steps"
    )
    if _are_rows(given):
        raise ArgumentError(
            "episodes",
            "must be a list of episodes, each a list of steps; it is a list of mappings"
            " (rows by their names: pandas.DataFrame(rows))",
        )
    rows: list[tuple[Any, ...]] = []
    n_cut = 0
    for k, episode in enumerate(given):
        steps = _parts(episode, f"episodes[{k}]", f"a list of steps, each {STEP}")
        transitions = _transitions_of(steps, k)
        known = [transition for transition in transitions if len(transition) == 5]
        rows += [(*transition, k) for transition in known]
        n_cut += len(transitions) - len(known)
    if not rows:
        raise ArgumentError(
            "episodes",
            "must have at least one transition whose next state is known; they have"
            " none (end an episode with its last state: [..., (state, action, reward),"
            " (state,)])",
        )
    if n_cut:
        _checks.warn(
            f"the last transitions of {n_cut} episodes are left out, since their next"
            " states are unknown; end an episode with its last state, (state,) or"
            " (state, terminated), to keep them",
            DataWarning,
        )
    labels = ("state", "action", "reward", "next_state", "terminated", "episode")
    columns = [list(column) for column in zip(*rows, strict=True)]
    return dict(zip(labels, columns, strict=True))


def _are_rows(given: Sequence[object]) -> bool:
    """Return whether these are rows, mappings from labels to single values."""
    first = given[0] if given else None
    is_several = (list, tuple, np.ndarray)
    return isinstance(first, Mapping) and not any(
        isinstance(value, is_several) for value in first.values()
    )


def _parts(value: object, name: str, rule: str) -> tuple[Any, ...]:
    """Return the items of a list or tuple; a mapping is refused, as it has no order."""
    if isinstance(value, Mapping):
        keys = ", ".join(map(str, value))
        raise ArgumentError(
            name,
            f"must be {rule}; it is a mapping of {keys:.200} (give its values, in the"
            " order above)",
        )
    return _checks.collection(value, name, rule)


def _transitions_of(given: tuple[Any, ...], episode: int) -> list[tuple[Any, ...]]:
    """Return (state, action, reward, next_state, terminated) of each step.

    A step has no next_state where nothing says where it led.
    """
    steps = [
        _parts(step, f"episodes[{episode}][{t}]", f"a step, {STEP}")
        for t, step in enumerate(given)
    ]
    has_end = len(steps) > 1 and len(steps[-1]) in (1, 2)
    end = steps.pop() if has_end else ()
    for t, step in enumerate(steps):
        place = f"episodes[{episode}][{t}]"
        rule = f"must be a step, {STEP}"
        if len(step) not in (3, 4, 5, 6):
            raise ArgumentError(place, f"{rule}; it has {len(step)} parts")
        if isinstance(step[2], str | tuple | list | Mapping):
            raise ArgumentError(place, f"{rule}; its reward is {step[2]!r:.80}")
    if len(end) == 2 and end[1] not in (0, 1):
        hint = ""
        if isinstance(steps[0][0], tuple):
            hint = f" (of a state that is a tuple: ({end!r:.80},))"
        place = f"episodes[{episode}][{len(steps)}]"
        raise ArgumentError(
            place,
            "must be (state,) or (state, terminated), the end; it is"
            f" {end!r:.80}{hint}",
        )
    transitions = []
    for step, following in zip(steps, [*steps[1:], end], strict=False):
        next_state = (step[3:4] or following)[:1]
        if len(step) > 4:
            is_over = step[4]
        else:
            is_over = following is end and len(end) == 2 and end[1]
        transitions.append((*step[:3], *next_state, is_over))
    return transitions


def number_in_order(
    items: Sequence[Any], first: dict[Any, int] | None = None
) -> tuple[IntArray, dict[Any, int]]:
    """Number distinct items in the order in which they first occur.

    The numbers follow those that ``first`` has.
    """
    number = {} if first is None else first
    for item in dict.fromkeys(items):
        number.setdefault(item, len(number))
    codes = map(number.__getitem__, items)
    return np.fromiter(codes, dtype=np.int64, count=len(items)), number


def encode_names(
    columns: dict[str, Any], given: object, name: str
) -> tuple[list[Any], tuple[Name, ...] | None]:
    """Return columns of names as numbers, with the names.

    Columns of numbers stay as they are, with the names that were given.
    """
    found = {}
    for column, value in columns.items():
        items = _names_in(value, column)
        if items is not None:
            found[column] = items
    # the column that is not in numbers is refused by its reader
    if len(found) < len(columns):
        if given is None:
            return list(columns.values()), None
        several = _checks.collection(given, name, "a sequence of texts or tuples")
        return list(columns.values()), check_names(several, name, len(several))
    if given is not None:
        raise ArgumentError(
            next(iter(found)),
            f"must hold numbers where {name} are given; it holds names",
        )
    first: dict[Name, int] = {}
    codes = [number_in_order(items, first)[0] for items in found.values()]
    names = list(first)

    def find_place(k: int) -> str:
        """Return where the k-th name occurs first."""
        columns = ((column, items) for column, items in found.items())
        return next(
            f"{c}[{items.index(names[k])}]" for c, items in columns if names[k] in items
        )

    return list(codes), check_names(names, name, len(names), find_place)


def _names_in(value: object, name: str) -> list[Any] | None:
    """Return the items of a column of names, or None for a column of anything else.

    The column's own reader judges what is no name.
    """
    if type(value) is np.ndarray and value.dtype.kind not in "UO":
        return None  # without a copy
    array = value if isinstance(value, list | tuple) else _checks.as_array(value, name)
    if isinstance(array, np.ndarray):
        may_be_names = array.dtype.kind in "UO" and array.ndim == 1
        if not may_be_names:
            return None
    items = list(array)
    is_sequence = bool(items) and isinstance(items[0], list | np.ndarray)
    if not items or (is_sequence and array is value) or not is_name(to_plain(items[0])):
        return None
    names = for_each(_composed, items)
    try:
        distinct = dict.fromkeys(names)
    except TypeError as error:
        raise ArgumentError(name, f"must be a column of names; {error}") from None
    odd = [item for item in distinct if not _is_column_name(item)]
    if len(odd) == len(distinct):
        return None
    if odd:
        k = names.index(odd[0])
        raise ArgumentError(
            f"{name}[{k}]",
            f"must be a name, as others of the column are; it is {odd[0]!r:.80}",
        )
    return names


def _composed(item: Any) -> Any:
    """Return a text in its composed form, and any other item as plain Python's."""
    return normalize(item) if type(item) is str else to_plain(item)


def _is_column_name(item: Any) -> bool:
    """Return whether an item is a name that does not read as a number."""
    reads_as_number = isinstance(item, str) and is_number_text(item)
    return is_name(item) and not reads_as_number


FOLDER = "MINARI_DATASETS_PATH"  # the variable that says where Minari has its data sets


def is_minari(name: str) -> bool:
    """Return whether ``name`` is a Minari folder or id rather than a file.

    Raises FileNotFoundError where it can be neither.
    """
    has_suffix = Path(name).suffix != ""
    is_marked = name.startswith("minari:")
    is_plain = not has_suffix and not is_marked and "/" not in name
    if is_plain and not Path(name).exists():
        raise FileNotFoundError(2, "no such file", name)
    is_id = is_marked or ("/" in name and "-v" in name)
    return not has_suffix or is_id or Path(name).is_dir()


def require_minari() -> None:
    """Raise an ImportError that names the extra where Minari is missing."""
    if importlib.util.find_spec("minari") is None:
        raise ImportError(
            "minari is not installed; in a clone: pip install '.[minari]'"
        )


def find_folder(identifier: str) -> Path:
    """Return the folder of a Minari id.

    Raises an ArgumentError, before any folder is made, for what is none.
    """
    from minari.dataset.minari_dataset import parse_dataset_id
    from minari.storage.datasets_root_dir import get_dataset_path

    try:
        parse_dataset_id(identifier)
    except (TypeError, ValueError):  # TypeError: no version
        raise ArgumentError(
            "path",
            "must be a Minari id, minari:namespace/name-v0, of letters, digits, - and"
            f" _; it is {identifier!r}",
        ) from None
    return Path(get_dataset_path(identifier))


def find_new_folder(name: str, argument: str = "path") -> Path:
    """Return where the Minari data set ``name`` belongs, if nothing is there yet."""
    require_minari()
    is_id = name.startswith("minari:")
    target = find_folder(name.removeprefix("minari:")) if is_id else Path(name)
    if os.path.lexists(target):
        raise ArgumentError(
            argument, f"must be a new folder; {str(target)!r} exists already"
        )
    return target


def save_minari(log: Any, name: str) -> None:
    """Make the data set in a folder of its own, then move it to where it belongs."""
    # asyncio comes with it, for which every command would wait .04 s
    from unittest import mock

    target = find_new_folder(name)
    _require_minari_columns(log)
    is_id = name.startswith("minari:")
    identifier = name.removeprefix("minari:") if is_id else "oee/log-v0"
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        absolute = target.parent.absolute()  # Minari joins a relative one twice
        with _writing.folder_part(absolute, target.name) as root:
            with mock.patch.dict(os.environ, {FOLDER: str(root)}):
                _write_minari(log, identifier)
            find_new_folder(name)  # moving would replace an empty one
            os.replace(root / identifier, target)
    except OSError as error:  # of a file inside, or of none
        if error.errno in (errno.ENOTEMPTY, errno.EEXIST):
            find_new_folder(name)  # another process has made it
        number = error.errno or errno.EIO
        raise OSError(
            number, f"cannot be written ({os.strerror(number)})", str(target)
        ) from None


def _require_minari_columns(log: Any) -> None:
    """Raise an ArgumentError where a log cannot be a Minari data set."""
    if log.state_names or log.action_names:
        raise ArgumentError(
            "log",
            "must be in numbers to be a Minari data set; this one has names:"
            " log.numbered(simulator)",
        )
    if log.episode is None or log.reward is None:
        lacking = "episodes" if log.episode is None else "rewards"
        raise ArgumentError(
            "log", f"must have {lacking} to be a Minari data set; this one has none"
        )


def _write_minari(log: Any, identifier: str) -> None:
    """Write the episodes of a log as a Minari data set."""
    import minari
    from gymnasium import spaces
    from minari.data_collector import EpisodeBuffer

    buffers = []
    for k, (low, high) in enumerate(itertools.pairwise(log.episode_starts)):
        buffer = EpisodeBuffer(
            id=k,
            observations=np.append(log.state[low:high], log.next_state[high - 1]),
            actions=np.array(log.action[low:high]),
            rewards=list(log.reward[low:high]),
            terminations=list(log.terminated[low:high]),
            truncations=list(log.truncated[low:high]),
            infos={},
        )
        if log.behavior_probability is not None:
            buffer.infos["behavior_probability"] = np.append(
                log.behavior_probability[low:high], np.nan
            )[:, None]
        buffers.append(buffer)
    n_states = int(max(log.state.max(), log.next_state.max())) + 1
    with warnings.catch_warnings():
        # Minari asks for an author, a code link and an environment
        warnings.simplefilter("ignore")
        minari.create_dataset_from_buffers(
            identifier,
            buffers,
            observation_space=spaces.Discrete(n_states),
            action_space=spaces.Discrete(int(log.action.max()) + 1),
            data_format="arrow",
        )


def minari_episodes(name: str) -> list[Any]:
    """Return the episodes of a Minari folder or id, as Minari gives them."""
    require_minari()
    from minari.dataset.minari_dataset import MinariDataset

    folder = Path(_files.local(name))
    reason = ""
    if not folder.is_dir():
        try:
            folder = find_folder(name.removeprefix("minari:"))
        except ValueError as error:
            reason = f": {error}"
    if folder.exists() and not folder.is_dir():
        _files.require_regular(folder)
    if not folder.is_dir():
        raise FileNotFoundError(
            f"{name!r} is neither a file nor a Minari folder or id on this"
            f" machine{reason}"
        )
    for file in folder.rglob("*"):
        if not file.is_dir():
            _files.require_regular(file)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            has_data_folder = (folder / "data").is_dir()
            data = MinariDataset(folder / "data" if has_data_folder else folder)
            return list(data.iterate_episodes())
    except MemoryError:
        raise
    except Exception as error:  # whatever Minari makes of files that are not its own
        raise ArgumentError(
            f"{name!r}",
            f"must be a Minari data set; {str(error) or type(error).__name__:.300}",
        ) from None


MINARI = ("state", "action", "next_state", "reward", "terminated", "truncated")


def minari_columns(
    name: str,
    check: Callable[[Column, Column, str], None],
    column_names: ColumnsLike,
    reported: set[Any],
) -> dict[str, Column]:
    """Return a Minari data set as columns.

    ``check(observations, actions, name)`` refuses an episode that is none of the log's.
    ``column_names`` may say which of the infos is the behaviour probability; else it is
    found as in a table. What is read so is warned of once (``reported``).
    """
    odd = [field for field in column_names if field != "behavior_probability"]
    if odd:
        raise ArgumentError(
            "columns",
            "must name behavior_probability alone for a Minari data set, which has its"
            f" own columns; it names {odd[0]}",
        )
    parts: list[dict[str, Column]] = []
    for number, episode in enumerate(minari_episodes(name)):
        observations = np.asarray(episode.observations)
        actions = np.asarray(episode.actions)
        check(observations, actions, name)
        columns = {
            "state": observations[:-1],
            "action": actions,
            "next_state": observations[1:],
            "reward": np.asarray(episode.rewards, dtype=np.float64),
            "terminated": np.asarray(episode.terminations, dtype=np.bool_),
            "truncated": np.asarray(episode.truncations, dtype=np.bool_),
            "episode": np.full(len(actions), number),
        }
        infos = episode.infos or {}
        own = [*MINARI, "episode"]
        found = match_labels(
            [*own, *(label for label in infos if label not in own)],
            repr(name),
            column_names,
            lambda given, taken: None,
        )
        new = [pair for pair in found.renamed if pair not in reported]
        reported.update(new)
        warn_read_as(repr(name), new)
        for label in found.taken.get("behavior_probability", ()):
            recorded = infos[label]
            # Minari has one more of each info than of actions
            probability = np.asarray(recorded, dtype=np.float64).reshape(-1)
            columns["behavior_probability"] = probability[: len(actions)]
        parts.append(columns)
    if len({len(part) for part in parts}) > 1:
        raise ArgumentError(
            f"{name!r}", "must record behavior_probability in every episode or in none"
        )
    labels = parts[0] if parts else {}
    return {label: np.concatenate([part[label] for part in parts]) for label in labels}
