"""Logs as files: npz, CSV, parquet and Minari data sets, whole or not at all."""

from __future__ import annotations

import glob
import importlib.util
import os
import re
import shutil
import tempfile
import warnings
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from oee_tabular import _checks, _files
from oee_tabular._checks import Column
from oee_tabular.data.digests import write_parquet
from oee_tabular.data.labels import COLUMNS, MOVE, require_columns, warn_left_out
from oee_tabular.data.reader import LogFile, csv_labels, read_columns, read_csv
from oee_tabular.mdp.naming import Name, from_text, to_text

Paths: TypeAlias = str | os.PathLike[str] | Iterable[str | os.PathLike[str]]  # a file, a folder, a pattern, or several
ENDINGS = (".csv", ".parquet", ".npz", ".csv.gz")
Columns = dict[str, Column]


class Format:
    """Logs of numbered states as files; a log of other states overrides what differs."""

    kind = "transitions"  # of an npz
    required = MOVE
    way = (
        "; in Python, several to a state as well: Transitions.from_frame(frame, state='its name', ...).save('log.csv')"
    )
    endings = ".npz, .csv, .csv.gz, .parquet, or be a Minari folder or id"

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

    def require_labels(self, labels: Sequence[str], name: str) -> None:
        """ValueError where a table with these labels is no log of this kind, before it is read."""
        require_columns(repr(name), self.required, labels, way=self.way)

    def require(self, columns: Columns, labels: Sequence[str], name: str) -> None:
        """ValueError where a file with these columns is no log of this kind."""
        require_columns(repr(name), self.required, columns, way=self.way)

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
    elif suffix == ".csv":
        import pandas as pd

        with _files.whole_file(name) as handle:
            pd.DataFrame(form.flat(log.columns())).to_csv(handle, index=False)
    elif suffix == ".parquet":
        with _files.whole_file(name) as handle:
            write_parquet(handle.name, form.flat(log.columns()))
    else:
        raise form.refuse(name)


def load(form: Format, file: LogFile) -> Columns:
    """The columns of a log in the format that the path's ending names; unknown ones are left out with a warning."""
    name = _files.local(file.path)
    if file.suffix == ".npz":
        columns = _files.load_npz(name, form.kind)
        columns.pop(_files.KIND)
        labels = list(columns)
        with _files.parts_of(name, "a log"):
            columns = form.read(columns)
        unknown = [label for label in labels if label not in COLUMNS]
        if unknown:
            raise ValueError(f"{name!r} must hold the columns of a log alone; it has {_checks.show(unknown[0])}")
        form.require(columns, labels, name)
    elif file.suffix in (".csv", ".parquet"):
        flat, labels = read_columns(file, form.known, lambda given: form.require_labels(given, name))
        columns = form.gathered(flat, name)
        form.require(columns, labels, name)
        warn_left_out(name, [label for label in labels if not form.known(label)], COLUMNS, level=4)
    elif is_minari(name):
        columns = minari_columns(name, form.check_episode)
    else:
        raise form.refuse(name)
    return {column: columns[column] for column in COLUMNS if column in columns}


def find_log_files(path: Paths, *, tables_only: bool = False) -> list[LogFile]:
    """The files that a path, a folder, a pattern or a list of them names, in the order of their names.

    Files and folders that begin with a dot or an underscore are left out, as writers of folders mean them; folders
    ``column=value`` name a column [1]. A Minari data set is one file, unless there must be ``tables_only``.

    [1] Apache Hive.
    """
    given = [path] if isinstance(path, str | os.PathLike) else list(_checks.collection(path, "path", "paths of files"))
    some = [file for one in given for file in _files_at(_files.local(one), tables_only)]
    if not some:
        raise ValueError("path must name files; it is an empty list")
    again = {file.path for k, file in enumerate(some) if file.path in {other.path for other in some[:k]}}
    if again:
        raise ValueError(f"path must name each file once; {sorted(again)[0]!r} is named twice")
    return some


def _files_at(name: str, tables_only: bool) -> list[LogFile]:
    """The files of a folder, a file, or those that a pattern names."""
    place = Path(name)
    if place.is_dir():
        below = [(file, file.relative_to(place)) for file in sorted(place.rglob("*")) if file.is_file()]
        inside = [LogFile(str(file), _fixed(way)) for file, way in below if _is_data_file(way)]
        if not inside and tables_only:
            raise ValueError(f"path must hold files in {', '.join(ENDINGS)}; the folder {name!r} has none")
        return inside or [LogFile(name)]
    if place.is_file() or not glob.has_magic(name):
        if tables_only and not place.is_file():
            raise FileNotFoundError(2, "no such file", name)
        if tables_only and not name.lower().endswith(ENDINGS):
            raise ValueError(f"path must end in {', '.join(ENDINGS)}, or be a folder; it is {name!r}")
        return [LogFile(name)]
    matching = [Path(file) for file in sorted(glob.glob(name, recursive=True)) if Path(file).is_file()]
    if not matching:
        raise FileNotFoundError(2, "no file matches the pattern", name)
    return [LogFile(str(file), _fixed(file)) for file in matching]


def _is_data_file(path: Path) -> bool:
    is_hidden = any(step.startswith((".", "_")) for step in path.parts)
    return not is_hidden and path.name.lower().endswith(ENDINGS)


def _fixed(path: Path) -> tuple[tuple[str, str], ...]:
    """Columns that folders name, as Hive does."""
    steps = (step.partition("=") for step in path.parts[:-1])
    return tuple((label, value) for label, equals, value in steps if equals and label in COLUMNS)


def plain_name(file: LogFile, files: Sequence[LogFile]) -> str:
    """A file's path below what all have in common: the same wherever a folder stands."""
    common = os.path.commonpath([os.path.dirname(os.path.abspath(one.path)) for one in files])
    return re.sub(r"[\\/]+", "/", os.path.relpath(os.path.abspath(file.path), common))


def require_module(module: str, extra: str) -> None:
    """ImportError that names the extra where a module is missing."""
    if importlib.util.find_spec(module) is None:
        raise ImportError(f"{module} is not installed; in a clone: pip install '.[{extra}]'")


def csv_frame(path: str) -> Any:
    """A CSV file with a header as a DataFrame, its numbers to the last bit; ValueError for another file."""
    name = _files.local(path)
    csv_labels(name)
    try:
        with open(name, "rb") as handle:
            return read_csv(handle)
    except (ValueError, OverflowError, Warning) as error:
        raise ValueError(f"{name!r} must be a CSV table with a header; {error}") from None


def _texts(names: Column) -> Column:
    return np.array([str(item) for item in names], dtype=object)


def as_objects(names: Sequence[Name]) -> Column:
    """Names as an array of them, tuples whole."""
    array = np.empty(len(names), dtype=object)
    array[:] = names
    return array


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
