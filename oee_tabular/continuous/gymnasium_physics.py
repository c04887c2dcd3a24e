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
from oee_tabular.tasks.toy_text import environment_exists, make_environment

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
        takes = inspect.signature(_entry(self.spec.entry_point)).parameters
        self._plain = {key: value for key, value in given.items() if key in takes or key in self.spec.kwargs}
        for key, value in self._plain.items():
            usual = takes[key].default if key in takes else None
            if isinstance(usual, int | float) and not isinstance(usual, bool):
                _checks.number_in(value, key, -np.inf, np.inf)
        self._constants: dict[str, Any] = {}
        self._fields: dict[str, Any] = {}
        rest = {key: value for key, value in given.items() if key not in self._plain}
        if rest:
            env = make_environment(identifier, **self._plain)
            inner, model = env.unwrapped, getattr(env.unwrapped, "model", None)
            is_field = {key: not hasattr(inner, key) and _holder(model, key) is not None for key in rest}
            self._fields = {key: value for key, value in rest.items() if is_field[key]}
            self._constants = {key: value for key, value in rest.items() if not is_field[key]}
            for key, value in self._constants.items():
                _check_constant(inner, key, value, identifier, [name for name in takes if name != "kwargs"])
            env.close()

    def make(self) -> Any:
        """The environment."""
        if not self._constants and not self._fields:
            return make_environment(self.identifier, **self._plain)
        env = _made_with(self.identifier, "entry_point", self._constants, self._plain)
        _set_fields(env, self._fields)
        return env

    @property
    def make_vector(self) -> Callable[[int], Any] | None:
        """n -> n environments that step at once, where Gymnasium has such; None where not."""
        if self.spec.vector_entry_point is None or self._fields:
            return None
        make, constants, plain = _made_with, self._constants, self._plain
        return lambda n: make(self.identifier, "vector_entry_point", constants, plain | {"num_envs": n}).unwrapped

    def __call__(self, **parameters: float) -> Any:
        """The task with these parameters."""
        changed = Physics(self.identifier, self.given | parameters)
        return self.task.with_environment(changed.make, changed.make_vector, changed.given)

    def known(self) -> dict[str, float]:
        """Name -> number, as it is: arguments, constants, and elements of a MuJoCo model (body_mass.pole)."""
        env = self.make()
        inner: Any = env.unwrapped
        model: Any = getattr(inner, "model", None)
        takes = inspect.signature(_entry(self.spec.entry_point)).parameters
        found = {name: p.default for name, p in takes.items() if isinstance(p.default, int | float)}
        found |= {name: getattr(inner, name) for name in sorted(dir(inner)) if _is_number(inner, name)}
        found |= {name: value for name, value in self.given.items() if isinstance(value, int | float)}
        for field, (kind, count) in ELEMENTS.items() if model is not None else ():
            for k in range(getattr(model, count)):
                name = getattr(model, kind)(int(model.dof_jntid[k]) if count == "nv" else k).name or str(k)
                found[f"{field}.{name}"] = np.ravel(getattr(model, field)[k])[0]
        env.close()
        return {name: float(value) for name, value in found.items() if not isinstance(value, bool)}


def _check_constant(inner: object, key: str, value: object, identifier: str, takes: list[str]) -> None:
    own = getattr(inner, key, None)
    if isinstance(own, int | float | np.number) and not isinstance(own, bool):
        _checks.number_in(value, key, -np.inf, np.inf)
        return
    known = sorted({name for owner in (type(inner), inner) for name in dir(owner) if _is_number(inner, name)})
    raise ValueError(
        f"{key} must be an argument or a number of {identifier}: it takes {', '.join(takes) or 'none'} and has "
        f"{', '.join(known) or 'none'}; got {key}={value!r}"
    )


def _is_number(inner: object, name: str) -> bool:
    if name.startswith("_") or isinstance(inspect.getattr_static(inner, name, None), property):
        return False
    value = getattr(inner, name, None)
    return isinstance(value, int | float) and not isinstance(value, bool)


def _entry(point: object) -> Any:
    from gymnasium.envs.registration import load_env_creator

    return point if callable(point) else load_env_creator(str(point))


def _made_with(identifier: str, point: str, constants: Mapping[str, object], arguments: Mapping[str, object]) -> Any:
    """The environment's class with constants that its own ``__init__`` cannot set otherwise."""
    import gymnasium

    spec = gymnasium.spec(identifier)
    owner = _entry(getattr(spec, point))
    if not isinstance(owner, type):
        if constants:
            raise ValueError(
                f"{next(iter(constants))} must be an argument of {identifier}, which is made by a function"
            )
        return owner(**(spec.kwargs | dict(arguments)))

    def held(self: object, name: str, value: object) -> None:
        object.__setattr__(self, name, constants.get(name, value))

    changed = type(owner.__name__, (owner,), {**constants, "__setattr__": held, "__module__": owner.__module__})
    try:
        env = changed(**(spec.kwargs | dict(arguments)))
    except (TypeError, LookupError, ValueError, ArithmeticError, AttributeError, AssertionError) as error:
        raise ValueError(f"environment {identifier!r} does not take {dict(arguments)}: {error}") from None
    env.spec = spec
    return env


def _holder(model: Any, key: str) -> Any:
    """What of a MuJoCo model holds the field ``key``, or ``FIELD.ELEMENT``: the model or its options."""
    field, dot, element = key.partition(".")
    if model is None or (dot and _element(model, field, element) is None):
        return None
    return next((part for part in (model, getattr(model, "opt", None)) if hasattr(part, field)), None)


def _element(model: Any, field: str, element: str) -> int | None:
    """Where the named element stands in a field; None where there is none."""
    kind, count = ELEMENTS.get(field, ("body", "nbody"))
    try:
        number = int(element) if element.isdigit() else int(getattr(model, kind)(element).id)
    except KeyError:
        return None
    if count == "nv" and not element.isdigit():
        number = int(model.jnt_dofadr[number])
    return number if field in ELEMENTS and number < getattr(model, count) else None


def _set_fields(env: Any, fields: Mapping[str, Any]) -> None:
    """Fields of a MuJoCo model, arrays whole or one element by its name."""
    if not fields:
        return
    import mujoco

    model = env.unwrapped.model
    for key, value in fields.items():
        holder, (field, dot, element) = _holder(model, key), key.partition(".")
        if dot:
            values = getattr(holder, field).reshape(
                len(getattr(holder, field)), -1
            )  # a view; friction and gear have more
            values[_element(model, field, element), 0] = _checks.number_in(value, key, -np.inf, np.inf)
            continue
        own = np.asarray(getattr(holder, key), dtype=np.float64)
        found = _checks.float_array(value, key, ndim=(0, 1, 2))
        if found.shape != own.shape:
            raise ValueError(
                f"{key} must have shape {own.shape}, as in the model: {own.tolist()}; it has shape {found.shape}"
            )
        if own.ndim:
            getattr(holder, key)[...] = found
        else:
            setattr(holder, key, type(getattr(holder, key))(found))
    mujoco.mj_setConst(model, env.unwrapped.data)
