"""Gymnasium environments by id with other physics: constructor arguments, constants of the class, fields of a MuJoCo model.

A constant is set while the environment is made, wherever its ``__init__`` would set it, so that what is computed from it there
(CartPole's ``polemass_length`` from ``length``) follows.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from oee_tabular import _checks
from oee_tabular.tasks.toy_text import environment_exists

# fields of a MuJoCo model whose elements have names: the kind of the name, and how many there are
ELEMENTS = {
    "body_mass": ("body", "nbody"), "dof_damping": ("joint", "nv"), "dof_armature": ("joint", "nv"),
    "dof_frictionloss": ("joint", "nv"), "jnt_stiffness": ("joint", "njnt"), "actuator_gear": ("actuator", "nu"),
    "geom_friction": ("geom", "ngeom"),
}  # fmt: skip


class Physics:
    """Environment ``identifier`` with these parameters by name; a ValueError for what it does not have.

    With a ``task`` of the environment it is a ``task_of`` of ``fit_parameters``.
    """

    task: Any = None

    def __init__(self, identifier: str, given: Mapping[str, Any]) -> None:
        import gymnasium

        environment_exists(identifier)
        self.identifier, self.given, self.spec = identifier, dict(given), gymnasium.spec(identifier)
        self._takes = inspect.signature(_load(self.spec.entry_point)).parameters
        self._arguments = {key: x for key, x in given.items() if key in self._takes or key in self.spec.kwargs}
        self._constants: dict[str, Any] = {}
        self._fields: dict[str, Any] = {}
        for key, value in self._arguments.items():
            if key in self._takes and _is_number(self._takes[key].default):
                _checks.number_in(value, key, -np.inf, np.inf)
        rest = {key: value for key, value in given.items() if key not in self._arguments}
        if not rest:
            return
        env = self.make()
        elements, known = _elements(env.unwrapped), _numbers_of(env.unwrapped)
        for key, value in rest.items():
            if not hasattr(env.unwrapped, key) and elements and (key in elements or _has(env.unwrapped.model, key)):
                self._fields[key] = value
                continue
            if key not in known:
                takes = ", ".join(name for name in self._takes if name != "kwargs") or "none"
                raise ValueError(
                    f"{key} must be an argument or a number of {identifier}: it takes {takes} and has "
                    f"{', '.join(known) or 'none'}; got {key}={value!r}"
                )
            self._constants[key] = _checks.number_in(value, key, -np.inf, np.inf)
        env.close()

    def make(self, point: str = "entry_point", **arguments: Any) -> Any:
        """The environment, without Gymnasium's wrappers."""
        import gymnasium

        owner, arguments = _load(getattr(self.spec, point)), self.spec.kwargs | self._arguments | arguments
        if self._constants:
            if not isinstance(owner, type):
                raise ValueError(
                    f"{next(iter(self._constants))} must be an argument of {self.identifier}, which is made by a function"
                )
            constants = self._constants

            def hold(env: object, name: str, value: object) -> None:
                object.__setattr__(env, name, constants.get(name, value))

            members = {**constants, "__setattr__": hold, "__module__": owner.__module__}
            owner = type(owner.__name__, (owner,), members)
        try:
            env = owner(**arguments)
        except gymnasium.error.Error as error:
            raise ValueError(f"environment {self.identifier!r} cannot be made: {error}") from None
        except (TypeError, LookupError, ValueError, ArithmeticError, AttributeError, AssertionError) as error:
            raise ValueError(f"environment {self.identifier!r} does not take {arguments}: {error}") from None
        env.spec = self.spec
        for key, value in self._fields.items():
            _set_field(env.unwrapped, key, value)
        return env

    @property
    def make_vector(self) -> Callable[[int], Any] | None:
        """n -> n environments that step at once, where Gymnasium has such; None where not."""
        if self.spec.vector_entry_point is None or self._fields:
            return None
        return lambda n: self.make("vector_entry_point", num_envs=n)

    def __call__(self, **parameters: float) -> Any:
        """The task with these parameters."""
        changed = Physics(self.identifier, self.given | parameters)
        return self.task.with_environment(changed.make, changed.make_vector, changed.given)

    def known(self) -> dict[str, float]:
        """Name -> number, as it is: arguments, constants, and elements of a MuJoCo model (body_mass.pole)."""
        env = self.make()
        inner = env.unwrapped
        found = {name: p.default for name, p in self._takes.items()} | _numbers_of(inner) | self.given
        found |= {name: values[0] for name, values in _elements(inner).items()}
        env.close()
        return {name: float(value) for name, value in found.items() if _is_number(value)}


def _load(point: object) -> Any:
    from gymnasium.envs.registration import load_env_creator

    return point if callable(point) else load_env_creator(str(point))


def _is_number(value: object) -> bool:
    return isinstance(value, int | float | np.number) and not isinstance(value, bool)


def _numbers_of(inner: object) -> dict[str, Any]:
    """The attributes of an environment that are numbers, its class's too, by name; none that are computed."""
    names = [name for name in sorted(dir(inner)) if not name.startswith("_")]
    plain = [name for name in names if not isinstance(inspect.getattr_static(inner, name, None), property)]
    return {name: x for name in plain if _is_number(x := getattr(inner, name, None))}


def _elements(inner: Any) -> dict[str, Any]:
    """FIELD.ELEMENT -> its numbers, a view, of an environment's MuJoCo model; friction and gear have more than the first."""
    found: dict[str, Any] = {}
    model: Any = getattr(inner, "model", None)
    for field, (kind, count) in ELEMENTS.items() if hasattr(model, "nbody") else ():
        values = getattr(model, field)
        for k in range(getattr(model, count)):
            name = getattr(model, kind)(int(model.dof_jntid[k]) if count == "nv" else k).name or str(k)
            found.setdefault(f"{field}.{name}", values.reshape(len(values), -1)[k])
    return found


def _has(model: Any, key: str) -> bool:
    return hasattr(model, key) or hasattr(model.opt, key)


def _set_field(inner: Any, key: str, value: Any) -> None:
    """A field of a MuJoCo model, an array whole, or one element by its name."""
    import mujoco

    model, elements = inner.model, _elements(inner)
    if key in elements:
        elements[key][0] = _checks.number_in(value, key, -np.inf, np.inf)
    else:
        holder = model if hasattr(model, key) else model.opt
        own, found = np.asarray(getattr(holder, key)), _checks.float_array(value, key, ndim=(0, 1, 2))
        if found.shape != own.shape:
            raise ValueError(
                f"{key} must have shape {own.shape}, as in the model: {own.tolist()}; it has shape {found.shape}"
            )
        setattr(holder, key, found if own.ndim else own.dtype.type(found))
    mujoco.mj_setConst(model, inner.data)
