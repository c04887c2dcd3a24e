"""Logs as files: npz, CSV, parquet and Minari data sets, whole or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from oee_tabular import _files
from oee_tabular.data.tables import csv_frame, parquet_frame, require_columns, require_module, warn_left_out
from oee_tabular.data.transitions import COLUMNS, Transitions

KIND = "transitions"
_REQUIRED = ("state", "action", "next_state")
_SUFFIXES = (".npz", ".csv", ".parquet")
Log = TypeVar("Log", bound=Transitions)


def save(log: Transitions, path: str | os.PathLike[str]) -> None:
    """Write ``log`` in the format that the path's ending names."""
    name = _files.local(path)
    suffix = Path(name).suffix.lower()
    if name.startswith("minari:") or suffix == "":
        _save_minari(log, name)
    elif suffix == ".npz":
        _files.save_npz(name, KIND, log.columns())
    elif suffix == ".csv":
        import pandas as pd

        with _files.whole_file(name) as handle:
            pd.DataFrame(log.columns()).to_csv(handle, index=False)
    elif suffix == ".parquet":
        import pandas as pd

        require_module("pyarrow", "parquet")
        with _files.whole_file(name) as handle:
            pd.DataFrame(log.columns()).to_parquet(handle, index=False)
    else:
        raise ValueError(_unknown(name))


def load(kind: type[Log], path: str | os.PathLike[str]) -> Log:
    """Read a log in the format that the path's ending names."""
    name = _files.local(path)
    suffix = Path(name).suffix.lower()
    if suffix == ".npz":
        arrays = _files.load_npz(name, KIND)
        arrays.pop(_files.KIND)
        return _log(kind, arrays, list(arrays), name)
    if suffix in (".csv", ".parquet"):
        frame = (csv_frame if suffix == ".csv" else parquet_frame)(name, COLUMNS.__contains__)
        return _log(kind, _columns(frame, name), frame.attrs["labels"], name)
    if is_minari(name):
        return _load_minari(kind, name)
    raise ValueError(_unknown(name))


def is_minari(name: str) -> bool:
    """Whether ``name`` is a Minari folder or id rather than a file; FileNotFoundError where it can be neither."""
    suffix = Path(name).suffix.lower()
    if suffix == "" and not Path(name).exists() and "/" not in name and not name.startswith("minari:"):
        raise FileNotFoundError(2, "no such file", name)
    return suffix == "" or Path(name).is_dir() or name.startswith("minari:") or ("/" in name and "-v" in name)


def _unknown(name: str) -> str:
    return f"path must end in {', '.join(_SUFFIXES)}, or be a Minari folder or id; it is {name!r}"


def _columns(frame: Any, name: str) -> dict[str, NDArray[Any]]:
    """The columns that a log knows, each with a value in every row."""
    columns: dict[str, NDArray[Any]] = {}
    for label in frame.columns.intersection(list(COLUMNS)):
        missing = np.flatnonzero(frame[label].isna().to_numpy())
        if missing.size:
            raise ValueError(f"column {label!r} of {name!r} must have a value in every row; row {missing[0]} has none")
        columns[str(label)] = frame[label].to_numpy()
    return columns


def _log(kind: type[Log], columns: dict[str, NDArray[Any]], labels: Sequence[str], name: str) -> Log:
    """A log of columns, of a file that has ``labels``."""
    require_columns(name, _REQUIRED, labels)
    warn_left_out(name, [label for label in labels if label not in COLUMNS], COLUMNS, level=4)
    try:
        return kind(**{column: columns[column] for column in COLUMNS if column in columns})
    except ValueError as error:
        raise ValueError(f"{name!r}: {error}") from None


def _save_minari(log: Transitions, name: str) -> None:
    """Make the data set in a folder of its own, then move it to where it belongs."""
    require_module("minari", "minari")
    starts = log.episode_starts
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
    root = Path(tempfile.mkdtemp(dir=target.parent, prefix=".minari-"))
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


def _write_minari(log: Transitions, starts: NDArray[np.int64], identifier: str) -> None:
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


def _load_minari(kind: type[Log], name: str) -> Log:
    columns = minari_columns(name, _discrete)
    return _log(kind, columns, list(columns), name)


def _discrete(observations: NDArray[Any], actions: NDArray[Any], name: str) -> None:
    if observations.ndim != 1 or observations.dtype.kind not in "iu" or actions.dtype.kind not in "iu":
        raise ValueError(
            f"{name!r} must have discrete observations and actions; they have shapes {observations.shape} of "
            f"{observations.dtype} and {actions.shape} of {actions.dtype}"
        )


def minari_columns(name: str, check: Callable[[NDArray[Any], NDArray[Any], str], None]) -> dict[str, NDArray[Any]]:
    """A Minari data set as columns; ``check(observations, actions, name)`` refuses an episode that is none of the log's."""
    episodes = minari_episodes(name)
    parts: dict[str, list[NDArray[Any]]] = {column: [] for column in COLUMNS if column != "timestep"}
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
