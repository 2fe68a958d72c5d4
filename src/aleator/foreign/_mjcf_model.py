"""An MJCF file compiled by MuJoCo, without what only needs meshes and pictures."""

import warnings
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from aleator._core.errors import MissingExtraError, ProblemError
from aleator.foreign._robot import broken, refuse_effects

Model: TypeAlias = Any
"""A compiled model, `mujoco.MjModel`, which declares no types: rows of arrays for bodies, joints, speeds and so on."""
Posture: TypeAlias = Any
"""Where the bodies of a model are, `mujoco.MjData`."""


def library() -> Any:
    """MuJoCo, imported late. Raises `MissingExtraError` where it is not installed."""
    try:
        import mujoco
    except ImportError as error:
        raise MissingExtraError(
            "`read_mjcf` needs the library mujoco: install it with `pip install 'aleator[robots]'`."
        ) from error
    return mujoco


def compiled(path: str | Path, left_out: Collection[str]) -> tuple[Model, tuple[str, ...]]:
    """The compiled model, and notes on what was removed before.

    Raises `ProblemError` for what MuJoCo refuses, for deformable bodies, and for inertia from a mesh.
    """
    mujoco = library()
    try:
        specification = mujoco.MjSpec.from_file(str(path))
    except ValueError as error:
        raise _refused(path, error) from error
    notes = (*_without_flexes(path, specification, left_out), *_without_files(path, specification))
    # Bodies keep their names and places.
    specification.compiler.fusestatic = False
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        try:
            model = specification.compile()
        except ValueError as error:
            raise _refused(path, error) from error
    _refuse_no_numbers(path, model)
    return model, (*notes, *(f"MuJoCo: {warning.message}." for warning in heard))


def _refuse_no_numbers(path: str | Path, model: Model) -> None:
    """Raise `ProblemError` for a model without bodies, and for numbers that are not finite: MuJoCo warns of them."""
    if model.nbody == 1:
        raise broken(path, "", "expected a model with a body; received none.")
    for part in ("body", "jnt", "dof", "eq"):
        for field in (name for name in dir(model) if name.startswith(f"{part}_")):
            values = getattr(model, field)
            if isinstance(values, np.ndarray) and values.dtype.kind == "f" and np.isnan(values).any():
                index = int(np.argwhere(np.isnan(values))[0][0])
                raise broken(path, "", f"expected numbers; received NaN in {field} of MuJoCo's model, number {index}.")


def _refused(path: str | Path, error: ValueError) -> ProblemError:
    said = "; ".join(line.strip() for line in str(error).splitlines() if line.strip())
    return broken(path, "", f"expected a model that MuJoCo accepts; received its refusal: {said}.")


def _without_flexes(path: str | Path, specification: Any, left_out: Collection[str]) -> tuple[str, ...]:
    flexes = list(specification.flexes)
    effects = {"flex": [f"flex '{flex.name}'" for flex in flexes]} if flexes else {}
    notes = refuse_effects(path, effects, left_out)
    _delete(specification, flexes)
    return notes


def _without_files(path: str | Path, specification: Any) -> Iterator[str]:
    """Remove what is read from further files: meshes, height fields, textures, skins, and what refers to them."""
    shapes = [geom for geom in specification.geoms if _needs_file(geom)]
    for geom in shapes:
        if _gives_inertia(specification, geom):
            raise broken(
                path,
                f"body '{geom.parent.name}'",
                f"expected its inertia in numbers; received a mesh ('{geom.meshname or geom.name}') to compute it "
                "from, which is not read. Give the body an <inertial> with pos, mass and fullinertia (MuJoCo writes "
                "the numbers that it computes itself by mj_saveLastXML).",
            )
    if shapes:
        yield f"Meshes and height fields are not read ({len(shapes)})."
        names = {geom.name for geom in shapes if geom.name}
        _delete(specification, [pair for pair in specification.pairs if {pair.geomname1, pair.geomname2} & names])
        _delete(specification, shapes)
    for owner in (*specification.geoms, *specification.sites, *specification.tendons):
        owner.material = ""
    for parts in ("sensors", "tuples", "skins", "meshes", "hfields", "materials", "textures"):
        _delete(specification, list(getattr(specification, parts)))


def _needs_file(geom: Any) -> bool:
    """Whether a shape is a mesh or fitted to one, or a field of heights."""
    return bool(geom.meshname or geom.hfieldname)


def _gives_inertia(specification: Any, geom: Any) -> bool:
    """Whether the inertia of a moving body is computed from a shape."""
    kinds = library().mjtInertiaFromGeom
    # Bodies of an attached file keep its settings.
    settings = getattr(geom.parent, "compiler", specification.compiler)
    rule, (first, last) = settings.inertiafromgeom, settings.inertiagrouprange
    if not _moves(geom.parent) or not first <= geom.group <= last or rule == kinds.mjINERTIAFROMGEOM_FALSE:
        return False
    if rule != kinds.mjINERTIAFROMGEOM_TRUE and geom.parent.explicitinertial:
        return False
    # A mass that is not given is NaN.
    return geom.mass != 0 and (geom.mass > 0 or geom.density > 0)


def _moves(body: Any) -> bool:
    while body is not None and body.name != "world":
        if len(body.joints):
            return True
        body = body.parent
    return False


def _delete(specification: Any, parts: Collection[Any]) -> None:
    for part in parts:
        specification.delete(part)


def is_disabled(model: Model, flag: str) -> bool:
    """Whether a file switches an effect off: "SPRING", "DAMPER", "GRAVITY" and others of `mjtDisableBit`."""
    return bool(model.opt.disableflags & getattr(library().mjtDisableBit, f"mjDSBL_{flag}"))
