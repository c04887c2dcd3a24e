"""Logs as files: npz, CSV, parquet and Minari data sets, whole or not at all."""

from __future__ import annotations

import glob
import os
import shutil
import tempfile
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oee_tabular import _files
from oee_tabular._checks import Column
from oee_tabular.data.tables import csv_frame, parquet_frame, plain_csv, require_columns, require_module, warn_left_out
from oee_tabular.mdp.naming import Name, from_text, to_text

TABLES = (".csv", ".parquet")
MOVE = ("state", "action", "next_state")
COLUMNS = (
    "state",
    "action",
    "next_state",
    "reward",
    "terminated",
    "truncated",
    "episode",
    "timestep",
    "behavior_probability",
)
FLAG = "U6"  # True, False, 0 or 1, and a letter that would be too many
TYPES = dict(zip(COLUMNS, ("i8", "i8", "i8", "f8", FLAG, FLAG, "i8", "i8", "f8"), strict=True))
Columns = dict[str, Column]


class Format:
    """Logs of numbered states as files; a log of other states overrides what differs."""

    kind = "transitions"  # of an npz
    required = MOVE
    way = (
        "; in Python, several to a state as well: Transitions.from_frame(frame, state='its name', ...).save('log.csv')"
    )
    endings = ".npz, .csv, .parquet, or be a Minari folder or id"

    def known(self, label: str) -> bool:
        """Whether a table's column is one of a log's."""
        return label in COLUMNS

    def flat(self, columns: Columns) -> Columns:
        """The columns of a table, each (n,); tuples as texts."""
        return {name: _texts(column) if column.dtype.hasobject else column for name, column in columns.items()}

    def stored(self, columns: Columns) -> Columns:
        """The columns of an npz: names as texts."""
        return {name: to_text(column) if column.dtype.hasobject else column for name, column in columns.items()}

    def read(self, arrays: Columns) -> Columns:
        """The columns of a log, of those of an npz."""
        return {
            name: as_objects(from_text(array, name)) if array.dtype.kind == "U" else array
            for name, array in arrays.items()
        }

    def gathered(self, flat: Columns, name: str) -> Columns:
        """The columns of a log, of those of the table ``name``."""
        return flat

    def require(self, columns: Columns, labels: Sequence[str], name: str) -> None:
        """ValueError where a file with these labels is no log of this kind."""
        require_columns(repr(name), self.required, labels, way=self.way)

    def check_episode(self, observations: Column, actions: Column, name: str) -> None:
        """ValueError where a Minari episode is none of such a log."""
        if observations.ndim != 1 or observations.dtype.kind not in "iu" or actions.dtype.kind not in "iu":
            raise ValueError(
                f"{name!r} must have discrete observations and actions; they have shapes {observations.shape} of "
                f"{observations.dtype} and {actions.shape} of {actions.dtype}"
            )

    def save_data_set(self, log: object, name: str) -> None:
        """Write a Minari data set."""
        _save_minari(log, name)

    def refuse(self, name: str) -> ValueError:
        """The error for an ending that is not known."""
        return ValueError(f"path must end in {self.endings}; it is {name!r}")


def save(log: Any, form: Format, path: str | os.PathLike[str]) -> None:
    """Write ``log`` in the format that the path's ending names."""
    name = _files.local(path)
    suffix = Path(name).suffix.lower()
    if name.startswith("minari:") or suffix == "":
        form.save_data_set(log, name)
    elif suffix == ".npz":
        _files.save_npz(name, form.kind, form.stored(log.columns()))
    elif suffix in TABLES:
        import pandas as pd

        frame = pd.DataFrame(form.flat(log.columns()))
        if suffix == ".parquet":
            require_module("pyarrow", "parquet")
        with _files.whole_file(name) as handle:
            (frame.to_csv if suffix == ".csv" else frame.to_parquet)(handle, index=False)
    else:
        raise form.refuse(name)


def load(form: Format, path: str | os.PathLike[str]) -> Columns:
    """The columns of a log in the format that the path's ending names; unknown ones are left out with a warning."""
    name = _files.local(path)
    suffix = Path(name).suffix.lower()
    if suffix == ".npz":
        columns = _files.load_npz(name, form.kind)
        columns.pop(_files.KIND)
        labels = list(columns)
        with _files.parts_of(name, "a log"):
            columns = form.read({column: columns[column] for column in labels if column in COLUMNS})
    elif suffix == ".csv" and (plain := plain_csv(name, TYPES)):
        columns, labels = form.gathered(plain, name), list(plain)
    elif suffix in TABLES:
        frame = (csv_frame if suffix == ".csv" else parquet_frame)(name, form.known)
        flat = {str(label): frame[label].to_numpy() for label in frame.columns if form.known(str(label))}
        _refuse_missing(frame, flat, name)
        columns, labels = form.gathered(flat, name), frame.attrs["labels"]
    elif is_minari(name):
        columns = minari_columns(name, form.check_episode)
        labels = list(columns)
    else:
        raise form.refuse(name)
    form.require(columns, labels, name)
    warn_left_out(name, [label for label in labels if not form.known(label)], COLUMNS, level=3)
    return {column: columns[column] for column in COLUMNS if column in columns}


def log_files(path: Any) -> list[str]:
    """The files of a log: a file, a Minari data set, a folder of files, a pattern, or a list of these."""
    if isinstance(path, list | tuple):
        names = [name for one in path for name in log_files(one)]
        if not names:
            raise ValueError("path must name at least one file; it is an empty list")
        again = sorted({name for name in names if names.count(name) > 1})
        if again:
            raise ValueError(f"path must name each file once; {again[0]!r} is named twice")
        return names
    name = _files.local(path)
    place = Path(name)
    if place.is_dir():
        inside = [one for one in sorted(place.rglob("*")) if _is_data_file(one.relative_to(place)) and one.is_file()]
        return [str(one) for one in inside] or [name]
    if glob.has_magic(name) and not place.exists():
        some = [one for one in sorted(glob.glob(name, recursive=True)) if Path(one).is_file()]
        if not some:
            raise FileNotFoundError(2, "no such file", name)
        return some
    return [name]


def _is_data_file(path: Path) -> bool:
    """Files and folders that begin with a dot or an underscore are left out, as writers of folders mean them."""
    hidden = any(step.startswith((".", "_")) for step in path.parts)
    return not hidden and path.suffix.lower() in (*TABLES, ".npz")


def _texts(names: Column) -> Column:
    return np.array([str(item) for item in names], dtype=object)


def as_objects(names: Sequence[Name]) -> Column:
    """Names as an array of them, tuples whole."""
    array = np.empty(len(names), dtype=object)
    array[:] = names
    return array


def _refuse_missing(frame: Any, columns: Columns, name: str) -> None:
    """Each of a log's own columns has a value in every row; vectors are checked where they are put together."""
    for label in columns:
        missing = np.flatnonzero(frame[label].isna().to_numpy()) if label in COLUMNS else np.zeros(0)
        if missing.size:
            raise ValueError(f"column {label!r} of {name!r} must have a value in every row; row {missing[0]} has none")


def is_minari(name: str) -> bool:
    """Whether ``name`` is a Minari folder or id rather than a file; FileNotFoundError where it can be neither."""
    suffix = Path(name).suffix.lower()
    if suffix == "" and not Path(name).exists() and "/" not in name and not name.startswith("minari:"):
        raise FileNotFoundError(2, "no such file", name)
    return suffix == "" or Path(name).is_dir() or name.startswith("minari:") or ("/" in name and "-v" in name)


def _save_minari(log: Any, name: str) -> None:
    """Make the data set in a folder of its own, then move it to where it belongs."""
    require_module("minari", "minari")
    starts = log.episode_starts
    if log.state_names is not None or log.action_names is not None:
        raise ValueError("log must be in numbers to be a Minari data set; this one has names: log.numbered(simulator)")
    if starts is None or log.reward is None:
        lacking = "episodes" if starts is None else "rewards"
        raise ValueError(f"log must have {lacking} to be a Minari data set; this one has none")
    by_id = name.startswith("minari:")
    identifier = name.removeprefix("minari:") if by_id else "oee/log-v0"
    if by_id:
        target = _minari_place(identifier)
    else:
        target = Path(name)
    if target.exists():
        raise ValueError(f"path must be a new folder; {str(target)!r} exists already")
    target.parent.mkdir(parents=True, exist_ok=True)
    root = Path(tempfile.mkdtemp(dir=target.parent.absolute(), prefix=".minari-"))  # Minari joins a relative one twice
    before = os.environ.get("MINARI_DATASETS_PATH")
    try:
        os.environ["MINARI_DATASETS_PATH"] = str(root)
        _write_minari(log, starts, identifier)
        os.replace(root / identifier, target)
    finally:
        if before is None:
            os.environ.pop("MINARI_DATASETS_PATH", None)
        else:
            os.environ["MINARI_DATASETS_PATH"] = before
        shutil.rmtree(root, ignore_errors=True)


def _minari_place(identifier: str) -> Path:
    """The folder of a Minari id; a ValueError, before any folder is made, for what is none."""
    from minari.dataset.minari_dataset import parse_dataset_id
    from minari.storage.datasets_root_dir import get_dataset_path

    try:
        parse_dataset_id(identifier)
    except (TypeError, ValueError):  # TypeError: no version
        raise ValueError(
            f"path must be a Minari id, minari:namespace/name-v0, of letters, digits, - and _; it is {identifier!r}"
        ) from None
    return Path(get_dataset_path(identifier))


def _write_minari(log: Any, starts: NDArray[np.int64], identifier: str) -> None:
    import minari
    from gymnasium import spaces
    from minari.data_collector import EpisodeBuffer

    assert log.reward is not None
    buffers = []
    for k, (low, high) in enumerate(zip(starts[:-1], starts[1:], strict=True)):
        infos: dict[str, Any] = {}
        if log.behavior_probability is not None:
            infos["behavior_probability"] = np.append(log.behavior_probability[low:high], np.nan)[:, None]
        buffers.append(
            EpisodeBuffer(
                id=k,
                observations=np.append(log.state[low:high], log.next_state[high - 1]),
                actions=np.array(log.action[low:high]),
                rewards=list(log.reward[low:high]),
                terminations=list(log.terminated[low:high]),
                truncations=list(log.truncated[low:high]),
                infos=infos,
            )
        )
    facts = log.summary()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Minari asks for an author, a code link and an environment
        minari.create_dataset_from_buffers(
            identifier,
            buffers,
            observation_space=spaces.Discrete(facts["largest_state"] + 1),
            action_space=spaces.Discrete(facts["largest_action"] + 1),
            data_format="arrow",
        )


def minari_episodes(name: str) -> list[Any]:
    """The episodes of a Minari folder or id, as Minari gives them."""
    require_module("minari", "minari")
    folder = Path(_files.local(name))
    if not folder.is_dir():
        try:
            folder = _minari_place(name.removeprefix("minari:"))
        except ValueError as error:
            raise FileNotFoundError(f"{name!r} is neither a file nor a Minari folder: {error}") from None
        if not folder.is_dir():
            raise FileNotFoundError(
                f"{name!r} is neither a file, nor a Minari folder, nor a Minari id here: no folder {str(folder)!r}"
            )
    from minari.dataset.minari_dataset import MinariDataset

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            data = MinariDataset(folder / "data" if (folder / "data").is_dir() else folder)
            return list(data.iterate_episodes())
    except MemoryError:
        raise
    except Exception as error:  # whatever Minari makes of files that are not its own
        raise ValueError(f"{name!r} must be a Minari data set; {str(error) or type(error).__name__:.300}") from None


def minari_columns(name: str, check: Callable[[Column, Column, str], None]) -> dict[str, Column]:
    """A Minari data set as columns; ``check(observations, actions, name)`` refuses an episode that is none of the log's."""
    episodes = minari_episodes(name)
    parts: dict[str, list[Column]] = {column: [] for column in COLUMNS if column != "timestep"}
    for number, episode in enumerate(episodes):
        observations, actions = np.asarray(episode.observations), np.asarray(episode.actions)
        check(observations, actions, name)
        steps = len(actions)
        parts["state"].append(observations[:-1])
        parts["next_state"].append(observations[1:])
        parts["action"].append(actions)
        parts["reward"].append(np.asarray(episode.rewards, dtype=np.float64))
        parts["terminated"].append(np.asarray(episode.terminations, dtype=np.bool_))
        parts["truncated"].append(np.asarray(episode.truncations, dtype=np.bool_))
        parts["episode"].append(np.full(steps, number))
        recorded = (episode.infos or {}).get("behavior_probability")
        if recorded is not None:
            parts["behavior_probability"].append(np.asarray(recorded, dtype=np.float64).reshape(-1)[:steps])
    if parts["behavior_probability"] and len(parts["behavior_probability"]) < len(episodes):
        raise ValueError(f"{name!r} must record behavior_probability in every episode or in none")
    return {column: np.concatenate(arrays) for column, arrays in parts.items() if arrays}
