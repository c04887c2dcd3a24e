"""Minari data sets as logs, and logs of numbered states as Minari data sets."""

from __future__ import annotations

import errno
import importlib.util
import itertools
import os
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from oee_tabular import _files
from oee_tabular._checks import Column

FOLDER = "MINARI_DATASETS_PATH"  # the variable that says where Minari has its data sets


def is_minari(name: str) -> bool:
    """Whether ``name`` is a Minari folder or id rather than a file; FileNotFoundError where it can be neither."""
    suffix = Path(name).suffix.lower()
    if suffix == "" and not Path(name).exists() and "/" not in name and not name.startswith("minari:"):
        raise FileNotFoundError(2, "no such file", name)
    return suffix == "" or Path(name).is_dir() or name.startswith("minari:") or ("/" in name and "-v" in name)


def require_minari() -> None:
    """ImportError that names the extra where Minari is missing."""
    if importlib.util.find_spec("minari") is None:
        raise ImportError("minari is not installed; in a clone: pip install '.[minari]'")


def find_folder(identifier: str) -> Path:
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


def save_minari(log: Any, name: str) -> None:
    """Make the data set in a folder of its own, then move it to where it belongs."""
    from unittest import mock  # asyncio comes with it, for which every command would wait .04 s

    require_minari()
    if log.state_names or log.action_names:
        raise ValueError("log must be in numbers to be a Minari data set; this one has names: log.numbered(simulator)")
    if log.episode is None or log.reward is None:
        lacking = "episodes" if log.episode is None else "rewards"
        raise ValueError(f"log must have {lacking} to be a Minari data set; this one has none")
    is_id = name.startswith("minari:")
    identifier = name.removeprefix("minari:") if is_id else "oee/log-v0"
    target = find_folder(identifier) if is_id else Path(name)
    if target.exists():
        raise ValueError(f"path must be a new folder; {str(target)!r} exists already")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        absolute = target.parent.absolute()  # Minari joins a relative one twice
        with tempfile.TemporaryDirectory(dir=absolute, prefix=".minari-") as root:
            with mock.patch.dict(os.environ, {FOLDER: root}):
                _write_minari(log, identifier)
            os.replace(Path(root) / identifier, target)
    except OSError as error:  # of a file inside, or of none
        number = error.errno or errno.EIO
        raise OSError(number, f"cannot be written ({os.strerror(number)})", str(target)) from None


def _write_minari(log: Any, identifier: str) -> None:
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
            buffer.infos["behavior_probability"] = np.append(log.behavior_probability[low:high], np.nan)[:, None]
        buffers.append(buffer)
    n_states = int(max(log.state.max(), log.next_state.max())) + 1
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Minari asks for an author, a code link and an environment
        minari.create_dataset_from_buffers(
            identifier,
            buffers,
            observation_space=spaces.Discrete(n_states),
            action_space=spaces.Discrete(int(log.action.max()) + 1),
            data_format="arrow",
        )


def minari_episodes(name: str) -> list[Any]:
    """The episodes of a Minari folder or id, as Minari gives them."""
    require_minari()
    from minari.dataset.minari_dataset import MinariDataset

    folder, reason = Path(_files.local(name)), ""
    if not folder.is_dir():
        try:
            folder = find_folder(name.removeprefix("minari:"))
        except ValueError as error:
            reason = f": {error}"
    if not folder.is_dir():
        raise FileNotFoundError(f"{name!r} is neither a file nor a Minari folder or id on this machine{reason}")
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
    parts: list[dict[str, Column]] = []
    for number, episode in enumerate(minari_episodes(name)):
        observations, actions = np.asarray(episode.observations), np.asarray(episode.actions)
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
        recorded = (episode.infos or {}).get("behavior_probability")
        if recorded is not None:
            columns["behavior_probability"] = np.asarray(recorded, dtype=np.float64).reshape(-1)[: len(actions)]
        parts.append(columns)
    if len({len(part) for part in parts}) > 1:
        raise ValueError(f"{name!r} must record behavior_probability in every episode or in none")
    return {label: np.concatenate([part[label] for part in parts]) for label in (parts[0] if parts else {})}
